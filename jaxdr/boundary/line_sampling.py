"""Line sampling: boundary path integrals from silhouette crossings on random chords, without a radius (DESIGN 2b)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.attached_lines import AttachedLines, folded_edges
from jaxdr.boundary.background import background_term, seen_edges
from jaxdr.boundary.blocks import map_over_blocks, sum_over_blocks
from jaxdr.boundary.chords import Chords, LobeChords, emitter_chords, lobe_weight
from jaxdr.boundary.crossings import (
    BOUNDS,
    HIDES,
    MOVES,
    Chosen,
    Crossings,
    Prepared,
    RankedEdges,
    apex_moves,
    draw_lobe_chords,
    find_crossings,
    luminance,
)
from jaxdr.boundary.emitter_planes import emitter_face_at, emitter_groups
from jaxdr.boundary.silhouettes import PathSegments, never_silhouettes, project_edges
from jaxdr.geometry.edge_tree import build_edge_tree
from jaxdr.geometry.queries import UNBOUNDED
from jaxdr.geometry.vector import dot
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave, material_point
from jaxdr.transport.path import PathRecord, PathSettings
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.sampler import lattice
from jaxdr.transport.shading import emitted, emitter_pdf

ROW = 64  # crossings among which some are kept are rounded together


class LineSampling(eqx.Module):
    """Boundary term of every segment behind the first hit, by line sampling; every field is static.

    Unbiased, and without a radius. Light of area emitters is found by chords on the emitters, all other light
    (environment, indirect) by geodesic chords around BSDF-sampled directions.

    - `chords`: chords of each kind per path sample. They need not be as many as the paths: a pilot sends them to the
      pixels whose shadows they find, and to the path vertices that carry most.
    - `pilot`: pilot chords per chord; 0 spreads chords by throughput alone.
    - `floor`: importance that every pixel keeps, relative to the mean over pixels.
    - `reach`: half-length of geodesic chords, relative to the lobe's width (`BSDF.lobe_width`); at most 1.4 radians.
    - `backgrounds`: paths traced from what lies behind silhouettes, per path sample.
    - `capacity`: room for crossings, as a share of the number of chords. What exceeds it is thinned at random without
      bias, with a warning.
    - `attached`: lobes narrower than this (radians, `BSDF.lobe_width`) hold their sampled directions fixed, as the
      camera does its rays: less noise the narrower they are, and edges between faces have to be found in them, too.
      0 for none. Which lobes are narrow should depend on the material alone.
    """

    chords: float = eqx.field(static=True, default=1.0)
    pilot: float = eqx.field(static=True, default=0.25)
    floor: float = eqx.field(static=True, default=0.2)
    reach: float = eqx.field(static=True, default=1.0)
    backgrounds: float = eqx.field(static=True, default=1.0)
    capacity: float = eqx.field(static=True, default=4.0)
    attached: float = eqx.field(static=True, default=0.0)

    def __check_init__(self):
        for name in ("chords", "floor", "reach", "backgrounds", "capacity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LineSampling: {name} must be positive, got {getattr(self, name)}")
        for name in ("pilot", "attached"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"LineSampling: {name} must not be negative, got {getattr(self, name)}")

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...]) -> Prepared:
        """Ranks of the edges and the tree over them, once for a whole image. `moving`: which shapes can move."""
        edges, flags = packed.edges, jnp.asarray(moving)
        rank = jnp.where(flags[edges.shape], MOVES, BOUNDS)
        rank = jnp.where(never_silhouettes(packed), HIDES, rank).astype(packed.vertices.dtype)
        tree = build_edge_tree(
            packed.vertices, edges.vertices, edges.opposite, edges.interior, rank, packed.edge_counts
        )
        faces = np.diff(packed.first_face)
        still = faces[~np.asarray(moving)].sum()
        group = jnp.full(packed.faces.shape[0], -1, jnp.int32)
        if packed.has_area_emitters:
            group = emitter_groups(packed)
        folds = folded_edges(packed, flags) if self.attached > 0 else None
        count_layers = jnp.asarray(bool(still <= faces.sum() // 2))
        return Prepared(RankedEdges(rank, tree), group, flags, count_layers, folds)

    def estimate(
        self,
        packed: PackedScene,
        prepared: Prepared,
        primary: PrimarySamples,
        record: PathRecord,
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        settings: PathSettings,
    ) -> Float[Array, "N 3"]:
        """Boundary term of N paths: zero in value, right in derivative. `prepared` by `prepare`."""
        total = jnp.zeros_like(record.radiance)
        if record.direct is None:
            return total
        paths = PathSegments(packed, primary, record.direct, record.vertices)
        key_emitters, key_lobes = jax.random.split(key)
        if packed.has_area_emitters:
            lines = EmitterLines(packed, prepared, paths, settings)
            carries = luminance(paths.table.throughput)
            total = total + self._term(lines, paths, carries, key_emitters)
        if packed.environment is not None or settings.max_depth > 2:
            lines = LobeLines(packed, prepared, paths, settings, self.reach)
            carries = luminance(paths.table.throughput)
            if packed.environment is None:  # nothing is gathered behind the last bounce
                carries = jnp.where(jnp.arange(paths.count) < paths.count - paths.paths, carries, 0.0)
            if paths.vertices is not None:
                carries = jnp.where(paths.vertices.narrow, 0.0, carries)
            total = total + self._term(lines, paths, carries, key_lobes)
        if paths.vertices is not None:
            lines = AttachedLines(packed, prepared, paths, settings, self.reach, luminance(record.radiance).mean())
            carries = jnp.where(paths.vertices.narrow, luminance(paths.table.throughput), 0.0)
            total = total + self._term(lines, paths, carries, jax.random.fold_in(key, 2))
        return total

    def _term(
        self, lines: "EmitterLines | LobeLines | AttachedLines", paths: PathSegments, carries, key
    ) -> Float[Array, "N 3"]:
        """Boundary term of one kind of light; `carries` is the importance of every path vertex."""
        _, _, width, height = paths.packed.camera.film.window
        pixels, samples = width * height, paths.paths // (width * height)
        layout = (paths.count // paths.paths, pixels, samples)
        key_pilot, key_pilot_chords, key_main, key_chords, key_values = jax.random.split(key, 5)
        chords = self.chords * paths.paths
        importance = carries.reshape(layout)
        if self.pilot > 0:
            count = self.pilot * chords
            chosen = Chosen(*allocate(shares(importance, count), capacity(round(count), pixels), key_pilot))
            drawn, found, thinned, used = lines.search(chosen, key_pilot_chords, self._room(count))

            def scores(block: Crossings, number):
                score = lines.score(drawn, block) * (thinned / jnp.where(block.valid, carries[block.vertex], 1.0))
                score = jnp.where(block.valid & (number < used), score, 0.0)
                return jnp.zeros(chosen.vertex.shape[0], score.dtype).at[block.chord].add(score)

            per_chord = sum_over_blocks(scores, found, used)
            pixel = paths.path(jnp.maximum(chosen.vertex, 0)) // samples
            of_pixel = pixel_importance(per_chord, pixel, chosen.vertex >= 0, (height, width), self.floor)
            importance = stop_gradient(importance * of_pixel[None, :, None])
        chosen = Chosen(*allocate(shares(importance, chords), capacity(round(chords), pixels), key_main))
        drawn, found, thinned, used = lines.search(chosen, key_chords, self._room(chords))
        found = found._replace(valid=found.valid & (jnp.arange(found.valid.shape[0]) < used))
        weight = thinned * chosen.inverse[found.chord]
        if lines.traces_paths:
            key_kept, key_values = jax.random.split(key_values)
            found, weight, used = self._kept(lines, drawn, found, weight, used, key_kept)

        def values(block, number):
            block, weight = block
            block = block._replace(valid=block.valid & (number < used))
            value = lines.value(drawn, block, number, weight, key_values)
            return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(block.vertex)].add(value)

        return sum_over_blocks(values, (found, weight), used)

    def _kept(self, lines: "LobeLines | AttachedLines", drawn, found: Crossings, weight, used, key):
        """Crossings drawn in proportion to what they should contribute, their weights, and their number.

        The paths from behind them are what costs: there are as many as `backgrounds` asks for, whatever was found.
        """
        rows = -(-found.chord.shape[0] // ROW)
        room = rows * ROW

        def scores(block, number):
            block, weight = block
            return jnp.where(block.valid & (number < used), lines.score(drawn, block) * weight, 0.0)

        score = stop_gradient(map_over_blocks(scores, (found, weight), used))
        score = score + jnp.where(score > 0, self.floor * score.sum() / jnp.maximum((score > 0).sum(), 1), 0.0)
        count = self.backgrounds * lines.paths.paths
        expected = shares(jnp.pad(score, (0, room - score.shape[0])).reshape(1, rows, ROW), count)
        slot, inverse = allocate(expected, capacity(round(count), rows), key)
        kept = jax.tree.map(lambda table: table[jnp.maximum(slot, 0)], found)
        kept = kept._replace(valid=kept.valid & (slot >= 0))
        return kept, weight[jnp.maximum(slot, 0)] * inverse, (slot >= 0).sum()

    def _room(self, chords: float) -> int:
        return max(1024, round(self.capacity * chords))


class EmitterLines:
    """Chords on area emitters, for their light."""

    traces_paths = False

    def __init__(self, packed: PackedScene, prepared: Prepared, paths: PathSegments, settings: PathSettings):
        self.packed, self.prepared, self.paths, self.settings = packed, prepared, paths, settings

    def search(self, chosen: Chosen, key, room: int):
        """(chords, crossings, weight of the thinning, number of crossings)."""
        key_chord, key_seed = jax.random.split(key)
        u = lattice(key_chord, 1, jnp.arange(chosen.vertex.shape[0]), 3, self.packed.vertices.dtype)[0]
        scatterer = self.paths.scatterer(jnp.maximum(chosen.vertex, 0))
        chords, sample = emitter_chords(self.packed, self.prepared.group, scatterer.point.position, u)
        # Off the surface on the side that scatters, whatever the chord's centre: a chord may cross the horizon.
        apex = leave(scatterer.point, scatterer.normal)
        crossings = _search(self, chosen, apex, chords, key_seed, room)
        return (chords, sample.point), *crossings

    def score(self, drawn, found: Crossings) -> Float[Array, " C"]:
        """Contribution of crossings to the pilot: luminance per motion of the edge."""
        projection, weight = self._boundary(drawn, found)
        return luminance(weight) / jnp.where(projection.fraction > 0, projection.fraction, 1.0)

    def value(self, drawn, found: Crossings, number, weight, key) -> Float[Array, "C 3"]:
        """Contributions times `weight`: zero in value, right in derivative."""
        del number, key
        projection, value = self._boundary(drawn, found)
        moved = projection.displacement - stop_gradient(projection.displacement)
        return value * (weight * moved)[:, None]

    def _boundary(self, drawn, found: Crossings):
        """(the crossed edges projected onto the emitter, contributions without their normal velocity)."""
        packed, paths, group = self.packed, self.paths, self.prepared.group
        chords, centre = drawn
        face = centre.face[found.chord]
        on_plane = _projected(self, found, centre)
        # The chord may have left the triangle its centre is in, whose vertices move otherwise.
        face, barycentric, inside = emitter_face_at(packed, group, face, on_plane)
        ends = paths.ends_to(found.vertex, face, barycentric, jnp.zeros_like(inside), jnp.zeros_like(barycentric))
        projection = project_edges(packed, found.edge, ends, found.along)
        in_front = dot(stop_gradient(ends.normal), stop_gradient(ends.apex) - projection.point) > 0
        weight = paths.table.throughput[found.vertex] * chords.weight[found.chord]
        weight = weight * paths.transfer(found.vertex, ends, projection.point)
        if paths.vertices is not None:
            share = self._share(found.vertex, face, barycentric, projection.point)
            weight = weight * jnp.where(paths.vertices.narrow[found.vertex], share, 1.0)[:, None]
        counts = found.valid & inside & in_front & paths.scatterer(found.vertex).above_horizon(projection.edge_point)
        return projection, jnp.where(counts[:, None], weight, 0.0)

    def _share(self, vertex, face, barycentric, goal):
        """Share of the light from points of emitters that emitter samples account for, by the balance heuristic."""
        scatterer = self.paths.scatterer(vertex)
        detached = jax.tree.map(stop_gradient, self.packed)
        point = material_point(detached, face, barycentric, jnp.ones(face.shape, bool))
        offset = goal - scatterer.point.position
        distance2 = dot(offset, offset)
        distance2 = jnp.where(distance2 > 0, distance2, 1.0)
        towards = offset / jnp.sqrt(distance2)[:, None]
        density = emitter_pdf(detached, point, distance2, jnp.abs(dot(point.normal, towards)))
        total = density + scatterer.pdf(towards)
        return density / jnp.where(total > 0, total, 1.0)


class LobeLines:
    """Geodesic chords around BSDF-sampled directions, for light from everything but area emitters."""

    traces_paths = True

    def __init__(self, packed: PackedScene, prepared: Prepared, paths: PathSegments, settings, reach: float):
        self.packed, self.prepared, self.paths, self.settings, self.reach = packed, prepared, paths, settings, reach

    def search(self, chosen: Chosen, key, room: int):
        """(chords, crossings, weight of the thinning, number of crossings)."""
        key_chord, key_seed = jax.random.split(key)
        lobes, apex = draw_lobe_chords(self.packed, self.paths, chosen, self.reach, key_chord)
        chords = lobes.chords(apex, 2.0 * stop_gradient(self.packed.size()))
        return lobes, *_search(self, chosen, apex, chords, key_seed, room)

    def score(self, drawn, found: Crossings) -> Float[Array, " C"]:
        """Contribution of crossings to the pilot, per radiance: luminance per motion of the edge."""
        seen, scatterer, weight = self._boundary(drawn, found)
        return luminance(weight * scatterer.eval(seen.towards)) / seen.distance

    def value(self, drawn, found: Crossings, number, weight, key) -> Float[Array, "C 3"]:
        """Contributions times `weight`: zero in value, right in derivative."""
        seen, _, value = self._boundary(drawn, found)
        sky = self._environment if self.packed.environment is not None else None
        value = value * weight[:, None]
        return background_term(self.packed, self.paths, seen, value, found.valid, number, key, self.settings, sky)

    def _boundary(self, drawn: LobeChords, found: Crossings):
        """(the crossed edges as seen, BSDFs, contributions without BSDF, radiance and normal velocity)."""
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        lobes = LobeChords(*(table[found.chord] for table in drawn))
        counts = found.valid & scatterer.above_horizon(stop_gradient(seen.edge_point))
        weight = jnp.where(counts, lobe_weight(scatterer, lobes, seen.towards), 0.0)
        return seen, scatterer, self.paths.table.throughput[found.vertex] * weight[:, None]

    def _environment(self, background: SurfacePoint, towards):
        """Emission of what is no surface: of emitters on surfaces the chords on them take care."""
        radiance = emitted(jax.tree.map(stop_gradient, self.packed), background, -towards)
        return jnp.where(background.valid[:, None], 0.0, radiance)


def _projected(lines: EmitterLines, found: Crossings, target: SurfacePoint) -> Float[Array, "C 3"]:
    """Where the crossed edges are projected to, on the planes of the chords' centres; detached."""
    apex = stop_gradient(lines.paths.apex(found.vertex).position)
    target, normal = stop_gradient(target.position)[found.chord], stop_gradient(target.normal)[found.chord]
    ends = stop_gradient(lines.packed.vertices)[lines.packed.edges.vertices[found.edge]]
    offset = ends[:, 0] + found.along[:, None] * (ends[:, 1] - ends[:, 0]) - apex
    slope = dot(normal, offset)
    return apex + offset * (dot(normal, target - apex) / jnp.where(slope == 0, 1.0, slope))[:, None]


def _search(lines: EmitterLines | LobeLines, chosen: Chosen, apex, chords: Chords, key, room: int):
    """(crossings of chords with the silhouettes seen from path vertices, weight of the thinning, their number)."""
    packed, prepared = lines.packed, lines.prepared
    vertex, shape = jnp.maximum(chosen.vertex, 0), packed.face_shape
    bounded = chords.group != UNBOUNDED
    # What a moving edge, apex or far end changes is needed. A background point may be anywhere.
    moves = jnp.zeros(packed.faces.shape[0], jnp.int32)
    moves = moves.at[jnp.where(prepared.group < 0, moves.shape[0], prepared.group)].max(
        prepared.moving[shape].astype(jnp.int32), mode="drop"
    )
    end_moves = apex_moves(packed, prepared, lines.paths, vertex)
    end_moves = end_moves | jnp.where(bounded, moves[jnp.maximum(chords.group, 0)] > 0, True)
    needed = jnp.where(end_moves, jnp.where(bounded, HIDES, BOUNDS), MOVES)
    needed = jnp.where(bounded & prepared.count_layers, HIDES, needed)
    rays = lines.settings.rays
    return find_crossings(packed, prepared.edges, prepared.group, chosen, needed, apex, chords, key, room, rays)
