"""Boundary term of BSDF-sampled segments by a kernel over directions, with the background traced anew.

The paper uses the radiance that a path gathered at its own vertex for a boundary up to r away. Here a ray past the
silhouette finds what lies behind it, and a path from there estimates its radiance. Then everything is evaluated on the
boundary, and rays that end on the occluder count as well. Let p be the density of directions c (solid angle), t the
angle from c to the foot of its perpendicular on the silhouette, and k any kernel over t. Then

    integral of f V dl  =  E_c [ sum over silhouettes with |t| < T of  f V k(t) / p(c) ]

if the integral of k(t) cos t dt is one, because strips around great circles have the area cos t dt dl. It holds for any
T, so the radius causes no bias.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.boundary.shared.background import BehindEdges, ask_behind, look_behind, numbers_behind, seen_edges
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.boundary.shared.projection import foot_on_edge
from jaxdr.boundary.shared.sampled_arcs import sampled_arc
from jaxdr.geometry import queries
from jaxdr.geometry.vector import corners, dot, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.radiance import Requests
from jaxdr.transport.sampler import seed_of

WIDEST = 1.0  # tangent of the widest angle between a sampled direction and a silhouette


def lobe_edges(
    packed: PackedScene,
    edges: queries.EdgeSet,
    paths: PathSegments,
    shrunk: Float[Array, " N"],
    capacity: int,
    key: PRNGKeyArray,
    settings: PathSettings,
) -> tuple[Requests, BehindEdges]:
    """Silhouettes near the BSDF-sampled segments of N paths, and requests for the radiance behind them; detached.

    The kernel's radius at an edge is its rank x `shrunk` (scene units), but at most 45 degrees.
    """
    key_pairs, key_path = jax.random.split(key)
    direction, importance = paths.table.direction, paths.table.lobe
    shrunk = jnp.where((importance != 0).any(-1), jnp.tile(shrunk, paths.count // paths.paths), 0.0)
    origin = paths.position(jnp.arange(paths.count))
    reach = 2.0 * paths.distance_to_infinity
    seed = seed_of(key_pairs)
    pairs = queries.edge_candidates(
        packed.geometry,
        edges,
        queries.StripQuery(
            origin, origin + reach * direction, direction, shrunk, jnp.full_like(shrunk, WIDEST * reach)
        ),
        seed,
        capacity=capacity,
        both_sides=True,
        implementation=settings.rays,
    )
    used = (pairs.segment >= 0).sum()

    def look(block, number):
        segment, edge = block
        valid = number < used
        centre = direction[segment]
        # The point of the silhouette nearest to the sampled direction.
        apex = origin[segment]
        s0, s1 = (end - apex for end in corners(packed.ends_of(edge)))
        along = foot_on_edge(s0, s1, dot(centre, s0) / reach, dot(centre, s1) / reach, reach * centre)
        seen = seen_edges(packed, paths, segment, edge, along, valid)
        limit = jnp.minimum(edges.rank[edge] * shrunk[segment] / seen.distance, WIDEST / (1.0 + WIDEST**2) ** 0.5)
        scatterer = paths.scatterer(segment)
        kernel, counts = _kernel(scatterer, centre, seen.towards, seen.pole, limit)
        counts = valid & counts & scatterer.above_horizon(seen.edge_point)
        weight = scale(importance[segment], packed.edges.shared(edge, kernel * pairs.weight))
        behind, background = look_behind(packed, scatterer, seen, weight, counts, settings)
        numbers = numbers_behind(key_path, "lobe_kernel", number, seen.distance.dtype)
        return ask_behind(paths, seen, background, numbers, 0.0, settings), behind

    asked, behind = map_over_blocks(look, (jnp.maximum(pairs.segment, 0), pairs.element), used)
    return asked, BehindEdges(behind, used)


def _kernel(scatterer, centre, boundary, pole, limit):
    """(k(t), whether the pair counts): k is proportional to the cosine at the sampled direction.

    This cancels the 1 / cosine in f / p near the horizon, below which nothing is sampled. On surfaces that scatter to
    both sides k is proportional to a function that is zero where p is; see `sampled_arc`.
    """
    if scatterer.spreads_through() is not None:
        arc = sampled_arc(scatterer, boundary, pole, jnp.arcsin(jnp.clip(limit, 0.0, 1.0)))
        t, mass = jnp.arcsin(jnp.clip(dot(centre, pole), -1.0, 1.0)), arc.strip()
        value = arc.at(t)
        counts = (mass > 0) & (value > 0) & arc.contains(t)
        return safe_divide(value, mass, counts, 0.0), counts
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
    return safe_divide(jnp.abs(height), mass, counts, 0.0), counts
