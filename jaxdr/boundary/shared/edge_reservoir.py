"""For thin bundles of rays: one of the edges that a bundle may cross, drawn in proportion to its importance.

A bundle is a ray and its derivative with respect to a parameter t. Its candidates are found with a tree over edges and
go through a reservoir (Chao 1982): one candidate survives for each bundle, so there is no list that could overflow.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, UInt

from jaxdr import loops
from jaxdr.boundary.shared.folds import FLAT, SMOOTH, fold_tree
from jaxdr.boundary.shared.texture_jumps import seam_jumps
from jaxdr.geometry.edge_tree import LEAF, EdgeTree
from jaxdr.geometry.vector import corners, cross, dot, norm, normalize, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.sizes import at_once

# How many bundles go through the tree together. They wait for each other; on a GPU idle threads would cost more.
CPU_BLOCK, GPU_BLOCK = 2048, 1 << 17
BEYOND = 1.5  # edges are searched up to so many times the distance of the hit: the ray may hit a face beside them
MARGIN = 1.5  # the first-order t of a crossing may exceed the reach by this factor


class EdgeTable(NamedTuple):
    """Edges at which what a ray sees may jump; detached. `importance` is that of a crease; zero leaves an edge out."""

    ends: Float[Array, "E 2 3"]
    normals: Float[Array, "E 2 3"]
    interior: Bool[Array, " E"]
    importance: Float[Array, " E"]
    tree: EdgeTree


class Bundles(NamedTuple):
    """N rays from `origin` in unit `direction`, and their derivatives with respect to t; `end` is their length."""

    origin: Float[Array, "N 3"]
    direction: Float[Array, "N 3"]
    origin_rate: Float[Array, "N 3"]
    direction_rate: Float[Array, "N 3"]
    end: Float[Array, " N"]


class Drawn(NamedTuple):
    """For each bundle an edge, its importance, and the sum over all candidates: zero if there is none."""

    edge: Int[Array, " N"]
    importance: Float[Array, " N"]
    total: Float[Array, " N"]


def edge_table(packed: PackedScene, counts: Bool[Array, " E"], rays: str) -> EdgeTable:
    """All edges that count (`counts`), except flat edges across which textures continue."""
    packed = jax.tree.map(stop_gradient, packed)
    edges = packed.edges
    normal = normalize(packed.face_normals())
    n0, n1 = normal[edges.faces[:, 0]], normal[jnp.maximum(edges.faces[:, 1], 0)]
    n1 = jnp.where(edges.interior[:, None], n1, n0)
    fold = norm(n0 - n1)
    smooth = jnp.asarray(packed.smooth)[edges.shape]
    jump = jnp.where(fold > FLAT, fold, 0.0) * jnp.where(smooth, SMOOTH, 1.0)
    if packed.has_seams:
        jump = jump + seam_jumps(packed, jnp.arange(fold.shape[0]))
    importance = jnp.where(counts, jnp.where(edges.interior, jump, 1.0), 0.0)
    ends = packed.vertices[edges.vertices]
    tree = fold_tree(packed, importance, rays)
    return EdgeTable(ends, jnp.stack([n0, n1], 1), edges.interior, importance, tree)


class Crossing(NamedTuple):
    """Where a ray passes a line: fraction `along` the line, `distance` along the ray."""

    along: Float[Array, " N"]
    distance: Float[Array, " N"]


def passes(
    origin: Float[Array, "*n 3"],
    direction: Float[Array, "*n 3"],
    start: Float[Array, "*n 3"],
    side: Float[Array, "*n 3"],
) -> Crossing:
    """Nearest points of rays and of lines from `start` along `side`."""
    normal = cross(direction, side)
    squared = dot(normal, normal)
    squared = jnp.where(squared > 0, squared, 1.0)
    offset = start - origin
    distance = dot(cross(offset, side), normal) / squared
    return Crossing(dot(cross(offset, direction), normal) / squared, distance)


def volume(origin, direction, start, side) -> Float[Array, "*n"]:
    """Zero where a ray meets a line; a smooth function of both, with opposite signs on the line's two sides."""
    return dot(cross(direction, side), start - origin)


def may_cross(
    bundle: Bundles, start: Float[Array, "*n 3"], side: Float[Array, "*n 3"], reach: float
) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """(t at which bundles cross the lines of edges, to first order; whether they cross the edge within `reach`)."""
    o, d, do, dd = bundle.origin, bundle.direction, bundle.origin_rate, bundle.direction_rate
    rate = dot(cross(dd, side), start - o) - dot(cross(d, side), do)
    step = safe_divide(-volume(o, d, start, side), rate)
    near = (rate != 0) & (jnp.abs(step) <= MARGIN * reach)
    t = jnp.where(near, step, 0.0)
    at = passes(o + scale(do, t), d + scale(dd, t), start, side)
    point = start + scale(side, at.along)
    inside = (at.along >= 0) & (at.along <= 1) & _within(bundle, point, 0.0, reach)
    return step, near & inside


