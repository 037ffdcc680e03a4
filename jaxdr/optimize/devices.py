"""The views of a step divided over devices: a view each, or a share of the samples of a view each.

A program works on as many views at once as there are rows of devices, and on one view on each device. So what one
device computes does not depend on how many there are: without shares a step has the same bits on two devices and on
more. The program of a single one rounds differently.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding, PartitionSpec
from jaxtyping import PRNGKeyArray

from jaxdr.compilation import jit

Device = Any  # jax.Device, which is a variable to type checkers
VIEW, SHARE = "view", "share"  # axes of the mesh of devices


class Division(NamedTuple):
    """`rows` views at once, and `shares` devices for each of them; hashable. A single device has one of each."""

    rows: int = 1
    shares: int = 1

    def samples(self, spp: int) -> int:
        """Samples per pixel of each share."""
        return -(-spp // self.shares)

    def own_key(self, key: PRNGKeyArray) -> PRNGKeyArray:
        """The key of a share, made from the key of its view; called inside a divided program."""
        return key if self.shares == 1 else jax.random.fold_in(key, jax.lax.axis_index(SHARE))

    def mean(self, tree: Any) -> Any:
        """The mean over the shares of a view; called inside a divided program."""
        return tree if self.shares == 1 else jax.lax.pmean(tree, SHARE)


ALONE = Division()


def divide(views: int, devices: int, spp: int) -> Division:
    """How devices share the views of a step, each of `spp` samples per pixel: all work, and the step ends soonest.

    Among equally fast divisions it takes the one with fewer shares, because work that all samples of a view have in
    common is then done once.
    """

    def cost(rows: int) -> int:
        return -(-views // rows) * Division(rows, devices // rows).samples(spp)

    rows = min((r for r in range(1, devices + 1) if devices % r == 0), key=lambda r: (cost(r), -r))
    return Division(rows, devices // rows)


def chosen_devices(count: int | None = None) -> list[Device]:
    """The first `count` devices of all processes; all by default. Raises ValueError where there are fewer."""
    devices = jax.devices()
    if count is not None and not 1 <= count <= len(devices):
        raise ValueError(f"devices: {count} asked for, but there are only {len(devices)} ({devices[0].device_kind})")
    if count is not None and jax.process_count() > 1 and count < len(devices):
        raise ValueError("devices: a run of several processes takes all devices of each; leave the number out")
    return devices[:count]


class Divided:
    """`function(common, item)` for several items at once, divided over devices; both are pytrees of arrays.

    With a `Division` of one row and share it is the compiled function itself, called for one item after the other.
    """

    def __init__(self, function: Callable[[Any, Any], Any], division: Division, devices: Sequence[Device]):
        self.division, self.several = division, len(devices) > 1
        if not self.several:
            self.program = jit(function)
            return
        rows, shares = division
        self.mesh = jax.sharding.Mesh(np.asarray(devices).reshape(rows, shares), (VIEW, SHARE))

        def one(common, items):
            common, items = _with_keys(common), jax.tree.map(lambda x: x[0], items)
            return jax.tree.map(lambda x: x[None], function(common, _with_keys(items)))

        # Results are means over the shares, or the same for all of them, which JAX can't see.
        specs = {"in_specs": (PartitionSpec(), PartitionSpec(VIEW)), "out_specs": PartitionSpec(VIEW)}
        mapped = jax.shard_map(one, mesh=self.mesh, check_vma=False, **specs)
        # Each process has the results of all; within one they stay where they are until they are asked for.
        settings = {"out_shardings": self._on(PartitionSpec())} if jax.process_count() > 1 else {}
        self.program = jit(mapped, **settings)

    def __call__(self, common: Any, items: Sequence[Any]) -> list[Any]:
        """The results of all items, in their order."""
        if not self.several:
            return [self.program(common, item) for item in items]
        common, rows, results = self._placed(common, PartitionSpec()), self.division.rows, []
        for batch in batches(items, rows):
            found = self.program(common, self._stacked(batch))
            results.append(found)
        hosts = [jax.tree.map(np.asarray, found) for found in results]
        each = [jax.tree.map(lambda x, i=i: x[i], found) for found in hosts for i in range(rows)]
        return each[: len(items)]

    def compile(self, common: Any, item: Any) -> None:
        """Compile the program for arrays like these, without waiting for other devices."""
        if not self.several:
            self.program(common, item)
            return
        batch = [item] * self.division.rows
        self.program.lower(self._placed(common, PartitionSpec()), self._stacked(batch)).compile()

    def _stacked(self, batch: Sequence[Any]) -> Any:
        items = [_key_data(item) for item in batch]
        return self._placed(jax.tree.map(lambda *x: np.stack(x), *items), PartitionSpec(VIEW))

    def _placed(self, tree: Any, spec: PartitionSpec) -> Any:
        """Arrays on all devices: whole, or one row on each. Every process passes the same arrays."""
        sharding = self._on(spec)

        def placed(x):
            x = np.asarray(x)
            return jax.make_array_from_callback(x.shape, sharding, lambda index: x[index])

        return jax.tree.map(placed, _key_data(tree))

    def _on(self, spec: PartitionSpec) -> NamedSharding:
        return NamedSharding(self.mesh, spec)


def batches(items: Iterable[Any], size: int) -> list[list[Any]]:
    """Items in lists of `size`; the last one is filled up with its last item again."""
    items = list(items)
    found = [items[i : i + size] for i in range(0, len(items), size)]
    return [batch + batch[-1:] * (size - len(batch)) for batch in found]


class _KeyData(NamedTuple):
    """The words of a random key, which can be placed on devices like numbers."""

    words: Any


def _key_data(tree: Any) -> Any:
    """The tree on the host, with the words of its random keys in place of the keys."""

    def plain(x):
        is_key = isinstance(x, jax.Array) and jnp.issubdtype(x.dtype, jax.dtypes.prng_key)
        return _KeyData(np.asarray(jax.random.key_data(x))) if is_key else x

    return jax.tree.map(plain, tree)


def _with_keys(tree: Any) -> Any:
    """The tree with random keys in place of their words."""
    kind = _KeyData
    return jax.tree.map(
        lambda x: jax.random.wrap_key_data(x.words) if isinstance(x, kind) else x,
        tree,
        is_leaf=lambda x: isinstance(x, kind),
    )
