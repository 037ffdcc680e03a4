"""Line sampling: boundary path integrals from silhouette crossings on random chords, without a radius (DESIGN 2b)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.background import background_term, seen_edges
from jaxdr.boundary.blocks import map_over_blocks, sum_over_blocks
from jaxdr.boundary.chords import (
    Chords,
    EmitterChords,
    LobeChords,
    emitter_chords,
    emitter_rate,
    emitter_weight,
    lobe_chords,
    lobe_rate,
    lobe_weight,
)
from jaxdr.boundary.emitter_planes import chord_inside, emitter_face_at, emitter_groups
from jaxdr.boundary.silhouettes import PathSegments, never_silhouettes, project_edges
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.packed import LUMINANCE, PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave, material_point
from jaxdr.transport.path import PathRecord, PathSettings
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.sampler import lattice
from jaxdr.transport.shading import Scatterer, emitted, emitting_surface_pdf

# Ranks of edges: those that only hide others, those that may bound what is visible, and the moving ones of these.
HIDES, BOUNDS, MOVES = 1, 2, 3
WIDEST = 1.4  # half-length of geodesic chords, radians
ROW = 64  # crossings among which some are kept are rounded together


class Prepared(NamedTuple):
    """What all chunks of an image share.

    `group` numbers the emitters' planes, `moving` tells which shapes move; `count_layers` (static in effect) says
    whether all edges are looked at for segments that only moving ones can bound.
    """

    rank: Float[Array, " E"]
    tree: EdgeTree
    group: Int[Array, " F"]
    moving: Bool[Array, " S"]
    count_layers: Bool[Array, ""]


class _Chosen(NamedTuple):
    """M chords: the path vertices they start from (-1 for unused ones), and 1 / the expected number of chords there."""

    vertex: Int[Array, " M"]
    inverse: Float[Array, " M"]


class _Crossings(NamedTuple):
    """Crossings of chords: the path vertex, chord and edge, the fraction `along` the edge, whether the slot is used."""

    vertex: Int[Array, " C"]
    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    valid: Bool[Array, " C"]


class _Spread(NamedTuple):
    """One kind of chords, how many are expected from every path vertex, and the share of crossings that is kept."""

    lines: "EmitterLines | LobeLines"
    expected: Float[Array, "B P n"]
    kept: Float[Array, ""]
    key: PRNGKeyArray


class LineSampling(eqx.Module):
    """Boundary term of every segment behind the first hit, by line sampling; every field is static.

    Unbiased, and without a radius. Light of area emitters is found by chords on the emitters, all other light
    (environment, indirect) by geodesic chords around BSDF-sampled directions. Where the integrator's sampling is "mis"
    and there are both kinds, both find the light of area emitters.

    - `chords`: chords of each kind per path sample. They need not be as many as the paths: a pilot sends them to the
      pixels whose shadows they find, and to the path vertices that carry most.
    - `pilot`: pilot chords per chord; 0 spreads chords by throughput alone.
    - `floor`: importance that every pixel keeps, relative to the mean over pixels.
    - `reach`: half-length of geodesic chords, relative to the lobe's width (`BSDF.lobe_width`); at most 1.4 radians.
    - `backgrounds`: paths traced from what lies behind silhouettes, per path sample.
    - `capacity`: room for crossings, as a share of the number of chords. What exceeds it is thinned at random without
      bias, with a warning.
    """

    chords: float = eqx.field(static=True, default=1.0)
    pilot: float = eqx.field(static=True, default=0.25)
    floor: float = eqx.field(static=True, default=0.2)
    reach: float = eqx.field(static=True, default=1.0)
    backgrounds: float = eqx.field(static=True, default=1.0)
    capacity: float = eqx.field(static=True, default=4.0)

    def __check_init__(self):
        for name in ("chords", "floor", "reach", "backgrounds", "capacity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LineSampling: {name} must be positive, got {getattr(self, name)}")
        if not self.pilot >= 0:
            raise ValueError(f"LineSampling: pilot must not be negative, got {self.pilot}")

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Prepared:
        """Ranks of the edges and the tree over them, once for a whole image. `moving`: which shapes can move."""
        edges, flags = packed.edges, jnp.asarray(moving)
        rank = jnp.where(flags[edges.shape], MOVES, BOUNDS)
        rank = jnp.where(never_silhouettes(packed), HIDES, rank).astype(packed.vertices.dtype)
        tree = queries.edge_tree(
            packed.vertices, edges.vertices, edges.opposite, edges.interior, rank, packed.edge_counts, settings.rays
        )
        faces = np.diff(packed.first_face)
        still = faces[~np.asarray(moving)].sum()
        group = jnp.full(packed.faces.shape[0], -1, jnp.int32)
        if packed.has_area_emitters:
            group = emitter_groups(packed)
        return Prepared(rank, tree, group, flags, jnp.asarray(bool(still <= faces.sum() // 2)))

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
        paths = PathSegments(packed, primary, record.direct)
        key_emitters, key_lobes = jax.random.split(key)
        carries = luminance(paths.table.throughput)
        emitters = lobes = None
        if packed.has_area_emitters:
            lines = EmitterLines(packed, prepared, paths, settings)
            emitters = self._spread(lines, carries, key_emitters)
        if packed.environment is not None or settings.max_depth > 2:
            if packed.environment is None:  # nothing is gathered behind the last bounce
                carries = jnp.where(jnp.arange(paths.count) < paths.count - paths.paths, carries, 0.0)
            lines = LobeLines(packed, prepared, paths, settings, self.reach)
            lobes = self._spread(lines, carries, key_lobes)
        if emitters is not None and lobes is not None and settings.mis:
            both = Centres(packed, prepared, paths, self.reach, emitters.expected, lobes.expected * lobes.kept)
            emitters.lines.both = lobes.lines.both = both
        for spread in (emitters, lobes):
            if spread is not None:
                total = total + self._term(spread)
        return total

    def _spread(self, lines: "EmitterLines | LobeLines", carries, key) -> _Spread:
        """How many chords of one kind go where; `carries` is the importance of every path vertex."""
        paths = lines.paths
        _, _, width, height = paths.packed.camera.film.window
        pixels, samples = width * height, paths.paths // (width * height)
        layout = (paths.count // paths.paths, pixels, samples)
        key_pilot, key_pilot_chords, key_rest = jax.random.split(key, 3)
        chords = self.chords * paths.paths
        importance = carries.reshape(layout)
        kept = jnp.ones((), importance.dtype)
        if self.pilot > 0:
            count = self.pilot * chords
            chosen = _Chosen(*allocate(shares(importance, count), capacity(round(count), pixels), key_pilot))
            drawn, found, thinned, used = lines.search(chosen, key_pilot_chords, self._room(count))

            def scores(block: _Crossings, number):
                score = lines.score(drawn, block) * (thinned / jnp.where(block.valid, carries[block.vertex], 1.0))
                score = jnp.where(block.valid & (number < used), score, 0.0)
                return jnp.zeros(chosen.vertex.shape[0], score.dtype).at[block.chord].add(score)

            per_chord = sum_over_blocks(scores, found, used)
            pixel = paths.path(jnp.maximum(chosen.vertex, 0)) // samples
            of_pixel = pixel_importance(per_chord, pixel, chosen.vertex >= 0, (height, width), self.floor)
            importance = stop_gradient(importance * of_pixel[None, :, None])
            if lines.traces_paths:
                kept = jnp.minimum(kept, self.backgrounds * self.pilot * paths.paths / jnp.maximum(used * thinned, 1))
        return _Spread(lines, shares(importance, chords), kept, key_rest)

    def _term(self, spread: _Spread) -> Float[Array, "N 3"]:
        """Boundary term of one kind of light."""
        lines, paths = spread.lines, spread.lines.paths
        key_main, key_chords, key_values = jax.random.split(spread.key, 3)
        chords = self.chords * paths.paths
        room = capacity(round(chords), spread.expected.shape[1])
        chosen = _Chosen(*allocate(spread.expected, room, key_main))
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

    def _kept(self, lines: "LobeLines", drawn, found: _Crossings, weight, used, key):
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


class Centres(NamedTuple):
    """Both kinds of chords as ways to find the same crossings (MIS in the space of crossings, balance heuristic).

    `emitters` and `lobes` are the expected numbers of chords from every path vertex, [B, P, n].
    """

    packed: PackedScene
    prepared: Prepared
    paths: PathSegments
    reach: float
    emitters: Float[Array, "B P n"]
    lobes: Float[Array, "B P n"]

    def share_of_emitters(
        self, vertex: Int[Array, " C"], plane: Float[Array, "C 3"], point: SurfacePoint, pdf, length
    ) -> Float[Array, " C"]:
        """Share of chords on emitters in finding boundary points of emitters, in planes with the normals `plane`.

        `pdf` of their centres, per area, and their `length`.
        """
        scatterer = self.paths.scatterer(vertex)
        position, normal = stop_gradient(point.position), stop_gradient(point.normal)
        apex = scatterer.point.position
        reach = lobe_reach(scatterer, self.reach)
        one = emitter_rate(pdf, length, apex, position, normal, plane) * self.emitters.reshape(-1)[vertex]
        two = lobe_rate(scatterer, reach, plane, normalize(position - apex)) * self.lobes.reshape(-1)[vertex]
        either = one + two > 0
        return jnp.where(either, one / jnp.where(either, one + two, 1.0), 1.0)

    def share_of_lobes(
        self, vertex: Int[Array, " C"], plane: Float[Array, "C 3"], point: SurfacePoint
    ) -> Float[Array, " C"]:
        """The rest: share of geodesic chords."""
        normal = stop_gradient(point.normal)
        along = jnp.cross(plane, normal)
        meets = (dot(along, along) > 0) & point.valid
        along = normalize(jnp.where(meets[:, None], along, 1.0))
        _, _, length = chord_inside(self.packed, self.prepared.group, point.face, stop_gradient(point.position), along)
        pdf = emitting_surface_pdf(self.packed, point)
        return jnp.where(meets, 1.0 - self.share_of_emitters(vertex, plane, point, pdf, length), 0.0)


class EmitterLines:
    """Chords on area emitters, for their light."""

    traces_paths = False

    def __init__(self, packed: PackedScene, prepared: Prepared, paths: PathSegments, settings: PathSettings):
        self.packed, self.prepared, self.paths, self.settings = packed, prepared, paths, settings
        self.both: Centres | None = None

    def search(self, chosen: _Chosen, key, room: int):
        """(chords, crossings, weight of the thinning, number of crossings)."""
        key_chord, key_seed = jax.random.split(key)
        u = lattice(key_chord, 1, jnp.arange(chosen.vertex.shape[0]), 3, self.packed.vertices.dtype)[0]
        scatterer = self.paths.scatterer(jnp.maximum(chosen.vertex, 0))
        drawn = emitter_chords(self.packed, self.prepared.group, scatterer.point.position, u)
        # Off the surface on the side that scatters, whatever the chord's centre: a chord may cross the horizon.
        apex = leave(scatterer.point, scatterer.normal)
        return drawn, *_search(self, chosen, apex, drawn.chords, key_seed, room)

    def score(self, drawn: EmitterChords, found: _Crossings) -> Float[Array, " C"]:
        """Contribution of crossings to the pilot: luminance per motion of the edge."""
        projection, weight, _ = self._boundary(drawn, found)
        return luminance(weight) / jnp.where(projection.fraction > 0, projection.fraction, 1.0)

    def value(self, drawn: EmitterChords, found: _Crossings, number, weight, key) -> Float[Array, "C 3"]:
        """Contributions times `weight`: zero in value, right in derivative."""
        del number, key
        projection, value, point = self._boundary(drawn, found)
        if self.both is not None:
            chords = jax.tree.map(lambda table: table[found.chord], drawn.chords)
            plane = chords.plane(stop_gradient(self.paths.apex(found.vertex).position))
            pdf, length = drawn.pdf[found.chord], drawn.length[found.chord]
            weight = weight * self.both.share_of_emitters(found.vertex, plane, point, pdf, length)
        moved = projection.displacement - stop_gradient(projection.displacement)
        return value * (weight * moved)[:, None]

    def _boundary(self, drawn: EmitterChords, found: _Crossings):
        """(the crossed edges projected onto the emitter, contributions without their normal velocity, the points)."""
        packed, paths, group = self.packed, self.paths, self.prepared.group
        face = drawn.centre.face[found.chord]
        on_plane = _projected(self, found, drawn.centre)
        # The chord may have left the triangle its centre is in, whose vertices move otherwise.
        face, barycentric, inside = emitter_face_at(packed, group, face, on_plane)
        ends = paths.ends_to(found.vertex, face, barycentric, jnp.zeros_like(inside), jnp.zeros_like(barycentric))
        projection = project_edges(packed, found.edge, ends, found.along)
        point = jax.tree.map(stop_gradient, material_point(packed, face, barycentric, inside))
        # The radiance there and not at the centre; none from behind.
        radiance = stop_gradient(emitted(packed, point, stop_gradient(ends.apex) - projection.point))
        value = paths.table.throughput[found.vertex] * radiance
        value = value * emitter_weight(drawn.pdf, drawn.length)[found.chord][:, None]
        value = value * paths.transfer(found.vertex, ends, projection.point)
        counts = found.valid & inside & paths.scatterer(found.vertex).above_horizon(projection.edge_point)
        return projection, jnp.where(counts[:, None], value, 0.0), point


class LobeLines:
    """Geodesic chords around BSDF-sampled directions, for light from everything but area emitters.

    With `both`, for their share of the light from area emitters as well.
    """

    traces_paths = True

    def __init__(self, packed: PackedScene, prepared: Prepared, paths: PathSegments, settings, reach: float):
        self.packed, self.prepared, self.paths, self.settings, self.reach = packed, prepared, paths, settings, reach
        self.both: Centres | None = None

    def search(self, chosen: _Chosen, key, room: int):
        """(chords, crossings, weight of the thinning, number of crossings)."""
        key_chord, key_seed = jax.random.split(key)
        u = lattice(key_chord, 1, jnp.arange(chosen.vertex.shape[0]), 3, self.packed.vertices.dtype)[0]
        scatterer = self.paths.scatterer(jnp.maximum(chosen.vertex, 0))
        lobes = lobe_chords(scatterer, lobe_reach(scatterer, self.reach), u)
        apex = leave(scatterer.point, scatterer.normal)
        chords = lobes.chords(apex, 2.0 * stop_gradient(self.packed.size()))
        return lobes, *_search(self, chosen, apex, chords, key_seed, room)

    def score(self, drawn: LobeChords, found: _Crossings) -> Float[Array, " C"]:
        """Contribution of crossings to the pilot, per radiance: luminance per motion of the edge."""
        seen, scatterer, weight = self._boundary(drawn, found)
        return luminance(weight * scatterer.eval(seen.towards)) / seen.distance

    def value(self, drawn: LobeChords, found: _Crossings, number, weight, key) -> Float[Array, "C 3"]:
        """Contributions times `weight`: zero in value, right in derivative."""
        seen, _, value = self._boundary(drawn, found)
        value = value * weight[:, None]
        plane = drawn.plane[found.chord]

        def emission(background: SurfacePoint, towards):
            """Emission of what is no surface, and this technique's share of that of surfaces."""
            radiance = emitted(jax.tree.map(stop_gradient, self.packed), background, -towards)
            surfaces = 0.0 if self.both is None else self.both.share_of_lobes(found.vertex, plane, background)
            return radiance * jnp.where(background.valid, surfaces, 1.0)[:, None]

        glows = self.packed.environment is not None or self.both is not None
        return background_term(
            self.packed, self.paths, seen, value, found.valid, number, key, self.settings, emission if glows else None
        )

    def _boundary(self, drawn: LobeChords, found: _Crossings):
        """(the crossed edges as seen, BSDFs, contributions without BSDF, radiance and normal velocity)."""
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        lobes = LobeChords(*(table[found.chord] for table in drawn))
        counts = found.valid & scatterer.above_horizon(stop_gradient(seen.edge_point))
        weight = jnp.where(counts, lobe_weight(scatterer, lobes, seen.towards), 0.0)
        return seen, scatterer, self.paths.table.throughput[found.vertex] * weight[:, None]


