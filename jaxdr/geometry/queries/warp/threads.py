"""The threads of the ray queries.

They are daemons and belong to no `concurrent.futures`, whose pools take no work as soon as Python ends. Programs of XLA
that still run go on asking then.
"""

import os
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any

# The cores of this process, which may be fewer than the machine has.
THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Work:
    """Calls of one function, shared by the threads that help."""

    def __init__(self, function: Callable[[Any], Any], arguments: Sequence[Any]):
        self.function, self.arguments = function, arguments
        self.results: list[Any] = [None] * len(arguments)
        self.taken, self.left = 0, len(arguments)
        self.error: BaseException | None = None
        self.lock, self.done = threading.Lock(), threading.Event()

    def help(self) -> None:
        """Take calls until none is left."""
        while True:
            with self.lock:
                number = self.taken
                if number == len(self.arguments):
                    return
                self.taken += 1
            try:
                self.results[number] = self.function(self.arguments[number])
            except BaseException as error:  # the thread that asked raises it
                self.error = error
            with self.lock:
                self.left -= 1
                if self.left == 0:
                    self.done.set()


_asked: queue.SimpleQueue[_Work] = queue.SimpleQueue()
_threads: list[threading.Thread] = []
_starting = threading.Lock()


def _serve() -> None:
    while True:
        _asked.get().help()


def _start(count: int) -> None:
    with _starting:
        while len(_threads) < count:
            thread = threading.Thread(target=_serve, name=f"jaxdr-query_{len(_threads)}", daemon=True)
            thread.start()
            _threads.append(thread)


def run_all(function: Callable[[Any], Any], arguments: Sequence[Any]) -> list[Any]:
    """[function(a) for a in arguments], by as many threads as there are cores. Raises the last error of a call.

    The thread that asks works as well. So it waits for nobody who has not begun.
    """
    work = _Work(function, arguments)
    helpers = min(THREADS, len(arguments)) - 1
    _start(helpers)
    for _ in range(helpers):
        _asked.put(work)
    work.help()
    if arguments:
        work.done.wait()
    if work.error is not None:
        raise work.error
    return work.results
