"""Signs of life: what was begun last and is not done is asked once a second to show that it goes on."""

import os
import shutil
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from jaxdr.argument_kinds import checked

PERIOD = 1.0  # seconds
PATIENCE = 5.0  # seconds of silence before a line, where there is no terminal; then twice as long, each time
MOST_PATIENCE = 60.0


class Shown(ABC):
    """Something that takes long, and is shown to people."""

    @abstractmethod
    def beat(self) -> None:
        """Show that it goes on. Called by another thread."""


_shown: list[Shown] = []
_lock = threading.Lock()
_stop: threading.Event | None = None


@contextmanager
def beating(shown: Shown) -> Iterator[None]:
    """Inside the block, `shown` is asked once a second, unless something in it is shown that began later."""
    global _stop
    with _lock:
        _shown.append(shown)
        if _stop is None:
            _stop = threading.Event()
            threading.Thread(target=_beat, args=(_stop,), name="jaxdr heartbeat", daemon=True).start()
    try:
        yield
    finally:
        with _lock:
            if shown in _shown:
                _shown.remove(shown)
            if not _shown and _stop is not None:
                _stop.set()
                _stop = None


def _beat(stop: threading.Event) -> None:
    while not stop.wait(PERIOD):
        with _lock, suppress(Exception):  # such as a terminal that is gone: the work itself goes on
            if _shown and not stop.is_set():
                _shown[-1].beat()


def _forget() -> None:
    """In a child process: its parent's thread is not there, and may have held the lock."""
    global _lock, _stop
    _lock, _stop = threading.Lock(), None
    _shown.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)


class Pauses:
    """When a line is due where there is no terminal: after some seconds of silence, then after twice as many."""

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Something was printed that is news."""
        self.since = self.last = time.monotonic()
        self.patience = PATIENCE

    def due(self) -> bool:
        """Whether the silence was long enough; if so, another one begins."""
        now = time.monotonic()
        if now - self.last < self.patience:
            return False
        self.last, self.patience = now, min(2 * self.patience, MOST_PATIENCE)
        return True

    def seconds(self) -> float:
        """Since the last news."""
        return time.monotonic() - self.since


class _Working(Shown):
    def __init__(self, text: str):
        self.text, self.pauses, self.width = text, Pauses(), 0

    def beat(self) -> None:
        line = f"{self.text} ({clock(self.pauses.seconds())})"
        if sys.stderr.isatty():
            line = line[1 - shutil.get_terminal_size().columns :]  # a line that wraps can't be written over
            print(f"\r{line}", end="", file=sys.stderr, flush=True)
            self.width = len(line)
        elif self.pauses.due():
            print(line, file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the line off the terminal."""
        if self.width:
            print(f"\r{' ' * self.width}\r", end="", file=sys.stderr, flush=True)
            self.width = 0


def clear_line() -> None:
    """Take what `working` shows off the terminal, before something else is shown."""
    with _lock:
        _clear()


def _clear() -> None:
    if _shown and isinstance(_shown[-1], _Working):
        _shown[-1].clear()


def say(text: str) -> None:
    """A line for people, where there is no progress bar; what `working` shows comes back below it."""
    with _lock:
        _clear()
        print(text, file=sys.stderr, flush=True)


@checked
@contextmanager
def working(text: str) -> Iterator[None]:
    """Inside the block a line on stderr says what goes on, and for how long: on a terminal from the first second on.

    Elsewhere it is printed after a few seconds, and then less and less often. For scripts, while they compile:
    `with jaxdr.working("compiling"): gradient(x, key)`. Raises ValueError for a text that is no string.
    """
    shown = _Working(text)
    clear_line()
    with beating(shown):
        try:
            yield
        finally:
            with _lock:
                shown.clear()


def clock(seconds: float) -> str:
    """Minutes and seconds, with hours where there are any."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
