"""Queries for batches: `vmap` makes longer lists of queries, and each device answers its own part of a batch.

A query is a call of another library, which XLA would repeat on every device. If a batch is sharded over devices (for
example `jit` of a `vmap` over sharded keys), each device calls the library for its own part.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import NamedSharding, PartitionSpec

from jaxdr import loops


class _Query(NamedTuple):
    """`function(*fixed, *rows)` of the leaves of `structure`; `is_row` says which leaves belong to `rows`."""

    function: Callable
    structure: Any
    is_row: tuple[bool, ...]


def asked(query: Callable, fixed: tuple, rows: tuple = ()) -> Any:
    """`query(*fixed, *rows)` of arrays in records. Under `vmap`, if only `rows` are batched, they become longer.

    Other batches run one by one. Results have as many rows as `rows`, if there are any.
    """
    leaves, structure = jax.tree.flatten((fixed, rows))
    ends = len(jax.tree.leaves(fixed))
    is_row = tuple(i >= ends for i in range(len(leaves)))
    return _call(_Query(query, structure, is_row), (False,) * len(leaves))(*loops.varying(leaves))


def _call(query: _Query, batched: tuple[bool, ...]) -> Callable:
    """The query as a function of its leaves. `batched` leaves, and then the results, have an additional first axis."""

    def once(*leaves):
        fixed, rows = jax.tree.unflatten(query.structure, leaves)
        return query.function(*fixed, *rows)

    def batch(*leaves):
        size = next(leaf.shape[0] for leaf, b in zip(leaves, batched, strict=True) if b)
        if any(b and not row for b, row in zip(batched, query.is_row, strict=True)):
            return jax.lax.map(
                lambda i: once(*(leaf[i] if b else leaf for leaf, b in zip(leaves, batched, strict=True))),
                jnp.arange(size),
            )

        def flat(leaf, b, row):
            if not row:
                return leaf
            leaf = leaf if b else jnp.broadcast_to(leaf, (size, *leaf.shape))
            return leaf.reshape(-1, *leaf.shape[2:])

        results = once(*map(flat, leaves, batched, query.is_row))
        return jax.tree.map(lambda r: r.reshape(size, -1, *r.shape[1:]), results)

    several = _divided(batch, batched) if jax.device_count() > 1 else batch
    function = custom_vmap(several if any(batched) else once)

    @function.def_vmap
    def more(size, added, *leaves):
        """Add another first axis, and merge it with the one that is there."""
        inner = next((leaf.shape[a] for leaf, a, b in zip(leaves, added, batched, strict=True) if b), 1)
        both = tuple(a or b for a, b in zip(added, batched, strict=True))

        def merged(leaf, a, b):
            if not (a or b) or not any(batched):
                return leaf
            leaf = leaf if a else jnp.broadcast_to(leaf, (size, *leaf.shape))
            leaf = leaf if b else jnp.repeat(leaf[:, None], inner, axis=1)
            return leaf.reshape(-1, *leaf.shape[2:])

        results = _call(query, both)(*map(merged, leaves, added, batched))
        if any(batched):
            results = jax.tree.map(lambda r: r.reshape(size, inner, *r.shape[1:]), results)
        return results, jax.tree.map(lambda _: True, results)

    return function


def _divided(function: Callable, batched: tuple[bool, ...]) -> Callable:
    """The same function, which each device calls for its own part of the batch."""
    divided = custom_partitioning(function)

    def partition(mesh, arguments, results):
        axis = next((_first(a.sharding) for a, b in zip(arguments, batched, strict=True) if b), None)
        whole, share = (NamedSharding(mesh, PartitionSpec(*spec)) for spec in ((), (axis,)))
        wanted = tuple(share if b else whole for b in batched)
        return mesh, function, jax.tree.map(lambda _: share, results), wanted

    def rule(mesh, arguments, results):
        """Shardy's rule: all arrays share the first axis, and other axes are whole on every device."""
        names = (f"a{i}" for i in range(1000))
        others = []

        def factors(kind, b):
            own = [next(names) for _ in range(len(kind.shape) - b)]
            others.extend(own)
            return " ".join([*["b"] * b, *own])

        left = ", ".join(factors(kind, b) for kind, b in zip(arguments, batched, strict=True))
        right = ", ".join(factors(kind, True) for kind in results)
        return f"{left} -> {right}", {"need_replication_factors": tuple(others)}

    divided.def_partition(partition, sharding_rule=rule)
    return divided


def _first(sharding) -> Any:
    """The mesh axes over which the first axis is divided, or None."""
    spec = sharding.spec
    return spec[0] if len(spec) else None