def lobe_reach(scatterer: Scatterer, reach: float) -> Float[Array, " M"]:
    """Half-length of geodesic chords (radians), `reach` of the lobes' widths."""
    return jnp.minimum(reach * scatterer.lobe_width(), WIDEST)


def luminance(rgb: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Of linear RGB."""
    return rgb @ jnp.asarray(LUMINANCE, rgb.dtype)


def _projected(lines: EmitterLines, found: _Crossings, target: SurfacePoint) -> Float[Array, "C 3"]:
    """Where the crossed edges are projected to, on the planes of the chords' centres; detached."""
    apex = stop_gradient(lines.paths.apex(found.vertex).position)
    target, normal = stop_gradient(target.position)[found.chord], stop_gradient(target.normal)[found.chord]
    ends = stop_gradient(lines.packed.vertices)[lines.packed.edges.vertices[found.edge]]
    offset = ends[:, 0] + found.along[:, None] * (ends[:, 1] - ends[:, 0]) - apex
    slope = dot(normal, offset)
    return apex + offset * (dot(normal, target - apex) / jnp.where(slope == 0, 1.0, slope))[:, None]


def _search(lines: "EmitterLines | LobeLines", chosen: _Chosen, apex, chords: Chords, key, room: int):
    """(crossings of chords with the silhouettes seen from path vertices, weight of the thinning, their number)."""
    packed, prepared, edges = lines.packed, lines.prepared, lines.packed.edges
    vertex, shape = jnp.maximum(chosen.vertex, 0), packed.face_shape
    bounded = chords.group != queries.UNBOUNDED
    # What a moving edge, apex or far end changes is needed. A background point may be anywhere.
    moves = jnp.zeros(packed.faces.shape[0], jnp.int32)
    moves = moves.at[jnp.where(prepared.group < 0, moves.shape[0], prepared.group)].max(
        prepared.moving[shape].astype(jnp.int32), mode="drop"
    )
    end_moves = prepared.moving[shape[lines.paths.table.apex_face[vertex]]]
    end_moves = end_moves | jnp.where(bounded, moves[jnp.maximum(chords.group, 0)] > 0, True)
    needed = jnp.where(end_moves, jnp.where(bounded, HIDES, BOUNDS), MOVES)
    needed = jnp.where(bounded & prepared.count_layers, HIDES, needed)
    needed = jnp.where((chosen.vertex >= 0) & chords.useful, needed, 0)
    found = queries.sector_crossings(
        prepared.tree, packed.vertices, packed.faces, edges.vertices, edges.faces, prepared.rank, prepared.group,
        apex, chords.first, chords.last, chords.centre, needed.astype(apex.dtype), chords.group,
        jax.random.randint(key, (), 0, 1 << 30), HIDES, room, lines.settings.rays,
    )  # fmt: skip
    valid = found.chord >= 0
    chord = jnp.where(valid, found.chord, 0)
    crossings = _Crossings(vertex[chord], chord, found.edge, found.along.astype(apex.dtype), valid)
    return crossings, found.weight.astype(apex.dtype), valid.sum()
