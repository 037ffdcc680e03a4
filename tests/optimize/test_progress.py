"""Progress lines, the bar on a terminal, and the deferred Ctrl-C."""

import io
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from jaxdr.optimize import progress
from jaxdr.optimize.progress import Progress, deferred_interrupt

ROOT = Path(__file__).resolve().parents[2]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_lines_where_there_is_no_terminal(monkeypatch, capsys):
    clock = iter([4.0, 11.0, 15.0, 18.0, 24.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with Progress("optimise", 7, done=2) as bar:
        for loss in (0.5, 0.4, 0.3, 0.2, 0.12345):
            bar.step(loss=loss)
        bar.say("done")
    # The first, every ten seconds, the last; time left from the steps after the first, which compiled.
    assert capsys.readouterr().err.splitlines() == [
        "optimise 3/7  loss 0.5",
        "optimise 5/7  loss 0.3  0:11 left",
        "optimise 7/7  loss 0.1235  0:00 left",
        "done",
    ]


def test_bar_on_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    with Progress("optimise", 2) as bar:
        bar.step(loss=0.5)
        bar.step(loss=0.25)
    assert "optimise: 100%" in stream.getvalue()
    assert "2/2" in stream.getvalue() and "loss=0.25" in stream.getvalue()


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
            self.set_postfix = self.update = self.close = lambda *values, **settings: None

    monkeypatch.setattr(progress, "IN_NOTEBOOK", True)
    monkeypatch.setattr(progress, "tqdm", Bar)
    with Progress("optimise", 3, done=1) as bar:
        bar.step(loss=0.5)
    assert made[0]["total"] == 3 and made[0]["initial"] == 1 and capsys.readouterr().err == ""
