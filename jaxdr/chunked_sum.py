"""The derivative of a sum over chunks, chunk by chunk in both modes. So memory does not grow with their number.

The derivative of sum_i f(at, fixed, i) is linear in the displacement of `at`. It is a JAX primitive, which is
transposed as a whole: forward mode runs the jvp of one chunk after the other, reverse mode the vjp. So a chunk is
traced once, and no chunk keeps residuals.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend import core
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

from jaxdr import loops
from jaxdr.kernels import computed


class _Sum(NamedTuple):
    """The static part of a sum; hashable.

    `axes` are the batch axes of the operands for every level of `vmap` around the sum, the innermost first; the
    result's batch axis is 0. `count` is the number of arrays in `at`, `structure` the tree structure of `fixed`.
    """

    term: Callable[[list[Array], Any, Array], Array]
    chunks: int
    count: int
    structure: Any
    shape: tuple[int, ...]
    dtype: Any
    compute: str
    axes: tuple[tuple[int | None, ...], ...] = ()


def chunked_derivative(
    term: Callable[[list[Array], Any, Array], Array],
    chunks: int,
    at: list[Array],
    moved: list[Array],
    fixed: Any,
    out: jax.ShapeDtypeStruct,
    compute: str = "xla",
) -> Array:
    """Derivative of the sum of `term(at, fixed, i)`, i = 0, ... `chunks` - 1, by `at` along `moved`; like `out`.

    `term` is hashable, equal to other terms that compute the same, and closes over no arrays. The result is linear in
    `moved`: it can be differentiated by `moved`, and works under jit and vmap. Raises NotImplementedError for
    derivatives by `at` or `fixed`, which are second derivatives of the sum. `compute` is as in `kernels.computed`.
    """
    leaves, structure = jax.tree.flatten(fixed)
    how = _Sum(term, chunks, len(at), structure, tuple(out.shape), jnp.dtype(out.dtype), compute)
    return _derivative.bind(*loops.varying((*at, *leaves, *moved)), how=how)


def _chunk(how: _Sum, leaves, index):
    """The term of one chunk as a function of `at`; `leaves` are those of `fixed`."""
    fixed = jax.tree.unflatten(how.structure, leaves)
    return lambda *at: how.term(list(at), fixed, index)


def _over_chunks(how: _Sum, part: Callable[[Any], Any], zero):
    """Sum of `part(index)` over the chunks."""
    if how.chunks == 1:
        return part(0)

    def add(total, index):
        return jax.tree.map(jnp.add, total, part(index)), None

    return loops.scan(add, zero, jnp.arange(how.chunks))[0]


def _sum_forward(how: _Sum, *operands) -> Array:
    """Forward mode, chunk by chunk."""
    at, leaves, moved = operands[: how.count], operands[how.count : -how.count], operands[-how.count :]

    def part(index):
        return jax.jvp(_chunk(how, leaves, index), at, moved)[1]

    return _over_chunks(how, part, jnp.zeros(how.shape, how.dtype))


def _sum_backward(how: _Sum, *operands) -> list[Array]:
    """Reverse mode, chunk by chunk; the last operand is the cotangent of the sum."""
    *operands, cotangent = operands
    at, leaves = operands[: how.count], operands[how.count :]

    def part(index):
        _, pull = jax.vjp(_chunk(how, leaves, index), *at)
        return list(pull(cotangent))

    return _over_chunks(how, part, [jnp.zeros_like(a) for a in at])


def _forward(*operands, how: _Sum) -> Array:
    function = partial(_sum_forward, how)
    for axes in how.axes:
        function = jax.vmap(function, in_axes=axes)
    return computed(function, how.compute)(*operands)


@partial(jax.jit, static_argnames="how")
def _backward(*operands, how: _Sum) -> list[Array]:
    function, count = partial(_sum_backward, how), how.count
    for axes in how.axes:
        function = _batched_backward(function, axes[:-count], axes[-count:])
    return computed(function, how.compute)(*operands)


def _batched_backward(function, axes, moved_axes):
    """`function` for one level of `vmap`: cotangents of operands without a batch axis are summed."""

    def backward(*operands):
        parts = jax.vmap(function, in_axes=(*axes, 0))(*operands)
        return [
            part.sum(0) if axis is None else jnp.moveaxis(part, 0, axis)
            for part, axis in zip(parts, moved_axes, strict=True)
        ]

    return backward


def dependent(function: Callable[[Any], list[Array]], at: Any) -> tuple[bool, ...]:
    """Which of the arrays that `function(at)` returns may have a derivative, judged by its jaxpr."""
    closed = jax.make_jaxpr(function)(at)
    return tuple(_marked(closed.jaxpr, [True] * len(closed.jaxpr.invars)))


def _marked(jaxpr: core.Jaxpr, inputs: list[bool]) -> list[bool]:
    """Which results of a jaxpr depend on the marked inputs, not counting detached dependence."""
    marked = {var for var, mark in zip(jaxpr.invars, inputs, strict=True) if mark}

    def has(atom) -> bool:
        floating = jnp.issubdtype(atom.aval.dtype, jnp.floating)
        return floating and not isinstance(atom, core.Literal) and atom in marked

    for equation in jaxpr.eqns:
        given = [has(atom) for atom in equation.invars]
        if not any(given) or equation.primitive.name == "stop_gradient":
            continue
        inner = equation.params.get("jaxpr") if equation.primitive.name in ("jit", "pjit") else None
        marks = [True] * len(equation.outvars) if inner is None else _marked(inner.jaxpr, given)
        marked |= {var for var, mark in zip(equation.outvars, marks, strict=True) if mark}
    return [has(var) for var in jaxpr.outvars]


_FIRST_ONLY = (
    "jaxdr: an image has first derivatives only: its boundary terms are zero in value and right in the first "
    "derivative; take finite differences of jax.grad for second ones"
)

_derivative = core.Primitive("chunked_derivative")
_derivative.def_impl(partial(jax.jit, static_argnames="how")(_forward))


@_derivative.def_abstract_eval
def _abstract(*operands, how: _Sum):
    shape = how.shape
    # The axis of the innermost level was added to the front last.
    sizes = []
    shapes = [operand.shape for operand in operands]
    for axes in reversed(how.axes):
        sizes.append(next(s[a] for s, a in zip(shapes, axes, strict=True) if a is not None))
        shapes = [s if a is None else s[:a] + s[a + 1 :] for s, a in zip(shapes, axes, strict=True)]
    return loops.result_like(operands, (*sizes, *shape), how.dtype)


def _batch(operands, axes, how: _Sum):
    axes = tuple(axis if isinstance(axis, int) else None for axis in axes)
    return _derivative.bind(*operands, how=how._replace(axes=(*how.axes, axes))), 0


def _jvp(primals, tangents, how: _Sum):
    fixed, moved = primals[: -how.count], tangents[-how.count :]
    if any(not isinstance(t, ad.Zero) for t in tangents[: -how.count]):
        raise NotImplementedError(_FIRST_ONLY)
    return _derivative.bind(*primals, how=how), _derivative.bind(*fixed, *map(ad.instantiate_zeros, moved), how=how)


def _transpose(cotangent, *operands, how: _Sum):
    fixed = operands[: -how.count]
    none = [None] * len(fixed)
    if isinstance(cotangent, ad.Zero):
        return [*none, *(ad.Zero(o.aval) for o in operands[-how.count :])]
    return [*none, *_backward(*first_only(fixed), cotangent, how=how)]


@jax.custom_jvp
def first_only(operands: Any) -> Any:
    """The same arrays. Raises NotImplementedError for derivatives by them.

    A rule for first derivatives takes it for whatever the derivative depends on. Then no second derivative is short of
    a part without a word, also where the first is by one parameter and the second by another.
    """
    return operands


@first_only.defjvp
def _(primals, tangents):
    raise NotImplementedError(_FIRST_ONLY)


mlir.register_lowering(_derivative, mlir.lower_fun(_forward, multiple_results=False))
batching.primitive_batchers[_derivative] = _batch
ad.primitive_jvps[_derivative] = _jvp
ad.primitive_transposes[_derivative] = _transpose
