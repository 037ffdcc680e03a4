"""Work on lists of unknown length: memory for the longest list, time for the filled slots only."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxdr import loops
from jaxdr.geometry.queries import rematerialised

BLOCKS = 8  # most lists have a power of two of slots; then no block needs padding


def sum_over_blocks(function: Callable[[Any, Int[Array, " b"]], Any], slots: Any, used: Int[Array, ""]) -> Any:
    """Sum of `function(block of slots, their numbers)` over the blocks of a list whose first `used` slots are filled.

    Later blocks are not computed (except under `vmap`, where their result is discarded). Slots from `used` on may hold
    copies of filled slots: leave them out by their numbers. Differentiable in forward and reverse mode.
    """
    part, zeros, blocks = _split(function, slots, used)

    def body(total, block):
        return jax.tree.map(jnp.add, total, part(block)), None

    return loops.scan(body, zeros, blocks)[0]


def map_over_blocks(function: Callable[[Any, Int[Array, " b"]], Any], slots: Any, used: Int[Array, ""]) -> Any:
    """Results of a function that has one for every slot. In the blocks that are not computed they are zero."""
    length = jax.tree.leaves(slots)[0].shape[0]
    part, _, blocks = _split(function, slots, used)
    stacked = loops.scan(lambda _, block: (None, part(block)), None, blocks)[1]
    return jax.tree.map(lambda t: t.reshape(-1, *t.shape[2:])[:length], stacked)


def _split(function, slots, used):
    """(function of a block, zeros like its result, the blocks with their numbers).

    The function gives zeros for blocks after the first `used` slots.
    """
    length = jax.tree.leaves(slots)[0].shape[0]
    size = -(-length // BLOCKS)
    padding = size * BLOCKS - length

    def split(table):
        if padding:
            table = jnp.concatenate([table, jnp.repeat(table[-1:], padding, axis=0)])
        return table.reshape(BLOCKS, size, *table.shape[1:])

    # Rematerialise twice. Without it around the block the loop would stack the branch's residuals; without it inside
    # the branch the branch would return them.
    @rematerialised
    def whole(block, index):
        return function(block, index * size + jnp.arange(size))

    shapes = jax.eval_shape(whole, jax.tree.map(lambda t: t[:size], slots), jnp.int32(0))
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)

    @rematerialised
    def part(numbered):
        index, block = numbered
        return loops.cond(index * size < used, whole, lambda *_: zeros, block, index)

    return part, zeros, (jnp.arange(BLOCKS, dtype=jnp.int32), jax.tree.map(split, slots))
