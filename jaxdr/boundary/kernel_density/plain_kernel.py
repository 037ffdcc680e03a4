"""The kernel of the paper (Xu et al. 2026): points on edges, discs around their projections, radii that shrink.

`KernelDensity(**PLAIN)` is the method of the paper (Eq. 15-22).
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.vector import between, corners, norm
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.sampler import sample_cdf

# The options of `KernelDensity` for the paper's method.
PLAIN: dict[str, Any] = {
    "kernel": "point",
    "iterations": 4,
    "widest": 0.0,
    "concave_edges": True,
    "visibility_ray": False,
    "at_boundary": False,
    "both_sides": False,
    "clip_to_face": False,
    "trace_background": False,
}


def shrinking_radii(alpha: float, iterations: int) -> list[float]:
    """Radius of every iteration relative to the first: r_{t+1} = r_t sqrt((t + alpha) / (t + 1)) (Eq. 21)."""
    radii = [1.0]
    for t in range(iterations - 1):
        radii.append(radii[-1] * ((t + alpha) / (t + 1)) ** 0.5)
    return radii


def near_points(
    packed: PackedScene,
    edges: queries.EdgeSet,
    count: int,
    strips: queries.StripQuery,
    key: PRNGKeyArray,
    seed: Int[Array, ""],
    options: dict[str, Any],
) -> tuple[queries.Candidates, Int[Array, " C"], Float[Array, " C"], Float[Array, ""]]:
    """(candidates, their edges, fractions along the edges, length of edges per point): points on edges near targets.

    `count` points are drawn. The kernel radii are the ranks of the edges (scene units). `options` are for
    `queries.point_candidates`.
    """
    radius = edges.rank
    edge, along, length = edge_points(packed, radius, count, key)
    position = between(*corners(stop_gradient(packed.vertices)[packed.edges.vertices[edge]]), along)
    points = queries.EdgePoints(position, edge, radius[edge])
    pairs = queries.point_candidates(packed.geometry, edges, points, strips, seed, **options)
    return pairs, edge[pairs.element], along[pairs.element], length / count


def edge_points(
    packed: PackedScene, radius: Float[Array, " E"], count: int, key: PRNGKeyArray
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, ""]]:
    """(edge, fraction along it, total length): points uniform over the length of all edges of positive radius."""
    start, end = corners(stop_gradient(packed.vertices)[packed.edges.vertices])
    length = jnp.where(radius > 0, norm(end - start), 0.0)
    cdf = jnp.cumsum(length)
    u = (jnp.arange(count) + jax.random.uniform(key, (count,), cdf.dtype)) / count * cdf[-1]
    edge, fraction, _ = sample_cdf(cdf, u)
    return edge, fraction, cdf[-1]


def share_of_disc(
    density: Float[Array, ""], stretch: Float[Array, " C"], radius: Float[Array, " C"], both_sides: bool
) -> Float[Array, " C"]:
    """Kernel value of a boundary point for a path vertex within `radius` of its projection, per area (Eq. 16, 19).

    `density`: length of edges per point; `stretch`: projected length per length of edge.
    """
    disc = jnp.pi * radius**2
    return density * stretch / (disc if both_sides else 0.5 * disc)
