"""Compaction: the numbers of the rows that count, moved to the front."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


def rows_where(mask: Bool[Array, " n"], size: int | None = None, fill_value: int = 0) -> Int[Array, " size"]:
    """Numbers of the rows where `mask` is true, in order, then `fill_value`. At most `size` (default n) are kept.

    It is like `jnp.nonzero` but with one running sum instead of two. XLA compiles each sum to a tree of small kernels.
    """
    size = mask.shape[0] if size is None else size
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, size)
    rows = jnp.full(size, fill_value, jnp.int32)
    return rows.at[place].set(jnp.arange(mask.shape[0], dtype=jnp.int32), mode="drop")
