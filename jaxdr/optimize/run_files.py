"""What the folders of all runs have, and what is said when a file in one can't be written."""

import copy
import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxtyping import PyTree

from jaxdr.atomic_file import CannotWrite, append_text, atomic_path
from jaxdr.optimize.checkpoint import Checkpoint, Owner, Place, load_checkpoint, save_checkpoint
from jaxdr.optimize.progress import Stopped
from jaxdr.optimize.results_folder import MARKER, Results, files_of, results_folder, settled
from jaxdr.untrusted import json_text, reason
from jaxdr.view.write import write_page
from jaxdr.views.pictures import CannotRead

AGAIN = "start again with --overwrite"
PAGE = "report.html"
STEP_PICTURES = "pictures/[0-9][0-9][0-9][0-9][0-9]*.png"


class RunFiles:
    """A folder with `jaxdr.json` (the marker), `config.json`, `metrics.csv` (a line a step), and `checkpoint.npz`.

    In the end it has `metrics.json`, and whenever the run stops `report.html`.

    - `kind`: of run, in words; `free`: fields of the config that may differ where a run goes on, for they do not
      change the result.
    - `columns`: of `metrics.csv`; the first is the number of steps done. `subfolders`: made at the start.
    - `results`: patterns of the further files that runs of this kind write. `--overwrite` deletes these.
    """

    kind = "run"
    free: Sequence[str] = ("output", "report")
    subfolders: Sequence[str] = ()
    results: Sequence[str] = ()

    def __init__(self, config: Any, columns: Sequence[str]):
        self.path, self.config, self.columns = Path(config.output), config, tuple(columns)

    def at(self, path: Path) -> "RunFiles":
        """The same files in another folder."""
        there = copy.copy(self)
        there.path = path
        return there

    @property
    def checkpoint(self) -> Path:
        """Where the checkpoint is."""
        return self.path / "checkpoint.npz"

    @property
    def owner(self) -> Owner:
        """The run that the checkpoint belongs to."""
        return Owner(self.kind, settled(self.config, self.free))

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return (self.path / "metrics.json").exists()

    @property
    def inputs(self) -> Mapping[str, Path]:
        """The files and folders that the run reads. A run goes on only if the files have the same contents."""
        return files_of(self.config)

    @contextmanager
    def opened(self, resume: bool, overwrite: bool) -> Iterator[None]:
        """Inside the block the folder is this run's alone; raises ValueError, see `results_folder`."""
        writes = (MARKER, "metrics.csv", "metrics.json", "checkpoint.npz", PAGE, *self.results)
        results = Results(self.path, self.kind, self.config, "config.json", self.free, writes, self.inputs)
        with results_folder(results, resume, overwrite):
            for name in self.subfolders:
                (self.path / name).mkdir(exist_ok=True)
            yield

    def save_checkpoint(self, place: Place, state: PyTree) -> None:
        """Replace the checkpoint; see `jaxdr.optimize.checkpoint`."""
        save_checkpoint(self.checkpoint, self.owner, place, state)

    def load_checkpoint(self) -> Checkpoint | None:
        """The last checkpoint; None where the run was stopped before its first step.

        Raises ValueError where the run is finished, where steps are done and the checkpoint is missing, and as
        `jaxdr.optimize.checkpoint.load_checkpoint` does.
        """
        if self.finished:
            raise ValueError(f"output {self.path}: this run is finished; there is nothing to resume")
        if not self.checkpoint.exists():
            if done := len(self._lines()):
                raise ValueError(
                    f"{self.checkpoint}: there is no checkpoint to resume from, though {done} steps are done; put it "
                    f"back, or {AGAIN}"
                )
            return None
        return load_checkpoint(self.checkpoint, self.owner)

    def start_metrics(self, done: int) -> None:
        """Begin `metrics.csv`, or drop the lines of steps from `done` on, which will be done again."""
        kept = [line for line in self._lines() if int(line.partition(",")[0]) <= done] if done > 0 else []
        self.write_text("metrics.csv", "\n".join([",".join(self.columns), *kept]) + "\n")

    def add_metrics(self, row: dict) -> None:
        """Append a line to `metrics.csv`; columns without a value stay empty. Raises `CannotWrite`."""
        line = io.StringIO()
        csv.DictWriter(line, self.columns, lineterminator="\n").writerow(row)
        append_text(self.path / "metrics.csv", line.getvalue())

    def save_summary(self, summary: dict) -> None:
        """Write `metrics.json`; numbers that are not finite become null."""
        self.write_text("metrics.json", json_text(summary))

    def save_page(self, say: Callable[[str], None]) -> None:
        """Write `report.html`, the page of `jaxdr view`. If something can't be shown, a line says so."""
        try:
            write_page(self.path, self.path / PAGE)
        except ValueError as problem:
            say(f"{self.path / PAGE}: is not written ({problem})")

    def write_text(self, name: str, text: str) -> None:
        """A file of text that appears complete or not at all."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def _lines(self) -> list[str]:
        """Whole lines of `metrics.csv`; a full disk or a killed process may have left a part of the last one."""
        try:
            text = (self.path / "metrics.csv").read_text(encoding="utf-8")
        except FileNotFoundError:
            return []
        except UnicodeDecodeError as problem:
            raise ValueError(f"{self.path / 'metrics.csv'}: is damaged ({reason(problem)}); {AGAIN}") from None
        whole = text[: text.rfind("\n") + 1].splitlines()[1:]
        return [line for line in whole if line.count(",") == len(self.columns) - 1 and line.partition(",")[0].isdigit()]


def shown_if_possible(done: int, save: Callable[[], None], say: Callable[[str], None]) -> None:
    """Save what only shows how a run is doing. If it can't be written, a line says so and the run goes on.

    Checkpoints, metrics and results are not saved this way: without them there would be nothing to go on from.
    """
    try:
        save()
    except CannotWrite as problem:
        say(f"after step {done}: {problem}; it only shows the progress, so the run goes on without it")


@contextmanager
def faults_told(folder: RunFiles) -> Iterator[None]:
    """Inside the block a file that can't be written or read ends the run with `Stopped`: which, where, what is left."""
    try:
        yield
    except (CannotWrite, CannotRead) as problem:
        raise Stopped(f"{problem}; {_left(folder)}") from problem


def _left(folder: RunFiles) -> str:
    """Words for what is left of a run whose disk is full or gone."""
    try:
        if not folder.path.is_dir():
            gone = f"the folder {folder.path} is gone, and its checkpoint with it"
            return f"{gone} (a copy of it, or a new start, is all that is left)"
        if not folder.checkpoint.exists():
            return "there is no checkpoint yet; a run that is resumed begins again"
        step = load_checkpoint(folder.checkpoint, folder.owner).place.step
    except (OSError, ValueError) as problem:
        return f"the checkpoint can't be read now ({problem})"
    return f"the checkpoint of step {step} in {folder.checkpoint} is whole"
