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
from jaxdr.boundary.chords import Chords, LobeChords, emitter_chords, lobe_chords, lobe_weight
from jaxdr.boundary.emitter_planes import emitter_groups, inside_emitter
from jaxdr.boundary.silhouettes import PathSegments, SegmentEnds, never_silhouettes, project_edges
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree, build_edge_tree
from jaxdr.geometry.vector import dot
from jaxdr.scene.packed import LUMINANCE, PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave
from jaxdr.transport.path import PathRecord, PathSettings
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.sampler import lattice
from jaxdr.transport.shading import emitted

# Ranks of edges: those that only hide others, those that may bound what is visible, and the moving ones of these.
HIDES, BOUNDS, MOVES = 1, 2, 3


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


class _Crossings(NamedTuple):
    """Crossings of chords: `chord`, `edge`, `along` it, whether the slot is used, and the thinning's weight."""

    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    valid: Bool[Array, " C"]
    weight: Float[Array, ""]


class LineSampling(eqx.Module):
    """Boundary term of every segment behind the first hit, by line sampling; every field is static.

    Unbiased, and without a radius. Light of area emitters is found by chords on the emitters, all other light
    (environment, indirect) by geodesic chords around BSDF-sampled directions.

    - `chords`: chords of each kind per path sample. They need not be as many as the paths: a pilot sends them to the
      pixels whose shadows they find, and to the path vertices that carry most.
    - `pilot`: pilot chords per chord; 0 spreads chords by throughput alone.
    - `floor`: importance that every pixel keeps, relative to the mean over pixels.
    - `reach`: half-length of geodesic chords, relative to the lobe's width (`BSDF.lobe_width`); at most 1.4 radians.
    - `capacity`: room for crossings, as a share of the number of chords. What exceeds it is thinned at random without
      bias, with a warning.
    """

    chords: float = eqx.field(static=True, default=1.0)
    pilot: float = eqx.field(static=True, default=0.25)
    floor: float = eqx.field(static=True, default=0.2)
    reach: float = eqx.field(static=True, default=1.0)
    capacity: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        for name in ("chords", "floor", "reach", "capacity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LineSampling: {name} must be positive, got {getattr(self, name)}")
        if not self.pilot >= 0:
            raise ValueError(f"LineSampling: pilot must not be negative, got {self.pilot}")

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...]) -> Prepared:
        """Ranks of the edges and the tree over them, once for a whole image. `moving`: which shapes can move."""
        edges, flags = packed.edges, jnp.asarray(moving)
        rank = jnp.where(flags[edges.shape], MOVES, BOUNDS)
        rank = jnp.where(never_silhouettes(packed), HIDES, rank).astype(packed.vertices.dtype)
        tree = build_edge_tree(packed.vertices, edges.vertices, edges.opposite, edges.interior, rank, packed.edge_counts)
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
        if packed.has_area_emitters:
            total = total + self._emitter_term(packed, prepared, paths, key_emitters, settings)
        if packed.environment is not None or settings.max_depth > 2:
            total = total + self._lobe_term(packed, prepared, paths, key_lobes, settings)
        return total

    # Light of area emitters, by chords on them.

    def _emitter_term(self, packed, prepared: Prepared, paths: PathSegments, key, settings):
        carries = luminance(paths.table.throughput)

        def crossings(segment, inverse, key, room):
            return _emitter_crossings(packed, prepared, paths, segment, inverse, key, room, settings)

        def score(found: _EmitterCrossings):
            fraction = jnp.where(found.projection.fraction > 0, found.projection.fraction, 1.0)
            return luminance(found.weight) / fraction

        segment, inverse, key, room = self._allocated(packed, paths, carries, crossings, score, key)
        found = crossings(segment, inverse, key, room)
        displacement = found.projection.displacement
        value = found.weight * (displacement - stop_gradient(displacement))[:, None]
        return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(found.segment)].add(value)

    # Everything else, by chords in the directions that BSDFs choose.

    def _lobe_term(self, packed, prepared: Prepared, paths: PathSegments, key, settings):
        carries = luminance(paths.table.throughput)
        if packed.environment is None:  # nothing is gathered behind the last bounce
            carries = jnp.where(jnp.arange(paths.count) < paths.count - paths.paths, carries, 0.0)

        def crossings(segment, inverse, key, room):
            return self._lobe_crossings(packed, prepared, paths, segment, inverse, key, room, settings)

        def score(found: _LobeCrossings):
            return luminance(found.weight) * found.lobe / found.seen.distance

        key, key_path = jax.random.split(key)
        segment, inverse, key, room = self._allocated(packed, paths, carries, crossings, score, key)
        found = crossings(segment, inverse, key, room)

        def emission(background: SurfacePoint, towards):
            radiance = emitted(packed_detached, background, -towards)
            # Of emitters on surfaces the chords on them take care.
            return jnp.where(background.valid[:, None], 0.0, radiance)

        packed_detached = jax.tree.map(stop_gradient, packed)
        sky = emission if packed.environment is not None else None
        return background_term(packed, paths, found.seen, found.weight, found.valid, key_path, settings, sky)

    def _lobe_crossings(self, packed, prepared: Prepared, paths: PathSegments, segment, inverse, key, room, settings):
        key_chord, key_seed = jax.random.split(key)
        used, vertex = segment >= 0, jnp.maximum(segment, 0)
        u = lattice(key_chord, 1, jnp.arange(segment.shape[0]), 3, packed.vertices.dtype)[0]
        scatterer = paths.scatterer(vertex)
        width = jnp.minimum(self.reach * scatterer.lobe_width(), 1.4)
        lobes = lobe_chords(scatterer, width, u)
        apex = leave(scatterer.point, lobes.centre)
        chords = lobes.chords(apex, 2.0 * stop_gradient(packed.size()))
        found = _search(packed, prepared, paths, vertex, apex, chords, used, key_seed, room, settings)
        chosen = vertex[found.chord]
        seen = seen_edges(packed, paths, chosen, found.edge, found.along, found.valid)
        there = paths.scatterer(chosen)
        lobes = LobeChords(*(table[found.chord] for table in lobes))
        weight = inverse[found.chord] * found.weight * lobe_weight(there, lobes, seen.towards)
        weight = jnp.where(found.valid, weight, 0.0)[:, None] * paths.table.throughput[chosen]
        lobe = luminance(there.eval(seen.towards))
        return _LobeCrossings(chosen, found.chord, seen, weight, lobe, found.valid)

    def _allocated(self, packed, paths: PathSegments, carries, crossings, score, key):
        """(path vertex of each chord or -1, 1 / its expected number of chords, key, room for crossings)."""
        _, _, width, height = packed.camera.film.window
        pixels, samples = width * height, paths.paths // (width * height)
        layout = (paths.count // paths.paths, pixels, samples)
        key_pilot, key_pilot_chords, key_main, key_chords = jax.random.split(key, 4)
        chords = self.chords * paths.paths
        importance = carries.reshape(layout)
        if self.pilot > 0:
            count = self.pilot * chords
            segment, inverse = allocate(shares(importance, count), capacity(round(count), pixels), key_pilot)
            room = max(1024, round(self.capacity * count))
            found = crossings(segment, jnp.ones_like(inverse), key_pilot_chords, room)
            mark = score(found) / jnp.where(found.valid, carries[found.segment], 1.0)
            per_chord = jnp.zeros(segment.shape[0], mark.dtype).at[found.chord].add(jnp.where(found.valid, mark, 0.0))
            pixel = paths.path(jnp.maximum(segment, 0)) // samples
            of_pixel = pixel_importance(per_chord, pixel, segment >= 0, (height, width), self.floor)
            importance = importance * of_pixel[None, :, None]
        importance = stop_gradient(importance)
        segment, inverse = allocate(shares(importance, chords), capacity(round(chords), pixels), key_main)
        return segment, inverse, key_chords, max(4096, round(self.capacity * chords))


class _EmitterCrossings(NamedTuple):
    """Boundary points on emitters: `weight` is all but their normal velocity."""

    segment: Int[Array, " C"]
    chord: Int[Array, " C"]
    projection: eqx.Module
    weight: Float[Array, "C 3"]
    valid: Bool[Array, " C"]


class _LobeCrossings(NamedTuple):
    """Boundary points around path vertices: `weight` is all but BSDF (luminance: `lobe`), radiance and velocity."""

    segment: Int[Array, " C"]
    chord: Int[Array, " C"]
    seen: NamedTuple
    weight: Float[Array, "C 3"]
    lobe: Float[Array, " C"]
    valid: Bool[Array, " C"]


def luminance(rgb: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Of linear RGB."""
    return rgb @ jnp.asarray(LUMINANCE, rgb.dtype)


def _emitter_crossings(
    packed, prepared: Prepared, paths: PathSegments, segment, inverse, key, room, settings
) -> _EmitterCrossings:
    key_chord, key_seed = jax.random.split(key)
    used, vertex = segment >= 0, jnp.maximum(segment, 0)
    u = lattice(key_chord, 1, jnp.arange(segment.shape[0]), 3, packed.vertices.dtype)[0]
    point = jax.tree.map(stop_gradient, paths.apex(vertex))
    chords, sample = emitter_chords(packed, prepared.group, point.position, u)
    towards = sample.point.position - point.position
    apex = leave(point, towards)
    found = _search(packed, prepared, paths, vertex, apex, chords, used, key_seed, room, settings)
    chosen, face = vertex[found.chord], sample.point.face[found.chord]
    infinite = jnp.zeros_like(found.valid)
    ends: SegmentEnds = paths.ends_to(
        chosen, face, sample.point.barycentric[found.chord], infinite, sample.direction[found.chord]
    )
    projection = project_edges(packed, found.edge, ends, found.along)
    valid = found.valid & inside_emitter(packed, prepared.group, face, projection.point)
    valid = valid & (dot(stop_gradient(ends.normal), stop_gradient(ends.apex) - projection.point) > 0)
    weight = paths.table.throughput[chosen] * chords.weight[found.chord] * paths.transfer(chosen, ends, projection.point)
    weight = weight * (inverse[found.chord] * found.weight)[:, None]
    return _EmitterCrossings(chosen, found.chord, projection, jnp.where(valid[:, None], weight, 0.0), valid)


def _search(
    packed, prepared: Prepared, paths: PathSegments, vertex, apex, chords: Chords, used, key, room, settings
) -> _Crossings:
    """Crossings of chords with the silhouettes seen from path vertices."""
    bounded = chords.group != queries.UNBOUNDED
    shape = packed.face_shape
    end_moves = prepared.moving[shape[paths.table.apex_face[vertex]]]
    # The plane of a chord on an emitter belongs to a face that may move as well; a background point may be anything.
    moves = jnp.zeros(packed.faces.shape[0], jnp.int32)
    moves = moves.at[jnp.where(prepared.group < 0, moves.shape[0], prepared.group)].max(
        prepared.moving[shape].astype(jnp.int32), mode="drop"
    )
    end_moves = end_moves | jnp.where(bounded, moves[jnp.maximum(chords.group, 0)] > 0, True)
    needed = jnp.where(end_moves, jnp.where(bounded, HIDES, BOUNDS), MOVES)
    needed = jnp.where(bounded & prepared.count_layers, HIDES, needed)
    needed = jnp.where(used & (chords.weight != 0).any(-1), needed, 0)
    edges = packed.edges
    found = queries.sector_crossings(
        prepared.tree, packed.vertices, packed.faces, edges.vertices, edges.faces, prepared.rank, prepared.group,
        apex, chords.first, chords.last, chords.centre, needed.astype(apex.dtype), chords.group,
        jax.random.randint(key, (), 0, 1 << 30), HIDES, room, settings.rays,
    )  # fmt: skip
    valid = found.chord >= 0
    return _Crossings(
        jnp.where(valid, found.chord, 0), found.edge, found.along.astype(apex.dtype), valid, found.weight
    )
