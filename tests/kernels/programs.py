"""Functions by kernels beside the same by XLA."""

import jax
import numpy as np

from jaxdr.kernels import fused
from jaxdr.kernels.fused import small_constant
from jaxdr.kernels.program import Counts, Program

N = 1003  # rows; no multiple of a vector's width


def both(function, *arguments, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Assert that kernels compute what XLA does, NaN and the signs of infinities included."""
    fused_count, _ = operations(function, *arguments)
    assert fused_count > 0, "no operation is in a kernel"
    found, expected = jax.jit(fused(function))(*arguments), function(*arguments)  # one by one, without XLA's fusion
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype and a.shape == b.shape
        a, b = np.asarray(a), np.asarray(b)
        if a.dtype.kind == "f":
            # XLA counts subnormal numbers as zero.
            np.testing.assert_allclose(a, b, rtol=rtol, atol=max(atol, 1.2e-38))
        else:
            np.testing.assert_array_equal(a, b)


def operations(function, *arguments) -> tuple[int, set[str]]:
    """(number of operations in kernels, names of those that are left to XLA, without those that only move numbers)."""
    counts = Counts()
    closed = jax.make_jaxpr(function)(*arguments)
    assert all(small_constant(c) is not None for c in closed.consts)
    whole = [False] * len(arguments), [False] * len(closed.out_avals)
    Program(closed, counts, [None] * len(arguments), *whole)
    moves = {"broadcast_in_dim", "reshape", "squeeze", "slice", "convert_element_type", "iota", "concatenate", "stack"}
    return counts.fused, counts.left.keys() - moves
