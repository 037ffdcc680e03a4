"""Acceleration structures kept between calls, found by the *content* of the arrays they were built from.

A ray query is a pure function of its arrays. To build a BVH for every call would be slow. So BVHs are kept, and reused
if every byte of the input agrees, which is one fast comparison of memory. So moved vertices, interleaved geometries and
several threads always get their own hits.

`Arrays` deals with the place of the arrays (on the host, on a GPU).
"""

import contextlib
import itertools
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Bitwise equality."""
    return a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a.view(np.int32), b.view(np.int32))


@runtime_checkable
class Arrays(Protocol):
    """How a cache compares and copies arrays, and when it may change structures that were built from them."""

    def agree(self, kept: Sequence[Any], given: Sequence[Any]) -> Iterator[bool]:
        """Whether arrays are equal bit by bit, pair by pair."""
        ...

    def copies(self, given: Sequence[Any]) -> list[Any]:
        """Copies that no other code writes to."""
        ...

    def changes(self) -> contextlib.AbstractContextManager:
        """A context in which structures are built, refitted and dropped.

        Inside it no structure is in use. After it all are ready.
        """
        ...


class HostArrays:
    """NumPy arrays, and structures that are not in use when the cache's lock is free."""

    def agree(self, kept: Sequence[np.ndarray], given: Sequence[np.ndarray]) -> Iterator[bool]:
        """Whether arrays are equal bit by bit, lazily: only pairs that the caller asks for are compared."""
        return (_same(a, b) for a, b in zip(kept, given, strict=True))

    def copies(self, given: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Copies that no other code writes to."""
        return [np.array(a) for a in given]

    def changes(self) -> contextlib.AbstractContextManager:
        """An empty context: there is nothing to wait for."""
        return contextlib.nullcontext()


class _Entry:
    def __init__(self, topology, moving, structure):
        self.topology = topology
        self.moving = moving
        self.structure = structure
        self.refits = 0


class BVHCache:
    """Least recently used acceleration structures.

    `build(moving, topology)` makes a structure. `refit(structure, moving)` adapts it in place if only the `moving`
    arrays have changed. After `max_refits` it is built anew, since refitting keeps the tree of the old shape. Callers
    hold `lock` from `find` to the end of the launch. Together with `Arrays.changes` this ensures that no structure in
    use is refitted.
    """

    def __init__(
        self,
        build: Callable,
        refit: Callable,
        arrays: Arrays | None = None,
        capacity: int = 12,
        per_topology: int = 3,
        max_refits: int = 16,
    ):
        self.build = build
        self.refit = refit
        self.arrays = arrays or HostArrays()
        self.capacity = capacity
        self.per_topology = per_topology
        self.max_refits = max_refits
        self.lock = threading.RLock()
        self.entries: list[_Entry] = []  # most recently used last

    def find(self, moving: Sequence[Any], topology: Sequence[Any]) -> Any:
        """The structure of exactly these arrays; call with `lock` held."""
        entry, kin = self._search(moving, topology)
        if entry is None:
            with self.arrays.changes():
                entry = self._entry(kin, moving, topology)
        else:
            self.entries.remove(entry)
        self.entries.append(entry)
        return entry.structure

    def _search(self, moving, topology) -> tuple[_Entry | None, list[_Entry]]:
        """(the entry of these arrays if there is one, entries of the same topology, the most recently used first)."""
        kin = []
        for entry in reversed(self.entries):
            agree = self.arrays.agree([*entry.topology, *entry.moving], [*topology, *moving])
            if all(itertools.islice(agree, len(topology))):
                if all(agree):
                    return entry, kin
                kin.append(entry)
        return None, kin

    def _entry(self, kin: list[_Entry], moving, topology) -> _Entry:
        """An entry for new content: the oldest of its `kin`, refitted, if there are enough of them; else a new one."""
        if len(kin) >= self.per_topology:
            oldest = kin[-1]
            self.entries.remove(oldest)  # first of all: if the refit fails, the structure no longer fits its arrays
            if oldest.refits < self.max_refits and all(
                a.shape == b.shape for a, b in zip(oldest.moving, moving, strict=True)
            ):
                oldest.moving = self.arrays.copies(moving)
                self.refit(oldest.structure, oldest.moving)
                oldest.refits += 1
                return oldest
            del oldest, kin[:]  # the last references: the structure is dropped here, where it is not in use
        elif len(self.entries) >= self.capacity:
            del self.entries[0]
        moving, topology = self.arrays.copies(moving), self.arrays.copies(topology)
        return _Entry(topology, moving, self.build(moving, topology))
