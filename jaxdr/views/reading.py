"""Reads many pictures in little memory. As many as fit are kept; others are read ahead by a few threads."""

import os
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

THREADS = min(4, os.cpu_count() or 1)
AHEAD = 4  # most pictures that are read before they are needed

T = TypeVar("T")
S = TypeVar("S")


class Kept:
    """A cache of arrays, or of tuples of arrays, by key: as many as fit into `limit` bytes. Threads may share it.

    The first ones stay. Pictures are used in rounds over all of them, so the least recently used picture is needed
    next. A cache that drops it would never have the right one.

    Copies share the cache. A pickle of it is empty: another process reads what it needs.
    """

    def __init__(self, limit: int):
        self.limit, self.bytes = limit, 0
        self._values: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def __reduce__(self):
        return Kept, (self.limit,)

    def __copy__(self) -> "Kept":
        return self

    def __deepcopy__(self, memo: dict) -> "Kept":
        return self

    def __contains__(self, key: Hashable) -> bool:
        return key in self._values

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key: the kept one, or what `make` returns, which is kept if it fits."""
        with self._lock:
            if key in self._values:
                return self._values[key]
        value = make()
        with self._lock:
            size = _bytes(value)
            if key not in self._values and self.bytes + size <= self.limit:
                self._values[key], self.bytes = value, self.bytes + size
        return value

    def clear(self) -> None:
        """Forget all values."""
        with self._lock:
            self._values, self.bytes = {}, 0


def read_ahead(make: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """`make` of every item, in order. A few threads make them, and only a few before they are needed."""
    waiting: deque = deque()
    pool = ThreadPoolExecutor(THREADS, "jaxdr read")
    try:
        for item in items:
            waiting.append(pool.submit(make, item))
            if len(waiting) >= AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _bytes(value: Any) -> int:
    if isinstance(value, tuple):
        return sum(_bytes(part) for part in value)
    return value.nbytes if isinstance(value, np.ndarray) else 0
