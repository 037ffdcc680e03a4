"""Bounding tree over edges for silhouette queries: boxes, and cones of the normals of the faces at the edges.

If all normals of a node face a point, or all face away, the node has no silhouette from that point. It is skipped, even
if it is close. So the cost of a query grows with the logarithm of the tessellation. The tree is complete and binary, in
heap order from node 1. It consists of plain arrays, computed level by level, without handles and caches. Which edges
share a node is decided once for a topology (`spatial_order`). Boxes and cones follow the vertices.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import cross, dot, norm, normalize

LEAF = 4  # edges in a leaf


class EdgeTree(NamedTuple):
    """Nodes 1 to 2^k - 1 of the tree (row 0 is unused); the leaves are the last half, with `LEAF` edges each.

    `edge` has the edges of the leaves in order, -1 for an empty slot. A node is three rows of four numbers, beside each
    other in memory:

    - centre of the box, and its radius;
    - half extent of the box, and the rank: the largest `radius` (or other importance) of the edges, 0 if none counts;
    - axis of a cone around the face normals, and the cosine of its half-angle; -1 if the normals fill more than a
      half-space, or if an edge may be a silhouette from everywhere.
    """

    edge: Int[Array, " s"]
    node: Float[Array, "n 3 4"]


class _Nodes(NamedTuple):
    """One level of the tree, or all of them: boxes, cones, and the largest radius."""

    lower: Float[Array, "n 3"]
    upper: Float[Array, "n 3"]
    axis: Float[Array, "n 3"]
    cosine: Float[Array, " n"]
    radius: Float[Array, " n"]


def leaf_count(edges: int) -> int:
    """Leaves of a complete binary tree over so many edges."""
    return 1 << max(0, int(np.ceil(np.log2(max(edges, 1) / LEAF))))


def spatial_order(points: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Order in which every node of the tree is a cell of a kd-tree, halved along its longest side. On the host.

    Queries visit far fewer nodes than with a Morton curve, whose ranges are not compact.
    """
    count = len(points)
    slots = leaf_count(count) * LEAF
    order = np.arange(slots)
    table = np.full((3, slots), np.inf, np.float32)  # padding is larger than everything and stays at the end
    table[:, :count] = points.T
    size = slots
    while size > LEAF:
        cells = table.reshape(3, -1, size)
        lower, upper = (np.stack([_along_rows(extreme, c) for c in cells]) for extreme in (np.minimum, np.maximum))
        for row in np.flatnonzero(np.isfinite(lower[0]) & np.isinf(upper[0])):  # the cell where padding starts
            upper[:, row] = np.where(np.isinf(cells[:, row]), -np.inf, cells[:, row]).max(1)
        with np.errstate(invalid="ignore"):  # cells of padding only
            extent = upper - lower
        axis = np.where(np.isfinite(extent), extent, -1.0).argmax(0)[:, None]
        along = np.where(axis == 0, cells[0], np.where(axis == 1, cells[1], cells[2]))
        halves = _halved(along)
        order, table = order[halves], np.stack([row[halves] for row in table])
        size //= 2
    return order[order < count]


def _halved(values: Float[np.ndarray, "n size"]) -> Int[np.ndarray, " slots"]:
    """Flat indices in which the smaller half of each row comes first; what is equal and in either half keeps its order.

    `argpartition` would do, but its order differs between processors, and so would the edges that a key draws.
    """
    half = values.shape[1] // 2
    middle = np.partition(values, half - 1, axis=1)[:, half - 1 : half]
    lower, equal = values < middle, values == middle
    lower |= equal & (np.cumsum(equal, 1) <= half - lower.sum(1, keepdims=True))
    halves = (np.flatnonzero(part).reshape(-1, half) for part in (lower, ~lower))
    return np.concatenate(list(halves), axis=1).reshape(-1)


def _along_rows(extreme: np.ufunc, cells: Float[np.ndarray, "n size"]) -> Float[np.ndarray, " n"]:
    """The extreme of each row. Short rows are reduced column by column, which is much faster in NumPy."""
    if cells.shape[1] > 64 or len(cells) < cells.shape[1]:
        return extreme.reduce(cells, axis=1)
    found = cells[:, 0].copy()
    for k in range(1, cells.shape[1]):
        extreme(found, cells[:, k], out=found)
    return found


def leaf_edges(counts: Sequence[int]) -> Int[np.ndarray, " s"]:
    """Edges in the leaves (-1: none) of a tree over meshes with `counts` edges. Each mesh has its own subtree."""
    first = np.cumsum([0, *counts])
    sizes = [leaf_count(count) * LEAF for count in counts]
    slots = np.full(leaf_count(sum(sizes)) * LEAF, -1, np.int32)
    start = 0
    for i in sorted(range(len(counts)), key=lambda i: -sizes[i]):  # the largest first, so that all are aligned
        slots[start : start + counts[i]] = np.arange(first[i], first[i + 1])
        start += sizes[i]
    return slots


