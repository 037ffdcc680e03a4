"""Rows that count, gathered in front."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


def rows_where(mask: Bool[Array, " n"], size: int | None = None, fill_value: int = 0) -> Int[Array, " size"]:
    """Numbers of the rows where `mask`, in order, then `fill_value`; those beyond `size` (n by default) are left out.

    As `jnp.nonzero`, with one running sum in place of two: XLA compiles each as a tree of small kernels.
    """
    size = mask.shape[0] if size is None else size
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, size)
    rows = jnp.full(size, fill_value, jnp.int32)
    return rows.at[place].set(jnp.arange(mask.shape[0], dtype=jnp.int32), mode="drop")
