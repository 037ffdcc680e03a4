"""Reading many pictures in little memory: as many as fit are kept, others are read ahead by a few threads."""

import os
import threading
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np

THREADS = min(4, os.cpu_count() or 1)
AHEAD = 4  # pictures that are read, or being read, before they are asked for

T = TypeVar("T")
S = TypeVar("S")


class Kept:
    """Arrays, or tuples of them, by key: as many as fit into `limit` bytes, for several threads.

    The first ones stay. Pictures are asked for in rounds over all of them: what was used last is needed last again, so
    to let the oldest go would keep nothing that is of use.
    """

    def __init__(self, limit: int):
        self.limit, self.bytes = limit, 0
        self._values: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

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
        """Keep nothing any more of what is here."""
        with self._lock:
            self._values, self.bytes = {}, 0


def read_ahead(make: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """`make` of every item, in order, by a few threads, never more than a few of them before they are asked for."""
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
