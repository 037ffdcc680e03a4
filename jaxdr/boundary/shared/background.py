"""Silhouettes in a direction from path vertices, and the radiance of what lies behind them.

This is the integral of f V dl over directions, for light that emitter sampling does not find. f is the BSDF times the
radiance past the edge. A ray past the edge and a path from its hit estimate this radiance, so nothing is evaluated away
from the boundary.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.path_segments import PathSegments, on_face, path_segments
from jaxdr.boundary.shared.projection import horizon_normal, occluded_side, past_edge
from jaxdr.boundary.shared.term import Chunk, Context, stream_of
from jaxdr.geometry import queries
from jaxdr.geometry.vector import between, corners, dot, norm, scale
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave, material_hit
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.radiance import Answers, Requests, request
from jaxdr.transport.sampler import lattice
from jaxdr.transport.shading import Scatterer


class SeenEdges(NamedTuple):
    """Points at fractions `along` edges, as seen from the apexes of segments.

    `edge_point`, `moving_apex` and `apex_triangle` (the corners of the apex's face) are differentiable, all else is
    detached. `pole` is the unit normal of the plane through apex and edge, towards the occluded side. `own` marks edges
    of the face that the apex lies in (horizons).
    """

    segment: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    apex: Float[Array, "C 3"]
    moving_apex: Float[Array, "C 3"]
    apex_triangle: Float[Array, "C 3 3"]
    edge_point: Float[Array, "C 3"]
    distance: Float[Array, " C"]
    towards: Float[Array, "C 3"]
    pole: Float[Array, "C 3"]
    own: Bool[Array, " C"]


def seen_edges(
    packed: PackedScene,
    paths: PathSegments,
    segment: Int[Array, " C"],
    edge: Int[Array, " C"],
    along: Float[Array, " C"],
    valid: Bool[Array, " C"],
) -> SeenEdges:
    """The points at the fractions `along` of edges."""
    start, end = corners(packed.ends_of(edge))
    apex_face = paths.table.apex_face[segment]
    triangle = packed.corners_of(apex_face)
    edge_point, moving_apex = between(start, end, along), paths.position(segment, triangle)
    fixed_ends, fixed_point, apex, fixed_triangle = stop_gradient(((start, end), edge_point, moving_apex, triangle))
    to_edge = fixed_point - apex
    distance = jnp.where(valid, norm(to_edge), 1.0)
    towards = scale(to_edge, 1.0 / distance)
    pole, own = occluded_side(packed, edge, fixed_ends, apex, apex_face, fixed_triangle)
    return SeenEdges(segment, edge, along, apex, moving_apex, triangle, edge_point, distance, towards, pole, own)


class Behind(NamedTuple):
    """Boundary points of C slots with the surface that is seen past the edge; detached.

    `weight` times radiance times velocity is the contribution; the weight is zero where nothing counts. The background
    is a material point, or the environment if nothing is `hit`.
    """

    segment: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    weight: Float[Array, "C 3"]
    face: Int[Array, " C"]
    barycentric: Float[Array, "C 3"]
    hit: Bool[Array, " C"]


class BehindEdges(NamedTuple):
    """Boundary points in slots, of which the first `used` are filled."""

    behind: Behind
    used: Int[Array, ""]


def look_behind(
    packed: PackedScene,
    scatterer: Scatterer,
    seen: SeenEdges,
    weight: Float[Array, "C 3"],
    valid: Bool[Array, " C"],
    settings: PathSettings,
) -> tuple[Behind, SurfacePoint]:
    """(boundary points with their backgrounds, the backgrounds as surface points). One ray each; detached.

    `scatterer`: the BSDFs at the apexes. `weight`: throughput to the apex over the density of boundary points (per
    length on the sphere of directions), without the BSDF.
    """
    background, clear = background_point(packed, scatterer.point, seen, valid, settings)
    counts = valid & clear
    weight = jnp.where(counts[:, None], weight * scatterer.eval(seen.towards), 0.0)
    behind = Behind(
        seen.segment, seen.edge, seen.along, weight, background.face, background.barycentric, background.valid
    )
    return behind, background._replace(valid=background.valid & counts)


class EdgeSamples(NamedTuple):
    """Points at fractions `along` edges, for path vertices; detached.

    `weight`: over the density of the points, per length on the sphere of directions. `number`: of the random numbers.
    """

    vertex: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    weight: Float[Array, " C"]
    number: Int[Array, " C"]


def look_past(
    context: Context, paths: PathSegments, samples: EdgeSamples, valid: Bool[Array, " C"], key: PRNGKeyArray, name: str
) -> tuple[Requests, Behind]:
    """Requests for all radiance that is seen just past edges, and the boundary points; for `look_behind` see there."""
    packed, settings = context.packed, context.settings
    seen = seen_edges(packed, paths, samples.vertex, samples.edge, samples.along, valid)
    weight = scale(paths.table.throughput[samples.vertex], samples.weight)
    behind, background = look_behind(packed, paths.scatterer(samples.vertex), seen, weight, valid, settings)
    numbers = numbers_behind(key, name, samples.number, samples.weight.dtype)
    return ask_behind(paths, seen, background, numbers, 1.0, settings), behind


def image_past(
    context: Context, chunk: Chunk, held: BehindEdges | None, answers: Answers | None
) -> Float[Array, "H W 3"]:
    """Radiance that moving silhouettes of `look_past` cover or uncover: zero in value, right in derivative."""
    total = jnp.zeros_like(chunk.record.radiance)
    if held is not None and answers is not None:
        paths = path_segments(context.packed, chunk, "direct")
        total = sum_behind(context.packed, paths, held, answers.total)
    return chunk.image(context.packed, total)


class Numbers(NamedTuple):
    """Uniform numbers `u` of boundary points, and the random `stream` of the paths behind them."""

    u: Float[Array, "C 4"]
    stream: UInt32[Array, " C"]


def numbers_behind(key: PRNGKeyArray, name: str, number: Int[Array, " C"], dtype) -> Numbers:
    """The random numbers of the boundary points with these `number`s, of the term `name`."""
    return Numbers(lattice(key, 1, number, 4, dtype), number.astype(jnp.uint32) + stream_of(name))


def ask_behind(
    paths: PathSegments,
    seen: SeenEdges,
    background: SurfacePoint,
    numbers: Numbers,
    emission: Float[Array, " C"] | float,
    settings: PathSettings,
    scattered: Bool[Array, " C"] | bool = True,
) -> Requests:
    """Requests for the radiance of what is seen past edges.

    `emission` is the share of emitted radiance that counts. `scattered`: whether scattered light counts.
    """
    bounces = jnp.where(scattered, settings.max_depth - 2 - seen.segment // paths.paths, 0)
    return request(background, -seen.towards, numbers.u, bounces, numbers.stream, emission)


def background_values(
    packed: PackedScene, paths: PathSegments, behind: Behind, radiance: Float[Array, "C 3"]
) -> Float[Array, "C 3"]:
    """Weight x radiance x normal velocity: zero in value, right in derivative.

    The velocity is that of the silhouette relative to the material point behind it, as an angle seen from the apex.
    """
    valid = (behind.weight != 0).any(-1)
    seen = seen_edges(packed, paths, behind.segment, behind.edge, behind.along, valid)
    edge_point, apex, pole, distance = seen.edge_point, seen.apex, seen.pole, seen.distance
    # The direction of the environment does not depend on the apex, and the environment is never near.
    there = behind.hit[:, None]
    far = jnp.where(there, on_face(packed, behind.face, behind.barycentric), apex)
    fixed_far = stop_gradient(far)
    moving_apex = seen.moving_apex
    if paths.near is not None:
        moving_apex = jnp.where(there, paths.apex_towards(seen.segment, moving_apex, fixed_far), moving_apex)
    far_distance = jnp.where(valid & behind.hit, norm(fixed_far - apex), 1.0)
    # The edges of the apex's own face are its horizon: this boundary moves with the plane; see `project_edges`.
    horizon = -dot(horizon_normal(seen.apex_triangle, pole), seen.towards)
    edge_moved = jnp.where(seen.own, horizon, dot(pole, edge_point - moving_apex) / distance)
    sky = dot(pole, packed.turned(seen.towards)) if packed.environment_turns else 0.0
    far_moved = jnp.where(behind.hit, dot(pole, far - moving_apex) / far_distance, sky)
    displacement = edge_moved - far_moved
    displacement = displacement - stop_gradient(displacement)
    return scale(behind.weight * radiance, displacement)


def sum_behind(
    packed: PackedScene, paths: PathSegments, edges: BehindEdges, radiance: Float[Array, "C 3"]
) -> Float[Array, "N 3"]:
    """`background_values`, summed over the boundary points of each of N paths."""

    def values(block, number):
        behind, radiance = block
        radiance = jnp.where((number < edges.used)[:, None], radiance, 0.0)
        value = background_values(packed, paths, behind, radiance)
        return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(behind.segment)].add(value)

    return sum_over_blocks(values, (edges.behind, radiance), edges.used)


def background_point(
    packed: PackedScene, point: SurfacePoint, seen: SeenEdges, valid: Bool[Array, " C"], settings: PathSettings
) -> tuple[SurfacePoint, Bool[Array, " C"]]:
    """(what a ray just past the edge hits, as a material point; whether nothing hides the edge)."""
    past = past_edge(seen.edge_point, seen.apex, seen.pole)
    # If surfaces scatter to both sides, leave on the side of `past`: own edges are seen from there.
    through = packed.spreads_through is not None
    start = leave(point, past - point.position if through else seen.towards)
    offset = past - start
    length = jnp.where(valid, norm(offset), 1.0)
    direction = scale(offset, 1.0 / length)
    reach = jnp.where(valid, 1e30, 0.0).astype(length.dtype)
    hit = queries.closest_hit(packed.geometry, queries.Rays(start, direction, reach), settings.rays)
    found = material_hit(packed, hit)
    return found, ~found.valid | (hit.t > length)
