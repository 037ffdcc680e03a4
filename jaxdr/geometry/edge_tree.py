"""Bounding tree over edges for silhouette queries: boxes, and cones of the normals of the faces at the edges.

Seen from a point, a node whose normals all face it, or all face away, holds no silhouette and is skipped however close
it is: the cost of a query grows with the logarithm of the tessellation. The tree is complete and binary over the edges
in their given (spatial) order, in heap order from node 1, as plain arrays computed level by level: no handle, nothing
cached.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import dot, normalize

LEAF = 4  # edges in a leaf


class EdgeTree(NamedTuple):
    """Nodes 1 to 2^k - 1 of the tree (row 0 is unused); the leaves are the last half, with `LEAF` edges each.

    `axis` and `cosine` of the half-angle bound the face normals; -1 where they fill more than a half-space or an edge
    is a silhouette from everywhere. `radius` is the largest kernel radius of the edges; 0 where none counts.
    """

    lower: Float[Array, "n 3"]
    upper: Float[Array, "n 3"]
    axis: Float[Array, "n 3"]
    cosine: Float[Array, " n"]
    radius: Float[Array, " n"]


def spatial_order(points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Order of points along a Morton curve, on the host."""
    low, high = points.min(0), points.max(0)
    cell = ((points - low) / np.maximum((high - low).max(), 1e-300) * 1023).astype(np.uint32)
    code = np.zeros(len(points), np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def build_edge_tree(
    vertices: Float[Array, "V 3"],
    edges: Int[Array, "E 2"],
    opposite: Int[Array, "E K"],
    interior: Bool[Array, " E"],
    radius: Float[Array, " E"],
) -> EdgeTree:
    """The tree for the present vertices, detached. `opposite` are the third corners of the faces at each edge."""
    vertices = stop_gradient(vertices)
    count = edges.shape[0]
    leaves = 1 << max(0, int(np.ceil(np.log2(max(count, 1) / LEAF))))
    p0, p1 = vertices[edges[:, 0]], vertices[edges[:, 1]]
    # Interior edges have two faces; the others are silhouettes from almost everywhere and get no cone.
    n0 = normalize(jnp.cross(p1 - p0, vertices[opposite[:, 0]] - p0))
    n1 = normalize(jnp.cross(p0 - p1, vertices[opposite[:, 1]] - p1))
    axis = normalize(n0 + n1)
    cosine = jnp.where(interior & (dot(axis, axis) > 0), dot(axis, n0), -1.0)
    counts = radius > 0
    inf = jnp.asarray(jnp.inf, vertices.dtype)
    level = EdgeTree(
        lower=jnp.where(counts[:, None], jnp.minimum(p0, p1), inf),
        upper=jnp.where(counts[:, None], jnp.maximum(p0, p1), -inf),
        axis=axis,
        cosine=jnp.where(counts, cosine, 1.0),
        radius=radius,
    )
    padding = leaves * LEAF - count
    fill = (jnp.inf, -jnp.inf, 0.0, 1.0, 0.0)
    level = EdgeTree(
        *(
            jnp.concatenate([table, jnp.full((padding, *table.shape[1:]), value, table.dtype)])
            for table, value in zip(level, fill, strict=True)
        )
    )
    levels = []
    while level.radius.shape[0] > leaves:
        level = _parents(level)
    levels.append(level)
    while level.radius.shape[0] > 1:
        level = _parents(level)
        levels.append(level)
    unused = EdgeTree(*(table[:1] for table in level))
    return EdgeTree(*(jnp.concatenate(tables) for tables in zip(unused, *reversed(levels), strict=True)))


def _parents(children: EdgeTree) -> EdgeTree:
    """Union of each pair of nodes."""
    a, b = EdgeTree(*(t[0::2] for t in children)), EdgeTree(*(t[1::2] for t in children))
    empty_a, empty_b = a.radius <= 0, b.radius <= 0
    axis_a = jnp.where(empty_a[:, None], b.axis, a.axis)
    axis_b = jnp.where(empty_b[:, None], a.axis, b.axis)
    axis = normalize(axis_a + axis_b)

    def widened(child_axis, child, empty):
        between = jnp.clip(dot(axis, child_axis), -1.0, 1.0)
        angle = jnp.arccos(between) + jnp.arccos(jnp.clip(child.cosine, -1.0, 1.0))
        return jnp.where(empty, 0.0, angle)

    angle = jnp.maximum(widened(axis_a, a, empty_a), widened(axis_b, b, empty_b))
    unbounded = (dot(axis, axis) == 0) | (angle >= 0.5 * jnp.pi)
    return EdgeTree(
        lower=jnp.minimum(a.lower, b.lower),
        upper=jnp.maximum(a.upper, b.upper),
        axis=axis,
        # A little wider than computed: the arithmetic rounds.
        cosine=jnp.where(unbounded & ~(empty_a & empty_b), -1.0, jnp.cos(angle) - 1e-5),
        radius=jnp.maximum(a.radius, b.radius),
    )
