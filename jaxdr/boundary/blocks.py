"""Work on lists of unknown length: room for the worst case, time for what there is."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

BLOCKS = 6


def sum_over_blocks(function: Callable[[Any, Int[Array, " b"]], Any], slots: Any, used: Int[Array, ""]) -> Any:
    """Sum of `function(block of slots, their numbers)` over the blocks of a list whose first `used` slots are filled.

    Blocks behind them are not computed (under `vmap` they are, for nothing). Slots from `used` on may hold copies of
    filled ones: leave them out by number. Differentiable in forward and reverse mode.
    """
    length = jax.tree.leaves(slots)[0].shape[0]
    size = length // BLOCKS + 1  # some padding in any case: the program is the same for all lengths
    padding = size * BLOCKS - length

    def blocks(table):
        table = jnp.concatenate([table, jnp.repeat(table[-1:], padding, axis=0)])
        return table.reshape(BLOCKS, size, *table.shape[1:])

    def part(block, index):
        return function(block, index * size + jnp.arange(size))

    shapes = jax.eval_shape(part, jax.tree.map(lambda t: t[:size], slots), jnp.int32(0))
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)

    def body(total, step):
        index, block = step
        added = jax.lax.cond(index * size < used, part, lambda *_: zeros, block, index)
        return jax.tree.map(jnp.add, total, added), None

    return jax.lax.scan(body, zeros, (jnp.arange(BLOCKS, dtype=jnp.int32), jax.tree.map(blocks, slots)))[0]
