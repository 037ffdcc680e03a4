"""`jax.jit` with compiler options that suit programs of this library."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax

# Loops over fused operations are emitted the old way. With the new one (on by default since 2025; measured with jaxlib
# 0.10.2, experiments/compilation) programs that gather a lot, as all here do, take half as long again, to compile and
# to run.
CPU_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


def jit(function: Callable, **settings: Any) -> Any:
    """``jax.jit(function, **settings)``, compiled for speed on the CPU; elsewhere ``jax.jit`` itself.

    Results agree with those of ``jax.jit`` to rounding. For the outermost function, ``jit(jax.grad(loss))``: JAX takes
    compiler options nowhere else, and raises ValueError ("can only be passed to top-level `jax.jit`") where the result
    is called inside of another `jax.jit`, `jax.grad` or `jax.vmap`. For a whole process
    `XLA_FLAGS=--xla_cpu_use_fusion_emitters=false` does the same.
    """
    return jax.jit(function, compiler_options=compiler_options(jax.default_backend()), **settings)


@cache
def compiler_options(backend: str) -> dict[str, Any] | None:
    """XLA's options for a backend; None where there are none, or this version of XLA does not know them."""
    if backend != "cpu":
        return None
    try:
        jax.jit(lambda x: x, compiler_options=CPU_OPTIONS).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return None
    return CPU_OPTIONS


def unfolded(tree: Any) -> Any:
    """The tree of arrays, out of reach of XLA's constant folding: for what a jitted function may close over.

    XLA would compute tables of a scene (sums, gathers, sorts) when it compiles, by an interpreter: minutes for large
    ones. A barrier is taken out after that, so it costs nothing when the program runs.
    """
    return jax.lax.optimization_barrier(tree)
