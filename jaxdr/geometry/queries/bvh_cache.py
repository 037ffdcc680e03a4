"""Acceleration structures kept between calls, found by the *content* of the arrays they were built from.

A ray query is a pure function of its arrays. Building a BVH for every call would be slow, so built ones are kept and
reused when every byte of the input agrees (one memory comparison, a few ms at a million triangles). Moved vertices,
interleaved geometries and several threads therefore get their own hits by construction.
"""

import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    """Bitwise equality."""
    return a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a.view(np.int32), b.view(np.int32))


class _Entry:
    def __init__(self, topology, moving, structure):
        self.topology = topology
        self.moving = moving
        self.structure = structure
        self.refits = 0


class BVHCache:
    """Least recently used acceleration structures.

    `build(moving, topology)` makes one; `refit(structure, moving)` adapts one in place when only the `moving` arrays
    changed. A structure is rebuilt after `max_refits`, since refitting keeps the tree of the old shape. Callers hold
    `lock` from `find` to the end of the launch: a structure in use is never refitted.
    """

    def __init__(
        self, build: Callable, refit: Callable, capacity: int = 12, per_topology: int = 3, max_refits: int = 16
    ):
        self.build = build
        self.refit = refit
        self.capacity = capacity
        self.per_topology = per_topology
        self.max_refits = max_refits
        self.lock = threading.RLock()
        self.entries: list[_Entry] = []  # most recently used last

    def find(self, moving: Sequence[np.ndarray], topology: Sequence[np.ndarray]) -> Any:
        """The structure of exactly these arrays; call with `lock` held."""
        kin = []
        for entry in reversed(self.entries):
            if all(map(_same, entry.topology, topology)):
                if all(map(_same, entry.moving, moving)):
                    self._touch(entry)
                    return entry.structure
                kin.append(entry)
        if len(kin) >= self.per_topology:
            oldest = kin[-1]
            if oldest.refits < self.max_refits and all(
                a.shape == b.shape for a, b in zip(oldest.moving, moving, strict=True)
            ):
                oldest.moving = [np.array(a) for a in moving]
                self.refit(oldest.structure, oldest.moving)
                oldest.refits += 1
                self._touch(oldest)
                return oldest.structure
            self.entries.remove(oldest)
        elif len(self.entries) >= self.capacity:
            del self.entries[0]
        moving = [np.array(a) for a in moving]
        topology = [np.array(a) for a in topology]
        entry = _Entry(topology, moving, self.build(moving, topology))
        self.entries.append(entry)
        return entry.structure

    def _touch(self, entry: _Entry) -> None:
        self.entries.remove(entry)
        self.entries.append(entry)
