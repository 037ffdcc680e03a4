"""`jax.jit` with compiler options that suit programs of this library."""

from collections.abc import Callable
from functools import cache
from typing import Any

import jax

from jaxdr.argument_kinds import checked

# Measured with jaxlib 0.10.2 (experiments/compilation). Loops over fused operations are emitted the old way. The new
# way (the default since 2025) makes programs with many gathers, as all here are, clearly slower to compile and to run.
# Sums over short axes are XLA's own loops, because the library that XLA calls by default is several times slower.
# jaxlib 0.11 and 0.12 have the new way alone. There the same programs take 1.4 times as long to compile.
CPU_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_experimental_ynn_fusion_type": "LIBRARY_FUSION_TYPE_DOT",
}


@checked
def jit(function: Callable, **settings: Any) -> Any:
    """``jax.jit(function, **settings)``, compiled for speed on the CPU. Elsewhere it is ``jax.jit`` itself.

    Results agree with those of ``jax.jit`` up to rounding. Use it for the outermost function: ``jit(jax.grad(loss))``.
    JAX takes compiler options nowhere else. If the result is called inside another `jax.jit`, `jax.grad` or `jax.vmap`,
    JAX raises ValueError ("can only be passed to top-level `jax.jit`"), before its version 0.12.

    For a whole process, `XLA_FLAGS="--xla_cpu_use_fusion_emitters=false --xla_cpu_experimental_ynn_fusion_type=dot"`
    does the same.
    """
    return jax.jit(function, compiler_options=compiler_options(jax.default_backend()), **settings)


@cache
def compiler_options(backend: str) -> dict[str, Any] | None:
    """The compiler options for a backend that this version of XLA knows; None if there are none."""
    if backend != "cpu":
        return None
    return {name: value for name, value in CPU_OPTIONS.items() if _is_known({name: value})} or None


def _is_known(option: dict[str, Any]) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options=option).lower(0.0).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def unfolded(tree: Any) -> Any:
    """The tree of arrays behind a barrier against XLA's constant folding; for values that jitted functions close over.

    When XLA compiles, it would compute tables of a scene (sums, gathers, sorts) by an interpreter, which takes minutes
    for large scenes. XLA removes the barrier afterwards, so it costs nothing at run time.
    """
    return jax.lax.optimization_barrier(tree)
