"""Ordinary paths projected to silhouettes (Zhang, Roussel and Jakob 2023): lines past edges that are likely to count.

A path here is the first hit of a film point and an emitter sample: four uniform numbers. Take the numbers of a path
whose emitter is hidden, and those of a path that sees its emitter. Between them lies a path at the border of a shadow.
Halving the interval leads there, and the face that hides the last hidden path has an edge beside it. All such lines
lead from a point that the film shows to an emitter, even if both are small.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.boundary.guided_edges.boundary_segments import BoundaryEnds, BoundarySegments, lines_past
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, LunePoints, passing
from jaxdr.boundary.shared.face_neighbours import connect_faces
from jaxdr.geometry import queries
from jaxdr.geometry.bundles import passes
from jaxdr.geometry.vector import dot, norm, scale
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.emission import EmitterSample, sample_emitter
from jaxdr.transport.interaction import SurfacePoint, intersect, leave, on_fixed_ray
from jaxdr.transport.sampler import lattice

HALVINGS = 14  # of the numbers between a hidden path and a lit one
STEPS = 4  # from face to face, until one has an edge that is a silhouette


class ShadowRays(NamedTuple):
    """Paths to emitters: the `first` hit, the `emitter` sample, and the `occluder`, the face between them (-1: none).

    `there`: the path exists, and the emitter sends light towards the first hit.
    """

    first: SurfacePoint
    emitter: EmitterSample
    occluder: Int[Array, " n"]
    there: Bool[Array, " n"]


def shadow_rays(packed: PackedScene, u: Float[Array, "n 4"], rays: str) -> ShadowRays:
    """Paths from two numbers for the film point and two for the emitter; with an aperture, through its middle."""
    camera = packed.camera
    x0, y0, width, height = camera.film.window
    view = camera.view(jnp.full((u.shape[0], 2), 0.5, u.dtype) if camera.aperture else None)
    film_point = jnp.asarray([x0, y0], u.dtype) + u[:, :2] * jnp.asarray([width, height], u.dtype)
    origin, direction = view.rays(film_point)
    origin = jnp.broadcast_to(origin, direction.shape)
    start, reach = view.clipped(origin, direction)
    seen = intersect(packed, start, direction, jnp.ones(u.shape[0], bool), rays, reach)
    first = on_fixed_ray(packed, origin, direction, seen.face, seen.barycentric)

    sample = sample_emitter(packed, u[:, 2:])
    towards = jnp.where(sample.infinite[:, None], sample.direction, sample.point.position - first.position)
    start = leave(first, towards)
    there = first.valid & sample.shines_on(towards)
    offset = leave(sample.point, -towards) - start
    offset = jnp.where(sample.infinite[:, None], 2.0 * packed.size * sample.direction, offset)
    reach = jnp.where(there, 1.0, 0.0).astype(u.dtype)
    hit = queries.closest_hit(packed.geometry, queries.Rays(start, offset, reach), rays)
    return ShadowRays(first, sample, jnp.where(there, hit.face, -1), there)


def project_paths(
    packed: PackedScene, lunes: EdgeLunes, count: int, key: PRNGKeyArray, rays: str
) -> tuple[BoundarySegments, BoundaryEnds]:
    """`count` lines past edges, from as many paths. They are not `valid` if no edge is found or no path is hidden."""
    key_paths, key_pairs = jax.random.split(key)
    u = lattice(key_paths, 1, jnp.arange(count), 4, packed.vertices.dtype)
    paths = shadow_rays(packed, u, rays)
    hidden, lit = paths.occluder >= 0, paths.there & (paths.occluder < 0)
    both = hidden.any() & lit.any()
    one = rows_where(hidden, count)[jnp.arange(count) % jnp.maximum(hidden.sum(), 1)]
    chosen = jax.random.randint(key_pairs, (count,), 0, jnp.maximum(lit.sum(), 1))
    other = rows_where(lit, count)[chosen]
    # Half of the pairs share their emitter numbers, half their film point. A pair with two emitter points seldom has
    # the rim of the emitter between them.
    part = jnp.arange(4) < 2
    outside = jnp.where(part == (jnp.arange(count) % 2 == 0)[:, None], u[other], u[one])
    end = shadow_rays(packed, outside, rays)
    outside = jnp.where((end.there & (end.occluder < 0))[:, None], outside, u[other])

    def halve(_, interval):
        inside, outside = interval
        middle = 0.5 * (inside + outside)
        still = (shadow_rays(packed, middle, rays).occluder >= 0)[:, None]
        return jnp.where(still, middle, inside), jnp.where(still, outside, middle)

    inside, _ = loops.fori_loop(0, HALVINGS, halve, (u[one], outside))
    last = shadow_rays(packed, inside, rays)
    point, found = _nearest_silhouettes(packed, lunes, last)
    drawn = lines_past(lunes, point, last.emitter.direction_from(point.position(lunes)))
    return drawn, BoundaryEnds(last.first, last.emitter.point, both & found & drawn.silhouette)


def _nearest_silhouettes(
    packed: PackedScene, lunes: EdgeLunes, path: ShadowRays
) -> tuple[LunePoints, Bool[Array, " n"]]:
    """(the points nearest to paths on silhouette edges of the faces that hide emitters, whether there is one)."""
    sides, behind = _rows_at(packed, lunes), connect_faces(packed).behind
    origin, emitter = path.first.position, path.emitter
    towards = emitter.direction_from(origin)
    each = [jnp.repeat(a[:, None], 3, axis=1) for a in (origin, towards)]

    def step(_, state):
        face, came, row, along, found = state
        rows = sides[face]
        start, side = lunes.start[rows], lunes.side[rows]
        on_edge = jnp.clip(passes(each[0], each[1], start, side).along, 0.0, 1.0)
        offset = start + scale(side, on_edge) - each[0]
        miss = norm(offset - scale(each[1], dot(offset, each[1])))
        silhouette = passing(lunes, rows.reshape(-1), each[1].reshape(-1, 3)).silhouette.reshape(rows.shape)
        here = silhouette.any(1) & ~found
        best = jnp.where(silhouette, miss, jnp.inf).argmin(1)[:, None]
        row = jnp.where(here, jnp.take_along_axis(rows, best, 1)[:, 0], row)
        along = jnp.where(here, jnp.take_along_axis(on_edge, best, 1)[:, 0], along)
        # Go on over the side that is nearest to the path, but not back over the side of the last step.
        over = jnp.where(rows == came[:, None], jnp.inf, miss).argmin(1)[:, None]
        beyond = jnp.take_along_axis(behind[face], over, 1)[:, 0]
        came = jnp.take_along_axis(rows, over, 1)[:, 0]
        return jnp.where(beyond >= 0, beyond, face), came, row, along, found | here

    zero = jnp.zeros_like(path.occluder)
    start = jnp.maximum(path.occluder, 0), zero - 1, zero, jnp.zeros_like(origin[:, 0]), zero > 0
    _, _, row, along, found = loops.fori_loop(0, STEPS, step, start)
    return LunePoints(row, along), found & (path.occluder >= 0)


def _rows_at(packed: PackedScene, lunes: EdgeLunes) -> Int[Array, "F 3"]:
    """Rows of the edges of all faces; side k lies opposite corner k."""
    faces, opposite = packed.edges.faces[lunes.edge], packed.edges.opposite[lunes.edge]
    table = jnp.zeros(packed.faces.shape, jnp.int32)
    for k in range(faces.shape[1]):
        face = jnp.where(faces[:, k] >= 0, faces[:, k], packed.faces.shape[0])
        side = (packed.faces[jnp.maximum(faces[:, k], 0)] == opposite[:, k, None]).argmax(1)
        table = table.at[face, side].set(jnp.arange(faces.shape[0], dtype=jnp.int32), mode="drop")
    return table
