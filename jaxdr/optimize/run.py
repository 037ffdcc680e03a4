"""The driver of all runs: begin or go on, step by step with progress, checkpoints and pictures, until the results."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import jax
from jaxtyping import PyTree

from jaxdr.optimize.checkpoint import Checkpoint, Place
from jaxdr.optimize.devices import Device
from jaxdr.optimize.heartbeat import say, working
from jaxdr.optimize.processes import any_process, folder_of_process, told_of_lost_processes
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress, deferred_interrupt
from jaxdr.optimize.run_files import RunFiles, faults_told

State = TypeVar("State")
Say = Callable[[str], None]  # a line for people, which does not break the progress bar


class Task(ABC, Generic[State]):
    """What a kind of run does, for the driver `run`. `State` is all that steps change.

    - `name`: what it is called beside its progress. `steps`: how many there are at most.
    - `config`: has the `seed`, and in `report` how often there are `pictures` and a `checkpoint`.
    - `folder`: knows the kind and what of the config decides the result; see `RunFiles.owner`. `run` opens it. Where
      there are several processes it becomes that of this one.
    - `key`: of the seed; `interruption`: whether somebody wants the run to stop.
    """

    name = "optimise"

    folder: Any

    def __init__(self, config: Any, steps: int, devices: Sequence[Device]):
        self.config, self.steps, self.devices = config, steps, devices
        self.key = jax.random.key(config.seed)
        self.interruption = Interruption()
        self.clock = time.monotonic()

    @abstractmethod
    def begin(self, saved: Checkpoint | None) -> State:
        """The state in a checkpoint, or the state before the first step; also prepares what the steps need."""

    def preparing(self, state: State, done: int) -> str:
        """What the next step does beside stepping, for people, such as compiling another level. By default nothing."""
        del state, done
        return ""

    @abstractmethod
    def step(self, state: State, done: int, say: Say) -> tuple[State, dict]:
        """The state after one more step than `done`, and its row of the metrics. Raises `NotFinite`."""

    @abstractmethod
    def shown(self, state: State, row: dict) -> dict[str, float]:
        """The numbers of a step beside the progress."""

    @abstractmethod
    def saved(self, state: State, done: int) -> tuple[Place, PyTree]:
        """What a checkpoint holds: `begin` goes on from it."""

    @abstractmethod
    def draw(self, state: State, done: int, say: Say) -> None:
        """Write pictures on the way."""

    @abstractmethod
    def finish(self, state: State, done: int) -> dict:
        """Write the results; returns the summary, which is written after them."""

    def after(self, state: State, done: int, row: dict, say: Say) -> State:
        """The state to go on with, once the row of a step is written. By default it stays as it is."""
        del done, row, say
        return state

    def last(self, state: State, done: int) -> bool:
        """Whether no step is left."""
        del state
        return done == self.steps

    def stopped(self, state: State, say: Say) -> None:
        """Write what an interrupted run leaves beside its checkpoint. By default it leaves nothing."""
        del state, say

    def seconds(self) -> float:
        """How long the run took, with the parts before it was resumed."""
        return time.monotonic() - self.clock


def run(task: Task, resume: bool, overwrite: bool) -> dict:
    """Run a task to its end and return the summary that `metrics.json` holds.

    - Raises ValueError for an output folder in use, and for one that can't be resumed.
    - Raises `Interrupted` after Ctrl-C or SIGTERM, and `Stopped` where a file can't be written or read.
    - Raises `NotFinite` rather than go on with NaN, and `ProcessLost`.
    """
    checkpoint = task.folder.checkpoint
    with (
        folder_of_process(task.folder, resume, overwrite) as task.folder,
        deferred_interrupt() as task.interruption,
        faults_told(task.folder),
        told_of_lost_processes(checkpoint),
    ):
        return _steps(task, task.folder)


def _steps(task: Task, folder: RunFiles) -> dict:
    """From the beginning or the checkpoint to the results."""
    saved, report = folder.load_checkpoint(), task.config.report
    done = 0 if saved is None else saved.place.step
    task.clock -= 0.0 if saved is None else saved.place.seconds
    with working(f"{folder.path}: preparing the first step"):
        state = task.begin(saved)
        folder.start_metrics(done)
        if done == 0:
            folder.save_checkpoint(*task.saved(state, 0))  # from here on a run without a checkpoint has lost it
            task.draw(state, 0, say)
    first, last = done, task.last(state, done)
    with Progress(task.name, task.steps, done) as progress:
        while not last:
            progress.preparing(task.preparing(state, done) or ("compiling" if done == first else ""))
            try:
                after, row = task.step(state, done, progress.say)
            except NotFinite as problem:
                folder.save_checkpoint(*task.saved(state, done))
                folder.save_page(progress.say)
                raise NotFinite(f"{problem}; the state before that step is in {folder.checkpoint}") from None
            state, done = after, done + 1
            folder.add_metrics({**row, folder.columns[0]: done, "seconds": round(task.seconds(), 2)})
            progress.step(**task.shown(state, row))
            last = task.last(state, done)
            if not last:
                state = task.after(state, done, row, progress.say)
            if last or done % report.pictures == 0:
                task.draw(state, done, progress.say)
            stop = any_process(task.interruption.requested)
            if last or stop or done % report.checkpoint == 0:
                folder.save_checkpoint(*task.saved(state, done))
            if stop and not last:
                task.stopped(state, progress.say)
                folder.save_page(progress.say)
                raise Interrupted(f"stopped after step {done}; checkpoint in {folder.checkpoint}")
    with working(f"{folder.path}: writing the results"):
        summary = task.finish(state, done)
        folder.save_summary(summary)
        folder.save_page(say)
    return summary
