"""Progress lines, the bar on a terminal, and the deferred Ctrl-C."""

import io
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from jaxdr.optimize import heartbeat, progress
from jaxdr.optimize.heartbeat import working
from jaxdr.optimize.progress import Progress, deferred_interrupt

ROOT = Path(__file__).resolve().parents[2]


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Clock:
    """Time that stands still until it is told to go on."""

    now = 0.0

    def monotonic(self):
        return self.now


@pytest.fixture
def time_of(monkeypatch):
    """A clock that all of the display reads; its thread does not run."""
    clock = Clock()
    for module in (progress, heartbeat):
        monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(heartbeat, "PERIOD", 3600.0)
    return clock


def test_lines_where_there_is_no_terminal(time_of, capsys):
    with Progress("optimise", 7, done=2) as bar:
        bar.preparing("compiling")
        for now, loss in ((50.0, 0.5), (54.0, 0.4), (58.0, 0.3), (62.0, 0.2), (66.0, 0.12345)):
            time_of.now = now
            bar.step(loss=loss)
        bar.say("done")
    # The first, every ten seconds, the last; time left from the steps after the first, which compiled.
    assert capsys.readouterr().err.splitlines() == [
        "optimise 3/7  loss 0.5",
        "optimise 6/7  loss 0.2  0:04 left",
        "optimise 7/7  loss 0.1235",
        "done",
    ]


def test_a_long_step_says_what_it_does_less_and_less_often(time_of, capsys):
    with Progress("optimise", 7) as bar:
        bar.preparing("compiling level 1 of 2")
        for now in range(40):
            time_of.now = float(now)
            bar.beat()
    assert capsys.readouterr().err.splitlines() == [
        f"optimise 0/7: compiling level 1 of 2 (0:{seconds})" for seconds in ("05", "15", "35")
    ]


def test_each_level_compiles_and_the_time_left_is_that_of_its_steps(time_of, capsys):
    with Progress("optimise", 100, seconds=0.0) as bar:
        for _ in range(progress.PACES):
            time_of.now += 1.0
            bar.step()
        bar.preparing("compiling level 2 of 2")
        time_of.now += 60.0
        bar.step()
        for _ in range(progress.PACES):
            time_of.now += 3.0
            bar.step()
    lines = capsys.readouterr().err.splitlines()
    assert lines[19] == "optimise 20/100  1:20 left" and lines[20] == "optimise 21/100  1:19 left"
    assert lines[-1] == "optimise 41/100  2:57 left"


def test_bar_on_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with Progress("optimise", 2) as bar:
        bar.preparing("compiling")
        bar.beat()
        assert "0/2 [00:00, compiling]" in stream.getvalue()
        bar.step(loss=0.5)
        bar.step(loss=0.25)
    assert "optimise: 100%" in stream.getvalue()
    assert "2/2" in stream.getvalue() and "loss=0.25" in stream.getvalue()


def test_what_was_begun_last_shows_that_it_goes_on(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(heartbeat, "PERIOD", 0.01)
    with working("reading"):
        wait_for(lambda: "reading (0:00)" in stream.getvalue())
        with Progress("render", 2):
            wait_for(lambda: stream.getvalue().count("render:") > 3)
            seen = stream.getvalue().count("reading")
            assert "(0:00)\r              \r" in stream.getvalue()  # its line is free
            wait_for(lambda: stream.getvalue().count("render:") > 6)
            assert stream.getvalue().count("reading") == seen
        wait_for(lambda: stream.getvalue().count("reading") > seen)
        heartbeat.say("a line")
    assert f"\r{' ' * len('reading (0:00)')}\ra line\n" in stream.getvalue()  # not behind what was shown
    ended = stream.getvalue()
    time.sleep(0.1)
    assert stream.getvalue() == ended and not heartbeat._shown


def test_an_error_ends_what_is_shown():
    with pytest.raises(ZeroDivisionError), working("dividing"), Progress("divide", 2, quiet=True):
        1 / 0  # noqa: B018
    assert not heartbeat._shown and heartbeat._stop is None


def wait_for(condition) -> None:
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_first_ctrl_c_waits_second_stops(capsys):
    with deferred_interrupt() as interruption:
        assert not interruption.requested
        signal.raise_signal(signal.SIGINT)
        assert interruption.requested
        assert "Ctrl-C again stops at once" in capsys.readouterr().err
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_background_job_keeps_ignoring_ctrl_c():
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with deferred_interrupt() as interruption:
            signal.raise_signal(signal.SIGINT)
            assert not interruption.requested
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, previous)


def test_other_threads_may_use_it():
    seen = []

    def work():
        with deferred_interrupt() as interruption:
            seen.append(interruption.requested)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [False]


IN_A_KERNEL = """
import sys, types, warnings
warnings.simplefilter("error")
for name in ("ipykernel", "ipykernel.zmqshell", "IPython"):
    sys.modules[name] = types.ModuleType(name)
sys.modules["IPython"].get_ipython = lambda: None
sys.modules["ipykernel.zmqshell"].__name__ = "ipykernel.zmqshell"
sys.modules["ipywidgets"] = None  # as where it is not installed
from jaxdr.optimize.progress import IN_NOTEBOOK, Progress
assert not IN_NOTEBOOK
with Progress("optimise", 1) as bar:
    bar.step(loss=0.5)
"""


def test_a_notebook_without_widgets_has_lines_and_no_warning():
    done = subprocess.run([sys.executable, "-c", IN_A_KERNEL], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (done.stdout, done.stderr) == ("", "optimise 1/1  loss 0.5\n")


def test_a_notebook_with_widgets_has_a_bar(monkeypatch, capsys):
    made = []

    class Bar:
        def __init__(self, **settings):
            made.append(settings)
            self.set_postfix_str = self.update = self.refresh = self.close = lambda *values, **settings: None

    monkeypatch.setattr(progress, "IN_NOTEBOOK", True)
    monkeypatch.setattr(progress, "tqdm", Bar)
    with Progress("optimise", 3, done=1) as bar:
        bar.step(loss=0.5)
    assert made[0]["total"] == 3 and made[0]["initial"] == 1 and capsys.readouterr().err == ""
