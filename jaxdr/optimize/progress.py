"""Progress for people: a bar on a terminal or in a notebook, else lines; and signals that wait for a step's end."""

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from jaxdr.bars import IN_NOTEBOOK, tqdm


class Progress:
    """Reports on `total` steps of which `done` are done: a bar on a terminal, else a line now and then, on stderr.

    In a notebook the bar is the notebook's. With `quiet` it reports nothing.
    """

    def __init__(self, name: str, total: int, done: int = 0, seconds: float = 10.0, quiet: bool = False):
        self.name, self.total, self.done, self.seconds, self.quiet = name, total, done, seconds, quiet
        self.first = done
        self.bar = None
        if (IN_NOTEBOOK or sys.stderr.isatty()) and not quiet:
            self.bar = tqdm(total=total, initial=done, desc=name, file=sys.stderr, dynamic_ncols=True)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *problem) -> None:
        if self.bar is not None:
            self.bar.close()

    def step(self, **values: float) -> None:
        """One more step is done; `values` are shown beside the progress."""
        self.done += 1
        if self.quiet:
            return
        if self.bar is not None:
            self.bar.set_postfix({k: f"{v:.4g}" for k, v in values.items()}, refresh=False)
            self.bar.update()
            return
        now = time.monotonic()
        if self.done == self.first + 1:
            # The first step compiles: it shows that things move, and says nothing about the time left.
            self.start = self.last_line = now
            left = ""
        elif now - self.last_line >= self.seconds or self.done == self.total:
            self.last_line = now
            per_step = (now - self.start) / (self.done - self.first - 1)
            left = f"  {_clock(per_step * (self.total - self.done))} left"
        else:
            return
        shown = "".join(f"  {k} {v:.4g}" for k, v in values.items())
        print(f"{self.name} {self.done}/{self.total}{shown}{left}", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """A line of text that doesn't break the bar."""
        if self.bar is not None:
            self.bar.write(text, file=sys.stderr)
        else:
            print(text, file=sys.stderr, flush=True)


class Interrupted(Exception):
    """Ctrl-C or SIGTERM stopped a run; the message says where its checkpoint is."""


class Stopped(OSError):
    """A file of a run could not be written or read; the message says which, why, and what is left of the run."""


class NotFinite(ArithmeticError):
    """An image, loss or gradient was NaN or infinite; the message names step, view and checkpoint."""


class Interruption:
    """Whether Ctrl-C was pressed, or SIGTERM came."""

    requested: bool = False


@contextmanager
def deferred_interrupt() -> Iterator[Interruption]:
    """Inside the block the first Ctrl-C or SIGTERM only sets `requested`; a second one raises KeyboardInterrupt.

    SIGTERM is what schedulers send before they kill. Outside the main thread, where Python delivers no signals, nothing
    changes; neither does a signal that is ignored, as SIGINT is in a background job of a shell.
    """
    interruption = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if interruption.requested:
            raise KeyboardInterrupt
        interruption.requested = True
        what = "Ctrl-C again" if number == signal.SIGINT else "a second signal"
        print(f"\nfinishing the current step; {what} stops at once", file=sys.stderr, flush=True)

    deferred = [number for number in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(number) != signal.SIG_IGN]
    previous = {number: signal.signal(number, handle) for number in deferred}
    try:
        yield interruption
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}"
