"""Compaction: the numbers of the rows that count, moved to the front."""

from functools import partial

import jax
import jax.numpy as jnp
from jax.extend import core
from jax.interpreters import batching, mlir
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops


def rows_where(mask: Bool[Array, " n"], size: int | None = None, fill_value: int = 0) -> Int[Array, " size"]:
    """Numbers of the rows where `mask` is true, in order, then `fill_value`. At most `size` (default n) are kept.

    It is like `jnp.nonzero` but with one running sum instead of two. XLA compiles each sum to a tree of small kernels.
    It is a primitive, for which `jaxdr.kernels` has a handler.
    """
    size = mask.shape[0] if size is None else size
    return _rows_where.bind(loops.varying(mask), size=int(size), fill=int(fill_value))


def kept_rows(
    mask: Bool[Array, " n"], room: int, key: PRNGKeyArray
) -> tuple[Int[Array, " room"], Int[Array, ""], Float[Array, ""]]:
    """(numbers of rows where `mask` is true, how many are kept, the weight of each).

    If there are more rows than room, as many are kept at even distances from a random start. So every row has the same
    chance, and the weight is its inverse: a sum over the kept rows has no bias.
    """
    if room >= mask.shape[0]:
        return rows_where(mask, room), mask.sum(), jnp.ones(())
    every, found = rows_where(mask), mask.sum()
    thinned = jnp.maximum(found / room, 1.0)
    rank = (jnp.arange(room) + jax.random.uniform(key)) * thinned
    first = jnp.arange(room)
    rank = jnp.where(found > room, jnp.minimum(rank.astype(jnp.int32), found - 1), first)
    return every[rank], jnp.minimum(found, room), thinned


def _by_xla(mask, size: int, fill: int):
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, size)
    rows = jnp.full(size, fill, jnp.int32)
    return rows.at[place].set(jnp.arange(mask.shape[0], dtype=jnp.int32), mode="drop")


_rows_where = core.Primitive("rows_where")
_rows_where.def_impl(partial(jax.jit, static_argnames=("size", "fill"))(_by_xla))


@_rows_where.def_abstract_eval
def _abstract(mask, size: int, fill: int):
    return loops.result_like([mask], (size,), jnp.dtype("int32"))


def _batch(operands, axes, size: int, fill: int):
    return jax.vmap(partial(_by_xla, size=size, fill=fill), in_axes=axes)(*operands), 0


mlir.register_lowering(_rows_where, mlir.lower_fun(_by_xla, multiple_results=False))
batching.primitive_batchers[_rows_where] = _batch
