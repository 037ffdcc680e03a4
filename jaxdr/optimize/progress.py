"""Progress for people: a bar on a terminal or in a notebook, else lines; and signals that wait for a step's end."""

import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from jaxdr.bars import IN_NOTEBOOK, tqdm
from jaxdr.optimize.heartbeat import Pauses, Shown, beating, clear_line, clock

PACES = 20  # steps by which the time left is told


class Progress(Shown):
    """Reports on `total` steps of which `done` are done: a bar on a terminal, else a line now and then, on stderr.

    In a notebook the bar is the notebook's. A bar shows every second that a step goes on. `preparing` says what the
    next step does beside stepping, and such steps don't count for the time that is left. With `quiet` it reports
    nothing.
    """

    def __init__(self, name: str, total: int, done: int = 0, seconds: float = 10.0, quiet: bool = False):
        self.name, self.total, self.done, self.seconds, self.quiet = name, total, done, seconds, quiet
        self.note, self.values, self.bar = "", "", None
        self.paces: deque[float] = deque(maxlen=PACES)
        self.last_line: float | None = None
        self.pauses = Pauses()
        self.start = self.pauses.since

    def __enter__(self) -> "Progress":
        self.context = ExitStack()
        if not self.quiet:
            clear_line()
            if IN_NOTEBOOK or sys.stderr.isatty():
                layout = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}{postfix}]"
                settings = {"initial": self.done, "desc": self.name, "bar_format": layout}
                width = {"dynamic_ncols": True} if _has_width() else {"ncols": 80}
                self.bar = tqdm(total=self.total, file=sys.stderr, **width, **settings)
            self.context.enter_context(beating(self))
        return self

    def __exit__(self, *problem) -> None:
        self.context.close()
        if self.bar is not None:
            self.bar.set_postfix_str(self.values, refresh=False)
            self.bar.close()

    def preparing(self, text: str) -> None:
        """Say what the next step does that takes long, such as compiling."""
        self.note = text

    def beat(self) -> None:
        """Show that the step goes on."""
        if self.bar is not None:
            self._postfix()
            self.bar.refresh()
        elif self.pauses.due():
            what, seconds = self.note or "still at it", clock(self.pauses.seconds())
            print(f"{self.name} {self.done}/{self.total}: {what} ({seconds})", file=sys.stderr, flush=True)

    def step(self, **values: float) -> None:
        """One more step is done; `values` are shown beside the progress."""
        self.done += 1
        if self.quiet:
            return
        now = time.monotonic()
        if not self.note:
            self.paces.append(now - self.start)
        self.start, self.note = now, ""
        if self.bar is not None:
            self.values = ", ".join(f"{name}={value:.4g}" for name, value in values.items())
            self._postfix()
            self.bar.update()
            return
        if self.last_line is not None and now - self.last_line < self.seconds and self.done < self.total:
            return
        self.last_line = now
        self.pauses.restart()
        shown = "".join(f"  {name} {value:.4g}" for name, value in values.items())
        left = self._left()
        print(f"{self.name} {self.done}/{self.total}{shown}{left and f'  {left}'}", file=sys.stderr, flush=True)

    def say(self, text: str) -> None:
        """A line of text that doesn't break the bar."""
        if self.bar is not None:
            self.bar.write(text, file=sys.stderr)
        else:
            print(text, file=sys.stderr, flush=True)

    def _left(self) -> str:
        """How long the remaining steps take, by the last ones that prepared nothing."""
        if not self.paces or self.done == self.total:
            return ""
        return f"{clock(sum(self.paces) / len(self.paces) * (self.total - self.done))} left"

    def _postfix(self) -> None:
        parts = (self._left(), self.note, self.values)
        self.bar.set_postfix_str(", ".join(part for part in parts if part), refresh=False)


def _has_width() -> bool:
    """Whether the terminal says how wide it is: a bar of no width shows nothing."""
    try:
        return IN_NOTEBOOK or os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except (OSError, ValueError):
        return False


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
