"""The loops and branches of `jax.lax`, which here also work inside `jax.shard_map`.

Inside `jax.shard_map` JAX marks values that differ between devices. The marks of a loop's state must be the same before
and after an iteration, those of the results of all branches must be the same, and so must those of all arrays in a call
of another library. But the zeros with which a loop begins are the same on all devices, and its results are not. So here
every value is marked as different.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
from jax.core import ShapedArray

Tree = TypeVar("Tree")


def varying(tree: Tree) -> Tree:
    """The same arrays, marked as different on every device of the surrounding `jax.shard_map`, if there is one."""
    axes = set(jax.sharding.get_abstract_mesh().manual_axes)

    def marked(x):
        missing = axes - _axes(jax.typeof(x))
        return jax.lax.pcast(x, tuple(sorted(missing, key=str)), to="varying") if missing else x

    return jax.tree.map(marked, tree) if axes else tree


def scan(body: Callable, start: Any, xs: Any = None, length: int | None = None) -> Any:
    """`jax.lax.scan`, also inside `jax.shard_map`."""

    def turn(carry, x):
        carry, out = body(carry, x)
        return varying(carry), out

    return jax.lax.scan(turn, varying(start), xs, length)


def fori_loop(lower: Any, upper: Any, body: Callable, start: Any) -> Any:
    """`jax.lax.fori_loop`, also inside `jax.shard_map`."""
    return jax.lax.fori_loop(lower, upper, lambda i, state: varying(body(i, state)), varying(start))


def while_loop(goes_on: Callable, body: Callable, start: Any) -> Any:
    """`jax.lax.while_loop`, also inside `jax.shard_map`."""
    return jax.lax.while_loop(goes_on, lambda state: varying(body(state)), varying(start))


def cond(predicate: Any, if_true: Callable, if_false: Callable, *operands: Any) -> Any:
    """`jax.lax.cond`, also inside `jax.shard_map`."""
    return jax.lax.cond(predicate, *(lambda *x, f=f: varying(f(*x)) for f in (if_true, if_false)), *operands)


def result_like(operands: Sequence[Any], shape: tuple[int, ...], dtype: Any) -> ShapedArray:
    """The abstract result of a primitive on `varying` operands: an array with their marks."""
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
