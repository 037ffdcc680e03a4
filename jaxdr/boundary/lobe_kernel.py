"""Boundary term of BSDF-sampled segments by a kernel over directions, with the background traced anew.

The paper lets what a path gathered at its own vertex stand for the radiance at the boundary up to r away. Here a ray
past the silhouette finds what really lies behind it, and a path from there estimates its radiance. Then nothing is
evaluated away from the boundary, and rays that end on the occluder count as well. With p the density of directions c
(solid angle), t the angle from c to the foot of its perpendicular on the silhouette, and k any kernel over t,

    integral of f V dl  =  E_c [ sum over silhouettes with |t| < T of  f V k(t) / p(c) ]

where the integral of k(t) cos t dt is one, because strips around great circles have the area cos t dt dl. It holds for
any T, so the radius causes no bias.
"""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.boundary.silhouettes import PathSegments, foot_on_edge, horizon_normal, occluded_side, past_edge
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.geometry.vector import dot, norm
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, detached_barycentric, leave, material_point
from jaxdr.transport.path import PathSettings, gathered_radiance
from jaxdr.transport.sampler import lattice

WIDEST = 1.0  # tangent of the widest angle between a direction and a silhouette it stands for


def lobe_term(
    packed: PackedScene,
    tree: EdgeTree,
    radius: Float[Array, " E"],
    paths: PathSegments,
    scale: Float[Array, " N"],
    capacity: int,
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Boundary term of the BSDF-sampled segments of N paths, zero in value and right in derivative.

    Kernel radii: `radius` x `scale` at the edge (scene units), but no more than 45 degrees.
    """
    key_pairs, key_first, key_path = jax.random.split(key, 3)
    direction, importance = paths.table.direction, paths.table.lobe
    scale = jnp.where((importance != 0).any(-1), jnp.tile(scale, paths.count // paths.paths), 0.0)
    origin = stop_gradient(paths.apex(jnp.arange(paths.count)).position)
    reach = 2.0 * stop_gradient(packed.size())
    seed = jax.random.randint(key_pairs, (), 0, 1 << 30)
    pairs = queries.edge_candidates(
        tree, packed.vertices, packed.edges.vertices, packed.edges.opposite, radius,
        origin, origin + reach * direction, direction, scale, jnp.full_like(scale, WIDEST * reach), seed,
        capacity=capacity, both_sides=True, implementation=settings.rays,
    )  # fmt: skip
    valid = pairs.segment >= 0
    segment = jnp.where(valid, pairs.segment, 0)
    centre = direction[segment]

    # The point of the silhouette nearest to the sampled direction, and the pole of the silhouette's great circle.
    vertices = packed.vertices[packed.edges.vertices[pairs.element]]
    apex = stop_gradient(paths.apex(segment).position)
    s0, s1 = stop_gradient(vertices[:, 0]) - apex, stop_gradient(vertices[:, 1]) - apex
    along = foot_on_edge(s0, s1, dot(centre, s0) / reach, dot(centre, s1) / reach, reach * centre)[:, None]
    edge_point = (1 - along) * vertices[:, 0] + along * vertices[:, 1]
    to_edge = stop_gradient(edge_point) - apex
    distance = jnp.where(valid, norm(to_edge), 1.0)
    apex_face = paths.table.apex_face[segment]
    pole, own = occluded_side(packed, pairs.element, apex, apex_face)

    limit = jnp.minimum(radius[pairs.element] * scale[segment] / distance, WIDEST / (1.0 + WIDEST**2) ** 0.5)
    scatterer = paths.scatterer(segment)
    kernel, above = _kernel(scatterer, centre, to_edge / distance[:, None], pole, limit)
    valid = valid & above
    background, seen = _background(packed, apex, paths.apex(segment), edge_point, to_edge, pole, valid, settings)
    valid = valid & seen

    bounces = settings.max_depth - 2
    u = lattice(key_first, 1, jnp.arange(segment.shape[0]), 4, centre.dtype)[0]
    remaining = jnp.where(valid, bounces - segment // paths.paths, 0)
    detached = jax.tree.map(stop_gradient, packed)
    back = background._replace(valid=background.valid & valid)
    towards = to_edge / distance[:, None]
    radiance = gathered_radiance(
        detached, jax.tree.map(stop_gradient, back), towards, u, key_path, settings, bounces, remaining
    )
    weight = importance[segment] * scatterer.eval(towards) * radiance * (kernel * pairs.weight)[:, None]

    # Angular velocity of the silhouette relative to the material point behind it, seen from the apex.
    far = jnp.where(background.valid[:, None], background.position, 2.0 * stop_gradient(edge_point) - apex)
    moving_apex = paths.apex_towards(segment, stop_gradient(far))
    far_distance = jnp.where(valid, norm(stop_gradient(far) - apex), 1.0)
    edge_moved = dot(pole, edge_point - moving_apex)
    horizon = -dot(horizon_normal(packed, apex_face, pole), to_edge)  # see `project_edges`
    edge_moved = jnp.where(own, horizon, edge_moved)
    displacement = edge_moved / distance - dot(pole, far - moving_apex) / far_distance
    displacement = displacement - stop_gradient(displacement)
    value = jnp.where(valid[:, None], weight, 0.0) * displacement[:, None]
    return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(segment)].add(value)


def _kernel(scatterer, centre, boundary, pole, limit):
    """(k(t), whether the pair counts): k is proportional to the cosine at the sampled direction.

    That takes the 1 / cosine out of f / p near the horizon, below which nothing is sampled.
    """
    height = scatterer.cosine(centre)
    side = jnp.sign(height)
    a, b = side * scatterer.cosine(boundary), side * scatterer.cosine(pole)
    half = jnp.arcsin(jnp.clip(limit, 0.0, 1.0))
    horizon = jnp.arctan2(b, a)  # a cos t + b sin t > 0 within 90 degrees of it
    low, high = jnp.maximum(-half, horizon - 0.5 * jnp.pi), jnp.minimum(half, horizon + 0.5 * jnp.pi)

    def primitive(t):
        return 0.5 * a * (t + jnp.sin(t) * jnp.cos(t)) + 0.5 * b * jnp.sin(t) ** 2

    mass = primitive(high) - primitive(low)
    counts = (a > 0) & (jnp.abs(dot(centre, pole)) <= limit) & (mass > 0)
    return jnp.where(counts, jnp.abs(height) / jnp.where(counts, mass, 1.0), 0.0), counts


def _background(packed, apex, point: SurfacePoint, edge_point, to_edge, pole, valid, settings):
    """(what a ray just past the edge hits, as a material point; whether nothing hides the edge)."""
    past = past_edge(edge_point, apex, pole)
    start = leave(point, to_edge)
    offset = past - start
    length = jnp.where(valid, norm(offset), 1.0)
    direction = offset / length[:, None]
    reach = jnp.where(valid, 1e30, 0.0).astype(length.dtype)
    hit = queries.closest_hit(packed.vertices, packed.faces, start, direction, reach, settings.rays)
    found = hit.face >= 0
    face = jnp.where(found, hit.face, 0)
    barycentric = detached_barycentric(packed, start, direction, face)
    return material_point(packed, face, barycentric, found), ~found | (hit.t > length)
