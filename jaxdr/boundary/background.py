"""Silhouettes in a direction from path vertices, and the radiance of what lies behind them.

The integral of f V dl over directions, for lights that emitter sampling does not reach: f is what the lobe makes of the
radiance past the edge, which a ray and a path from where it ends estimate. Paths share the far end's radiance with no
neighbour, so nothing is evaluated away from the boundary.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.silhouettes import PathSegments, horizon_normal, occluded_side, past_edge
from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, norm
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, detached_barycentric, leave, material_point
from jaxdr.transport.path import PathSettings
from jaxdr.transport.radiance import gathered_radiance
from jaxdr.transport.sampler import lattice

# Emitted radiance that counts, of a background point seen in a direction from an apex.
Emission = Callable[[SurfacePoint, Float[Array, "C 3"]], Float[Array, "C 3"]]


class SeenEdges(NamedTuple):
    """Points on edges as seen from the apexes of segments; only `edge_point` is differentiable.

    `pole` is the unit normal of the plane through apex and edge, towards the occluded side; `own` marks edges of the
    face that the apex lies in (horizons).
    """

    segment: Int[Array, " C"]
    apex: Float[Array, "C 3"]
    apex_face: Int[Array, " C"]
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
    vertices = packed.vertices[packed.edges.vertices[edge]]
    apex = stop_gradient(paths.apex(segment).position)
    edge_point = (1 - along)[:, None] * vertices[:, 0] + along[:, None] * vertices[:, 1]
    to_edge = stop_gradient(edge_point) - apex
    distance = jnp.where(valid, norm(to_edge), 1.0)
    apex_face = paths.table.apex_face[segment]
    pole, own = occluded_side(packed, edge, apex, apex_face)
    return SeenEdges(segment, apex, apex_face, edge_point, distance, to_edge / distance[:, None], pole, own)


def background_term(
    packed: PackedScene,
    paths: PathSegments,
    seen: SeenEdges,
    weight: Float[Array, "C 3"],
    valid: Bool[Array, " C"],
    number: Int[Array, " C"],
    key: PRNGKeyArray,
    settings: PathSettings,
    emission: Emission | None = None,
) -> Float[Array, "C 3"]:
    """Boundary points' weight x scattered background radiance x normal velocity: zero in value, right in derivative.

    `weight`: throughput to the apex over the density of boundary points (length in solid angle), without the BSDF.
    `number` and `key` choose the random numbers. `emission` says which emitted radiance counts as well.
    """
    key_first, key_path = jax.random.split(key)
    background, clear = background_point(packed, paths.apex(seen.segment), seen, valid, settings)
    valid = valid & clear
    detached = jax.tree.map(stop_gradient, packed)
    back = jax.tree.map(stop_gradient, background._replace(valid=background.valid & valid))
    bounces = settings.max_depth - 2
    radiance = jnp.zeros_like(weight)
    if bounces > 0:
        u = lattice(key_first, 1, number, 4, weight.dtype)[0]
        remaining = jnp.where(valid, bounces - seen.segment // paths.paths, 0)
        radiance = gathered_radiance(
            detached, back, seen.towards, u, jax.random.fold_in(key_path, number[0]), settings, bounces, remaining
        )
    if emission is not None:
        radiance = radiance + emission(back, seen.towards)
    weight = weight * paths.scatterer(seen.segment).eval(seen.towards) * radiance

    # Angular velocity of the silhouette relative to the material point behind it, seen from the apex.
    edge_point, apex, pole, distance = seen.edge_point, seen.apex, seen.pole, seen.distance
    # The environment is seen in one direction, whatever the apex does, and is never near.
    there = background.valid[:, None]
    far = jnp.where(there, background.position, apex)
    moving_apex = paths.apex_towards(seen.segment, stop_gradient(far))
    moving_apex = jnp.where(there, moving_apex, paths.apex(seen.segment).position)
    far_distance = jnp.where(valid & background.valid, norm(stop_gradient(far) - apex), 1.0)
    # The apex stays in its face: where that sets, the boundary moves as the plane does; see `project_edges`.
    horizon = -dot(horizon_normal(packed, seen.apex_face, pole), distance[:, None] * seen.towards)
    edge_moved = jnp.where(seen.own, horizon, dot(pole, edge_point - moving_apex)) / distance
    sky = dot(pole, packed.turned(seen.towards)) if packed.environment_turns else 0.0
    far_moved = jnp.where(background.valid, dot(pole, far - moving_apex) / far_distance, sky)
    displacement = edge_moved - far_moved
    displacement = displacement - stop_gradient(displacement)
    return jnp.where(valid[:, None], weight, 0.0) * displacement[:, None]


def background_point(
    packed: PackedScene, point: SurfacePoint, seen: SeenEdges, valid: Bool[Array, " C"], settings: PathSettings
) -> tuple[SurfacePoint, Bool[Array, " C"]]:
    """(what a ray just past the edge hits, as a material point; whether nothing hides the edge)."""
    past = past_edge(seen.edge_point, seen.apex, seen.pole)
    # Where the surface scatters to both sides, its own edges are seen from the side that `past` is on.
    through = packed.spreads_through is not None
    start = leave(point, past - point.position if through else seen.towards)
    offset = past - start
    length = jnp.where(valid, norm(offset), 1.0)
    direction = offset / length[:, None]
    reach = jnp.where(valid, 1e30, 0.0).astype(length.dtype)
    hit = queries.closest_hit(packed.geometry, queries.Rays(start, direction, reach), settings.rays)
    found = hit.face >= 0
    face = jnp.where(found, hit.face, 0)
    barycentric = detached_barycentric(packed, start, direction, face)
    return material_point(packed, face, barycentric, found), ~found | (hit.t > length)