def build_edge_tree(
    vertices: Float[Array, "V 3"],
    edges: Int[Array, "E 2"],
    opposite: Int[Array, "E K"],
    interior: Bool[Array, " E"],
    radius: Float[Array, " E"],
    counts: Sequence[int] | None = None,
) -> EdgeTree:
    """The tree for the current vertices, detached.

    `opposite` are the third corners of the faces at each edge. `counts` are the numbers of edges of several meshes.
    """
    vertices = stop_gradient(vertices)
    slots = leaf_edges(counts or [edges.shape[0]])
    leaves = len(slots) // LEAF
    p0, p1 = vertices[edges[:, 0]], vertices[edges[:, 1]]
    # Interior edges have two faces. The others are silhouettes from almost everywhere, so they have no cone.
    n0, slack0 = _normal(p0, p1, vertices[opposite[:, 0]])
    n1, slack1 = _normal(p1, p0, vertices[opposite[:, 1]])
    axis = normalize(n0 + n1)
    angle = jnp.arccos(jnp.clip(dot(axis, n0), -1.0, 1.0)) + jnp.maximum(slack0, slack1)
    bounded = interior & (dot(axis, axis) > 0) & (angle < 0.5 * jnp.pi)
    cosine = jnp.where(bounded, jnp.cos(angle), -1.0)
    included = radius > 0
    inf = jnp.asarray(jnp.inf, vertices.dtype)
    level = _Nodes(
        lower=jnp.where(included[:, None], jnp.minimum(p0, p1), inf),
        upper=jnp.where(included[:, None], jnp.maximum(p0, p1), -inf),
        axis=axis,
        cosine=jnp.where(included, cosine, 1.0),
        radius=radius,
    )
    empty = _Nodes(*(jnp.asarray(value, vertices.dtype) for value in (jnp.inf, -jnp.inf, 0.0, 1.0, 0.0)))
    used = slots >= 0
    level = _Nodes(
        *(
            jnp.where(used.reshape(-1, *[1] * (table.ndim - 1)), table[np.maximum(slots, 0)], value)
            for table, value in zip(level, empty, strict=True)
        )
    )
    levels = []
    while level.radius.shape[0] > leaves:
        level = _parents(level)
    levels.append(level)
    while level.radius.shape[0] > 1:
        level = _parents(level)
        levels.append(level)
    unused = _Nodes(*(table[:1] for table in level))
    nodes = _Nodes(*(jnp.concatenate(tables) for tables in zip(unused, *reversed(levels), strict=True)))
    return EdgeTree(jnp.asarray(slots), _rows(nodes))


def _rows(nodes: _Nodes) -> Float[Array, "n 3 4"]:
    empty = (nodes.radius <= 0)[:, None]
    lower, upper = jnp.where(empty, 0.0, nodes.lower), jnp.where(empty, 0.0, nodes.upper)
    center = 0.5 * (lower + upper)
    extent = jnp.maximum(upper - center, center - lower)  # halves of the sum and of the difference round differently
    first = jnp.concatenate([center, norm(extent)[:, None]], -1)
    second = jnp.concatenate([extent, nodes.radius[:, None]], -1)
    third = jnp.concatenate([nodes.axis, nodes.cosine[:, None]], -1)
    return jnp.stack([first, second, third], 1)


def _normal(p0, p1, p2):
    """(unit normals of faces, angle by which rounding of float32 coordinates may turn them: large for slivers)."""
    side0, side1 = p1 - p0, p2 - p0
    normal2 = cross(side0, side1)
    area, longest = norm(normal2), norm(side0) + norm(side1)
    rounding = 4 * float(np.finfo(np.float32).eps) * jnp.maximum(jnp.abs(p0).max(-1), jnp.abs(p2).max(-1))
    return normalize(normal2), jnp.where(area > 0, rounding * longest / jnp.where(area > 0, area, 1.0), jnp.pi)


def _parents(children: _Nodes) -> _Nodes:
    """Union of each pair of nodes."""
    a, b = _Nodes(*(t[0::2] for t in children)), _Nodes(*(t[1::2] for t in children))
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
    return _Nodes(
        lower=jnp.minimum(a.lower, b.lower),
        upper=jnp.maximum(a.upper, b.upper),
        axis=axis,
        # A little wider than computed, because the arithmetic rounds.
        cosine=jnp.where(unbounded & ~(empty_a & empty_b), -1.0, jnp.cos(angle) - 1e-5),
        radius=jnp.maximum(a.radius, b.radius),
    )
