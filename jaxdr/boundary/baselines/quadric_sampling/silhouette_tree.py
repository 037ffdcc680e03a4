"""A tree over edges, down to single edges, with the bounds that a random descent from a point needs."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.boundary.baselines.quadric_sampling.dual_bounds import DualBounds, bound, dual_points
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes
from jaxdr.boundary.guided_edges.primary_guides import below_one
from jaxdr.geometry.edge_tree import leaf_edges
from jaxdr.geometry.vector import corners, cross, norm, normalize
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene

SIZES = (3, 1, 3, 1, 1, 1, 4, 4, 4, 10)  # of the fields of `Nodes`
LEVELS = 10  # levels that share a uniform number of 24 bits
NUMBERS = 3  # uniform numbers of a descent: enough for 2^30 edges


class Nodes(NamedTuple):
    """Nodes of the tree.

    - `centre`, `extent`: box around the edges, with half extents. `size`: unit of length of the planes.
    - `weight`: sum of length x exterior angle of the edges; of a single edge its length. Zero if none counts.
    - `slack`: angle by which rounding may turn the faces. `open`: 1 if an edge may be a silhouette from everywhere.
    - `planes`: bounds of the planes of the faces at the other edges.
    """

    centre: Float[Array, "*n 3"]
    size: Float[Array, "*n"]
    extent: Float[Array, "*n 3"]
    weight: Float[Array, "*n"]
    slack: Float[Array, "*n"]
    open: Float[Array, "*n"]
    planes: DualBounds


class SilhouetteTree(NamedTuple):
    """A complete binary tree in heap order; detached.

    `children`: row i has both children of node i, from node 1 on. `edge`: the edges of the S leaves, -1 for none.
    """

    children: Float[Array, "S 2 32"]
    edge: Int[Array, " S"]


class Drawn(NamedTuple):
    """An edge for each point (-1: the descent found none) and the probability of this edge for this point."""

    edge: Int[Array, " n"]
    probability: Float[Array, " n"]


class _Slots(NamedTuple):
    """The edges in the order of the leaves: both ends, normals of two faces. `bounded`: `normals` bound the edge."""

    ends: Float[Array, "S 2 3"]
    normals: Float[Array, "S 2 3"]
    slack: Float[Array, " S"]
    bounded: Bool[Array, " S"]
    weight: Float[Array, " S"]
    length: Float[Array, " S"]


def silhouette_tree(packed: PackedScene, lunes: EdgeLunes) -> SilhouetteTree:
    """The tree for the current positions, over all edges of positive density in `lunes`, which is in scene order."""
    number = leaf_edges(packed.edge_counts)
    there, index = jnp.asarray(number >= 0), np.maximum(number, 0)
    edges = packed.edges
    ends, opposite = packed.vertices[edges.vertices], packed.vertices[edges.opposite[:, :2]]
    start, end = corners(ends)
    n0, slack0 = _normal(start, end, opposite[:, 0])
    n1, slack1 = _normal(end, start, opposite[:, 1])
    slack = jnp.maximum(slack0, slack1)
    length = norm(end - start)
    weight = lunes.density * length
    slots = _Slots(
        ends=ends,
        normals=jnp.stack([n0, n1], 1),
        slack=slack,
        bounded=edges.interior & (slack < 0.1),
        weight=weight,
        # Of a single edge the exterior angle does not matter: it is a silhouette or not.
        length=safe_divide(weight, lunes.width, lunes.width > 0, 0.0),
    )
    slots = _Slots(*(table[index] for table in slots))
    slots = slots._replace(weight=jnp.where(there, slots.weight, 0.0), length=jnp.where(there, slots.length, 0.0))
    levels = [_level(slots, 1 << k) for k in range(len(number).bit_length())]
    rows = jnp.concatenate([level.reshape(-1, 2, level.shape[-1]) for level in levels[1:]])
    unused = jnp.zeros_like(rows[:1])
    return SilhouetteTree(jnp.concatenate([unused, rows]), jnp.asarray(number))


def _normal(start, end, corner):
    """(unit normals of faces, angle by which rounding of float32 coordinates may turn them: large for slivers)."""
    side, other = end - start, corner - start
    plane = cross(side, other)
    area, longest = norm(plane), norm(side) + norm(other)
    rounding = 4 * float(np.finfo(np.float32).eps) * jnp.maximum(jnp.abs(start).max(-1), jnp.abs(corner).max(-1))
    return normalize(plane), jnp.where(area > 0, rounding * longest / jnp.where(area > 0, area, 1.0), jnp.pi)


def _level(slots: _Slots, count: int) -> Float[Array, "count 32"]:
    """`count` nodes that share the slots evenly, as rows of numbers."""
    single = count == slots.weight.shape[0]
    ends, normals, slack, bounded, weight, length = (x.reshape(count, -1, *x.shape[1:]) for x in slots)
    there = weight > 0
    some = there.any(1)[:, None]
    mask = there[..., None]
    lower = jnp.where(some, jnp.where(mask, ends.min(2), jnp.inf).min(1), 0.0)
    upper = jnp.where(some, jnp.where(mask, ends.max(2), -jnp.inf).max(1), 0.0)
    centre = 0.5 * (lower + upper)
    extent = jnp.maximum(upper - centre, centre - lower)
    radius = norm(extent)
    size = jnp.where(radius > 0, radius, 1.0)
    inside = there & bounded
    planes = dual_points(normals, ends[:, :, :1], centre[:, None, None], size[:, None, None])
    planes = planes.reshape(count, -1, 4)
    bounds = bound(planes, jnp.repeat(inside, 2, axis=1), single)
    # Offsets of planes round with the coordinates of their points.
    rounding = 8 * jnp.finfo(ends.dtype).eps * jnp.abs(ends).max((1, 2, 3)) / size
    nodes = Nodes(
        centre=centre,
        size=size,
        extent=extent,
        weight=(length if single else weight).sum(1),
        slack=jnp.where(inside, slack, 0.0).max(1) + rounding,
        open=(there & ~bounded).any(1).astype(ends.dtype),
        planes=bounds,
    )
    flat = (*nodes[:-1], *nodes.planes)
    return jnp.concatenate([x.reshape(count, -1) for x in flat], -1)


def _nodes(rows: Float[Array, "*n 32"]) -> Nodes:
    parts = jnp.split(rows, np.cumsum(SIZES)[:-1].tolist(), axis=-1)
    parts = [part[..., 0] if size == 1 else part for part, size in zip(parts, SIZES, strict=True)]
    centre, size, extent, weight, slack, unbounded = parts[:6]
    return Nodes(centre, size, extent, weight, slack, unbounded, DualBounds(*parts[6:]))


def draw_edges(
    tree: SilhouetteTree, importance: Callable[[Nodes], Float[Array, "n 2"]], u: Float[Array, "n 3"]
) -> Drawn:
    """An edge for each of n points, from the root down: a child is entered in proportion to its `importance`.

    An edge's probability is the product over its levels. A descent that comes to two children of importance zero finds
    no edge. So an estimate is unbiased if the importance is positive wherever an edge counts.
    """
    last = tree.edge.shape[0]
    levels = last.bit_length() - 1
    assert levels <= LEVELS * NUMBERS

    def step(level, carry):
        node, chance, left = carry
        left = jnp.where(level % LEVELS == 0, u[:, level // LEVELS], left)
        value = importance(_nodes(tree.children[node]))
        total = value.sum(-1)
        first = safe_divide(value[:, 0], total, total > 0, 0.0)
        right = left >= first
        taken = jnp.where(right, 1.0 - first, first)
        left = safe_divide(jnp.where(right, left - first, left), taken, taken > 0)
        # Node 0 has children without weight: a descent that ends stays there.
        node = jnp.where((total > 0) & (taken > 0), 2 * node + right, 0)
        return node, chance * taken, below_one(left)

    start = jnp.ones(u.shape[0], jnp.int32), jnp.ones(u.shape[0], u.dtype), u[:, 0]
    node, chance, _ = loops.fori_loop(0, levels, step, start)
    found = node >= last
    edge = jnp.where(found, tree.edge[jnp.where(found, node - last, 0)], -1)
    return Drawn(edge, jnp.where(edge >= 0, chance, 0.0))
