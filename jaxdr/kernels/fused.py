"""`fused(function)`: the same function, whose arithmetic on rows is done by kernels on CPUs."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jax.interpreters import ad, batching, mlir

from jaxdr.kernels import machine
from jaxdr.kernels.flatten import most_products, small_constant
from jaxdr.kernels.program import Counts, Program
from jaxdr.kernels.rows import LEAST

logger = logging.getLogger("jaxdr.kernels")


def fused(function: Callable, fewest: int = 0) -> Callable:
    """The same function of arrays in pytrees. `vmap` of it is `fused` of the function's `vmap`, or one call a member.

    XLA computes all of a program if none of its products has as many numbers as `fewest`: then kernels do not pay.

    Apply it where nobody differentiates any more. If somebody does, XLA computes value and derivative.

    Results are those of XLA up to rounding. Where a kernel can't be compiled, XLA computes all, and a warning of the
    logger `jaxdr.kernels` says so. At the level INFO it names what is left to XLA.
    """

    def called(*arguments):
        leaves, structure = jax.tree.flatten(arguments)
        shape: list = []

        def of_leaves(*leaves):
            results, out = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
            shape.append(out)
            return results

        closed, constants = _apart(jax.make_jaxpr(of_leaves)(*leaves))
        results = _fused.bind(*constants, *leaves, closed=closed, fewest=fewest)
        return jax.tree.unflatten(shape[-1], results)

    return called


def _apart(closed: core.ClosedJaxpr) -> tuple[core.ClosedJaxpr, list[Any]]:
    """(the jaxpr with its constants as leading arguments, except those that are known and small; these constants)."""
    jaxpr = closed.jaxpr
    known = [small_constant(c) for c in closed.consts]
    named = list(zip(jaxpr.constvars, closed.consts, known, strict=True))
    variables, constants = [v for v, _, k in named if k is None], [c for _, c, k in named if k is None]
    kept = jaxpr.replace(invars=[*variables, *jaxpr.invars], constvars=[v for v, _, k in named if k is not None])
    return core.ClosedJaxpr(kept, [k for k in known if k is not None]), constants


_fused = core.Primitive("jaxdr_fused")
_fused.multiple_results = True


@_fused.def_impl
def _now(*operands, **how):
    return jax.jit(partial(_fused.bind, **how))(*operands)


@_fused.def_abstract_eval
def _abstract(*operands, closed, fewest):
    return closed.out_avals


def _batched(operands, axes, closed, fewest):
    """Members with enough rows for kernels run one after another on CPUs: their kernels are those of one member."""
    axes = tuple(a if isinstance(a, int) else None for a in axes)
    together = fused(jax.vmap(core.jaxpr_as_fun(closed), in_axes=axes), fewest)

    def one_by_one(*operands):
        moved = [x if a is None else jnp.moveaxis(x, a, 0) for x, a in zip(operands, axes, strict=True)]

        def of_member(members):
            left = iter(members)
            given = [x if a is None else next(left) for x, a in zip(moved, axes, strict=True)]
            return _fused.bind(*given, closed=closed, fewest=fewest)

        return jax.lax.map(of_member, [x for x, a in zip(moved, axes, strict=True) if a is not None])

    if most_products(closed) < max(fewest, LEAST):
        results = together(*operands)
    else:
        results = jax.lax.platform_dependent(*operands, cpu=one_by_one, default=together)
    return results, [0] * len(results)


def _by_xla(*operands, closed, fewest=0):
    return core.jaxpr_as_fun(closed)(*operands)


def _by_kernels(*operands: Any, closed: core.ClosedJaxpr, fewest: int) -> list:
    """Trace the program with its kernels, and wait until they are compiled."""
    if most_products(closed) < fewest:
        return _by_xla(*operands, closed=closed)
    counts = Counts()
    try:
        program = Program(
            closed, counts, [None] * len(operands), [False] * len(operands), [False] * len(closed.out_avals)
        )
        machine.ready(counts.targets)
    except machine.CompilerError as error:
        logger.warning("XLA computes what kernels should: %s", error)
        return _by_xla(*operands, closed=closed)
    left = ", ".join(f"{n} {name}" for name, n in sorted(counts.left.items(), key=lambda x: -x[1]))
    logger.info("%d operations in %d kernels; left to XLA: %s", counts.fused, len(counts.targets), left)
    return [result[0] for result in program([[x] for x in operands])]


def _differentiated(primals, tangents, closed, fewest):
    moving = [jnp.issubdtype(p.dtype, np.inexact) for p in primals]
    at = [p for p, moves in zip(primals, moving, strict=True) if moves]
    along = [ad.instantiate_zeros(t) for t, moves in zip(tangents, moving, strict=True) if moves]

    def of_moving(*values):
        left = iter(values)
        return core.jaxpr_as_fun(closed)(*(next(left) if m else p for p, m in zip(primals, moving, strict=True)))

    return jax.jvp(of_moving, at, along)


batching.primitive_batchers[_fused] = _batched
ad.primitive_jvps[_fused] = _differentiated
mlir.register_lowering(_fused, mlir.lower_fun(_by_xla, multiple_results=True))
mlir.register_lowering(_fused, mlir.lower_fun(_by_kernels, multiple_results=True), platform="cpu")
