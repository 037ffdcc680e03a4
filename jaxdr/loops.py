"""Loops and branches as those of `jax.lax`, that work inside of `jax.shard_map` as well.

JAX checks there which values differ between devices: what a loop carries is marked alike before and after a turn, what
branches return is marked alike, and calls of other libraries get arrays that are marked alike. The zeros that a loop
begins with are the same on all devices, and its results are not. Here everything counts as different.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
from jax.core import ShapedArray

Tree = TypeVar("Tree")


def varying(tree: Tree) -> Tree:
    """The same arrays, marked as different on every device of the `jax.shard_map` around; elsewhere as they are."""
    axes = set(jax.sharding.get_abstract_mesh().manual_axes)

    def marked(x):
        missing = axes - _axes(jax.typeof(x))
        return jax.lax.pcast(x, tuple(sorted(missing, key=str)), to="varying") if missing else x

    return jax.tree.map(marked, tree) if axes else tree


def scan(body: Callable, start: Any, xs: Any = None, length: int | None = None) -> Any:
    """`jax.lax.scan`."""

    def turn(carry, x):
        carry, out = body(carry, x)
        return varying(carry), out

    return jax.lax.scan(turn, varying(start), xs, length)


def fori_loop(lower: Any, upper: Any, body: Callable, start: Any) -> Any:
    """`jax.lax.fori_loop`."""
    return jax.lax.fori_loop(lower, upper, lambda i, state: varying(body(i, state)), varying(start))


def while_loop(goes_on: Callable, body: Callable, start: Any) -> Any:
    """`jax.lax.while_loop`."""
    return jax.lax.while_loop(goes_on, lambda state: varying(body(state)), varying(start))


def cond(predicate: Any, if_true: Callable, if_false: Callable, *operands: Any) -> Any:
    """`jax.lax.cond`."""
    return jax.lax.cond(predicate, *(lambda *x, f=f: varying(f(*x)) for f in (if_true, if_false)), *operands)


def result_like(operands: Sequence[Any], shape: tuple[int, ...], dtype: Any) -> ShapedArray:
    """What a primitive returns that works on `varying` operands: an array with their marks."""
    first = operands[0]
    if not _axes(first):
        return ShapedArray(shape, dtype)
    sharding = jax.sharding.NamedSharding(jax.sharding.get_abstract_mesh(), jax.sharding.PartitionSpec())
    name = "manual_axis_type" if hasattr(first, "manual_axis_type") else "vma"
    return ShapedArray(shape, dtype, sharding=sharding, **{name: getattr(first, name)})


def _axes(kind: Any) -> set[Any]:
    """The mesh axes along which a value of this type differs; JAX 0.10.2 has renamed the attribute."""
    if hasattr(kind, "manual_axis_type"):
        return set(kind.manual_axis_type.varying)
    return set(kind.vma)