def _within(bundle: Bundles, point, radius, reach):
    """Whether a ball of this `radius` around a point may meet what the bundle sweeps, with a margin.

    It is true for the ball if it is true for a point in the ball with radius zero.
    """
    offset = point - bundle.origin
    depth = dot(offset, bundle.direction)
    across = norm(offset - scale(bundle.direction, depth))
    far = jnp.clip(depth + radius, 0.0, BEYOND * bundle.end)
    width = (1.0 + MARGIN) * reach * (norm(bundle.origin_rate) + far * norm(bundle.direction_rate))
    return (depth >= -radius) & (depth <= BEYOND * bundle.end + radius) & (across <= width + radius)


def draw_edges(
    table: EdgeTable, bundles: Bundles, active: Bool[Array, " N"], seed: UInt[Array, " N"], reach: float
) -> Drawn:
    """An edge that each active bundle may cross, drawn in proportion to its importance."""
    count = active.shape[0]
    order = jnp.argsort(~active, stable=True)
    size = min(at_once(CPU_BLOCK, GPU_BLOCK), max(count, 1))
    blocks = -(-count // size)
    padded = jnp.pad(order, (0, blocks * size - count))
    real = jnp.arange(blocks * size) < active.sum()

    def block(rows):
        index, real = rows
        return _draw(table, jax.tree.map(lambda x: x[index], bundles), real, seed[index], reach)

    found = jax.lax.map(block, (padded.reshape(blocks, size), real.reshape(blocks, size)))
    back = jnp.zeros(count, jnp.int32).at[order].set(jnp.arange(count, dtype=jnp.int32))
    return jax.tree.map(lambda x: x.reshape(-1)[back], found)


def _draw(table: EdgeTable, bundles: Bundles, active, seed, reach) -> Drawn:
    node_table, slots = table.tree.node, table.tree.edge
    leaves = slots.shape[0] // LEAF
    each = jax.tree.map(lambda x: x[:, None], bundles)

    def leaf(node, state: Drawn, here):
        first = (jnp.where(here, node, leaves) - leaves) * LEAF
        edge = slots[first[:, None] + jnp.arange(LEAF)]
        exists = here[:, None] & (edge >= 0)
        edge = jnp.maximum(edge, 0)
        start, end = corners(table.ends[edge])
        _, crosses = may_cross(each, start, end - start, reach)
        facing = dot(table.normals[edge], each.direction[:, :, None]) > 0
        silhouette = ~table.interior[edge] | (facing[..., 0] != facing[..., 1])
        base = table.importance[edge]
        importance = jnp.where(silhouette, 1.0, base)
        importance = jnp.where(exists & (base > 0) & crosses, importance, 0.0)
        for k in range(LEAF):
            total = state.total + importance[:, k]
            chance = safe_divide(importance[:, k], total)
            taken = _hashed(seed, edge[:, k]) < chance
            state = Drawn(
                jnp.where(taken, edge[:, k], state.edge), jnp.where(taken, importance[:, k], state.importance), total
            )
        return state

    def step(carry):
        node, state = carry
        box = node_table[node]
        centre, radius, rank = box[:, 0, :3], box[:, 0, 3], box[:, 1, 3]
        meets = (node > 0) & (rank > 0) & _within(bundles, centre, radius, reach)
        at_leaf = node >= leaves
        state = leaf(node, state, meets & at_leaf)
        following = node + 1
        following = following >> jax.lax.population_count((following & -following) - 1)
        following = jnp.where(following <= 1, 0, following)
        return jnp.where(meets & ~at_leaf, 2 * node, jnp.where(node > 0, following, 0)), state

    nothing = jnp.zeros(seed.shape, jnp.int32)
    zero = jnp.zeros(seed.shape, bundles.end.dtype)
    start = (jnp.where(active, 1, 0), Drawn(nothing, zero, zero))
    return loops.while_loop(lambda carry: (carry[0] > 0).any(), step, start)[1]


def _hashed(seed, edge):
    """A uniform number in [0, 1) for each bundle and edge (the output function of PCG, O'Neill 2014, twice)."""
    word = seed ^ (edge.astype(jnp.uint32) * jnp.uint32(0x9E3779B9))
    for _ in range(2):
        word = word * jnp.uint32(747796405) + jnp.uint32(2891336453)
        word = ((word >> ((word >> 28) + 4)) ^ word) * jnp.uint32(277803737)
        word = (word >> 22) ^ word
    return (word >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
