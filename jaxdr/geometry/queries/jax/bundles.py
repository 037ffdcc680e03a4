"""For each bundle one of the edges that it may cross, by a walk through the tree, for many bundles at once."""

import jax
import jax.numpy as jnp

from jaxdr import loops
from jaxdr.geometry.bundles import may_cross, within
from jaxdr.geometry.edge_tree import LEAF
from jaxdr.geometry.vector import corners, dot
from jaxdr.safe_divide import safe_divide
from jaxdr.sizes import at_once

# How many bundles go through the tree together. They wait for each other; on a GPU idle threads would cost more.
CPU_BLOCK, GPU_BLOCK = 2048, 1 << 17


def draw_edges(table, bundles, seed, reach):
    """(edge, importance, total) for each bundle: see `queries.draw_edges`."""
    count, active = bundles.end.shape[0], bundles.end > 0
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


def _draw(table, bundles, active, seed, reach):
    node_table, slots = table.tree.node, table.tree.edge
    leaves = slots.shape[0] // LEAF
    each = jax.tree.map(lambda x: x[:, None], bundles)
    interior = table.interior != 0

    def leaf(node, state, here):
        first = (jnp.where(here, node, leaves) - leaves) * LEAF
        edge = slots[first[:, None] + jnp.arange(LEAF)]
        exists = here[:, None] & (edge >= 0)
        edge = jnp.maximum(edge, 0)
        start, end = corners(table.ends[edge])
        _, crosses = may_cross(each, start, end - start, reach)
        facing = dot(table.normals[edge], each.direction[:, :, None]) > 0
        silhouette = ~interior[edge] | (facing[..., 0] != facing[..., 1])
        base = table.importance[edge]
        importance = jnp.where(silhouette, 1.0, base)
        importance = jnp.where(exists & (base > 0) & crosses, importance, 0.0)
        chosen, of_chosen, total = state
        for k in range(LEAF):
            total = total + importance[:, k]
            taken = _hashed(seed, edge[:, k]) < safe_divide(importance[:, k], total)
            chosen = jnp.where(taken, edge[:, k], chosen)
            of_chosen = jnp.where(taken, importance[:, k], of_chosen)
        return chosen, of_chosen, total

    def step(carry):
        node, state = carry
        box = node_table[node]
        centre, radius, rank = box[:, 0, :3], box[:, 0, 3], box[:, 1, 3]
        meets = (node > 0) & (rank > 0) & within(bundles, centre, radius, reach)
        at_leaf = node >= leaves
        state = leaf(node, state, meets & at_leaf)
        following = node + 1
        following = following >> jax.lax.population_count((following & -following) - 1)
        following = jnp.where(following <= 1, 0, following)
        return jnp.where(meets & ~at_leaf, 2 * node, jnp.where(node > 0, following, 0)), state

    nothing = jnp.zeros(seed.shape, jnp.int32)
    zero = jnp.zeros(seed.shape, bundles.end.dtype)
    start = (jnp.where(active, 1, 0), (nothing, zero, zero))
    return loops.while_loop(lambda carry: (carry[0] > 0).any(), step, start)[1]


def _hashed(seed, edge):
    """A uniform number in [0, 1) for each bundle and edge (the output function of PCG, O'Neill 2014, twice)."""
    word = seed.astype(jnp.uint32) ^ (edge.astype(jnp.uint32) * jnp.uint32(0x9E3779B9))
    for _ in range(2):
        word = word * jnp.uint32(747796405) + jnp.uint32(2891336453)
        word = ((word >> ((word >> 28) + 4)) ^ word) * jnp.uint32(277803737)
        word = (word >> 22) ^ word
    return (word >> 8).astype(jnp.float32) * jnp.float32(2.0**-24)
