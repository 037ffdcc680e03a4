"""The measurements of one scene: references, compile times, calls in turns, memory, and terms."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxdr.chart import reference as references
from jaxdr.chart.config import ChartConfig, ChartScene, Stored
from jaxdr.chart.folder import Cell, ChartFolder
from jaxdr.chart.measure import Line, in_fresh_process, make_line, peak_memory, predicted
from jaxdr.chart.peers import GUIDING, PeerLine
from jaxdr.chart.scenes import Case
from jaxdr.chart.statistics import mean_and_noise, positions
from jaxdr.optimize.progress import Interrupted, Interruption, NotFinite, Progress

# Streams of random numbers, all from the seed.
REFERENCE, RESIDUAL, VERTICES, CALLS, TERMS = range(5)
Call = Callable[[int, int], dict[str, Any]]  # (number of the key, number among all calls) -> arrays and seconds


class SceneRun:
    """One scene of a chart. Every array and time is written to the folder as soon as it is known."""

    def __init__(self, config: ChartConfig, scene: ChartScene, case: Case, folder: ChartFolder, stop: Interruption):
        self.config, self.scene, self.case, self.folder, self.stop = config, scene, case, folder, stop
        self.key = jax.random.key(config.seed)
        self.positions = positions(scene.reference.step, config.positions)
        self.programs: dict[Cell, Call] = {}  # compiled for the first call, and used again for the others
        self.lines = [estimator.name for estimator in config.estimators] + (list(GUIDING) if config.peers else [])

    def cells(self) -> list[Cell]:
        """All cells of the scene, line by line, with rising samples."""
        own = [estimator.samples or self.config.samples for estimator in self.config.estimators]
        ladders = own + [self.config.peer_samples or self.config.samples] * (len(self.lines) - len(own))
        return [Cell(self.scene.name, i, spp) for i, ladder in enumerate(ladders) for spp in ladder]

    def measure(self) -> None:
        """Measure what the folder lacks. Raises `Interrupted`, and `NotFinite` for a reference that is not finite."""
        self.image, self.vertices, self.residual, self.agreement = self._references()
        cells = self.cells()
        for line in range(len(self.lines)):
            self._prepare([cell for cell in cells if cell.line == line])
        self._calls(self.measured())
        if self.config.memory:
            self._memory()
        if self.config.terms:
            self._terms()

    def measured(self) -> list[Cell]:
        """The cells within the budget that no estimator refused."""
        return [cell for cell in self.cells() if self.folder.status(cell.file)["status"] == "ok"]

    def _references(self):
        name, config = self.scene.name, self.config
        if isinstance(self.scene.reference, Stored):
            image = references.stored_reference(self.scene, self.case)
        else:
            difference = references.difference_batches(self.scene, self.case, self._key(REFERENCE))
            count = self.scene.reference.batches
            image = mean_and_noise(self._batches(f"{name}/image", f"{name}: reference", count, difference))
        if not np.isfinite(image[0]).all():
            raise NotFinite(f"scene {name}: the reference is not finite")
        if config.vertices is None:
            return image, None, None, None
        options = config.vertices
        residual = self.folder.kept(
            f"{name}/residual",
            lambda: references.residual(options, self.scene, self.case, self._key(RESIDUAL)),
        )
        estimator = next(e for e in config.estimators if e.name == options.reference)
        line = make_line(self.scene, estimator, self.case, residual)
        batches = None

        def batch(number):
            nonlocal batches
            batches = batches or references.vertex_batches(line, options, self._key(VERTICES))
            return batches(number)

        try:
            gradients = self._batches(f"{name}/vertices", f"{name}: vertices", options.batches, batch)
        except ValueError as problem:
            raise ValueError(f"scene {name}: vertices.reference: {problem}") from None
        if not np.isfinite(gradients).all():
            raise NotFinite(f"scene {name}: the reference of the gradient by vertices is not finite")
        agreement = references.agreement(residual, *image, gradients, references.velocity(self.case))
        return image, mean_and_noise(gradients), residual, agreement

    def _batches(self, name: str, what: str, count: int, batch: Callable[[int], np.ndarray]) -> np.ndarray:
        found = []
        with Progress(what, count) as progress:
            for number in range(count):
                self._check_stop()
                found.append(self.folder.kept(f"{name}_{number}", lambda number=number: batch(number)))
                progress.step()
        return np.stack(found)

    def _prepare(self, ladder: list[Cell]) -> None:
        """Find the status of the cells of a line. From few samples to many, each is compiled and called.

        This ends where the budget or the estimator's refusal ends it.
        """
        history, refused = [], ""
        with Progress(f"{self.scene.name}: compile {self.lines[ladder[0].line]}", len(ladder)) as progress:
            for cell in ladder:
                self._check_stop()
                status = self.folder.status(cell.file)
                if status is None:
                    status = self.folder.save_status(cell.file, self._first_call(cell, history, refused))
                if status["status"].startswith("refused"):
                    refused = status["status"]
                if status["status"] != "ok":
                    progress.say(f"  {self.lines[cell.line]}, {cell.samples} spp: {status['status']}")
                if "first_seconds" in status:
                    history.append((cell.samples, status["first_seconds"]))
                progress.step()

    def _first_call(self, cell: Cell, history: list[tuple[int, float]], refused: str) -> dict:
        if refused:
            return {"status": refused}
        guess = predicted(history, cell.samples)
        if guess > self.config.budget:
            return {"status": f"over budget: about {guess:.2g} s a call"}
        try:
            call, known = self._program(cell)
            call(0, 0)  # the first call is not timed: it is slow for other reasons too
            found = call(1, 1)
        except ValueError as problem:
            return {"status": f"refused: {(str(problem).splitlines() or [''])[0]}"}
        known["first_seconds"] = found["seconds"]
        over = found["seconds"] > self.config.budget
        if not over:
            self.programs[cell] = call
        return known | {"status": f"over budget: {found['seconds']:.2g} s a call" if over else "ok"}

    def _program(self, cell: Cell) -> tuple[Call, dict]:
        """(call of a cell, seconds and bytes of its compilation)."""
        if cell.line >= len(self.config.estimators):
            return self._peer_program(cell)
        line = self._line(cell.line)
        image = line.image(cell.samples)
        known = {"compile_seconds": image.compile_seconds, "program_bytes": image.program_bytes}
        vertices = None
        if self.residual is not None:
            vertices = line.vertices(cell.samples)
            known["vertex_compile_seconds"] = vertices.compile_seconds

        def call(number: int, order: int) -> dict:
            key = jax.random.fold_in(self._key(CALLS), number)
            found, seconds = line.timed(image, self._position(number), order, key)
            answer = {"image": found, "seconds": seconds}
            if vertices is not None:
                answer["vertices"], answer["vertex_seconds"] = line.timed(vertices, 0.0, order, key)
            return answer

        return call, known

    def _peer_program(self, cell: Cell) -> tuple[Call, dict]:
        line = PeerLine(self.scene, self.lines[cell.line])
        first = line.timed(cell.samples, 0.0, self.config.seed)[1]
        second = line.timed(cell.samples, 0.0, self.config.seed + 1)[1]

        def call(number: int, order: int) -> dict:
            image, seconds = line.timed(cell.samples, self._position(number), self.config.seed + 1 + number)
            return {"image": image, "seconds": seconds}

        return call, {"compile_seconds": max(first - second, 0.0)}

    def _calls(self, cells: list[Cell]) -> None:
        """Call all cells in turns, so that noise of the machine hits all. Each round begins with another cell."""
        keys = range(self.config.keys)
        missing = {cell for cell in cells if not all(self.folder.has_call(cell, k) for k in keys)}
        if not missing:
            return
        for cell in missing - self.programs.keys():
            self._check_stop()
            self.programs[cell] = self._program(cell)[0]
            self.programs[cell](0, 0)
        total = len(cells) * len(keys)
        done = sum(self.folder.has_call(cell, k) for cell in cells for k in keys)
        with Progress(f"{self.scene.name}: calls", total, done) as progress:
            for k in keys:
                for i in range(len(cells)):
                    cell = cells[(i + k) % len(cells)]
                    if self.folder.has_call(cell, k):
                        continue
                    self._check_stop()
                    found = self.programs[cell](k, k * len(cells) + i)
                    self.folder.save_call(cell, k, found)
                    progress.step(seconds=found["seconds"])
        self.programs.clear()

    def _memory(self) -> None:
        """Measure the memory of every estimator, at the largest number of samples that it was measured with."""
        for line, estimator in enumerate(self.config.estimators):
            counts = [cell.samples for cell in self.measured() if cell.line == line]
            name = f"{self.scene.name}/{line:02d}_memory"
            if not counts or self.folder.status(name) is not None:
                continue
            self._check_stop()
            found = in_fresh_process(peak_memory, self.scene, estimator, max(counts))
            self.folder.save_status(name, found | {"samples": max(counts)})

    def _terms(self) -> None:
        """Call `derivative_terms` for every line that has a measured cell."""
        for i in range(len(self.config.estimators)):
            cell = self.term_cell(i)
            keys = range(self.config.keys)
            if not any(other.line == i for other in self.measured()):
                continue
            if all(self.folder.has_call(cell, k, "terms") for k in keys):
                continue
            line = self._line(i)
            program = line.terms(cell.samples)
            with Progress(f"{self.scene.name}: terms of {self.lines[i]}", len(keys)) as progress:
                for k in keys:
                    self._check_stop()
                    if not self.folder.has_call(cell, k, "terms"):
                        found = line.timed(program, 0.0, k, jax.random.fold_in(self._key(TERMS), k))[0]
                        self.folder.save_call(cell, k, found, "terms")
                    progress.step()

    def term_cell(self, line: int) -> Cell:
        """The cell under which the terms of a line are kept."""
        return Cell(self.scene.name, line, self.config.terms)

    def _line(self, number: int) -> Line:
        return make_line(self.scene, self.config.estimators[number], self.case, self.residual)

    def _position(self, number: int) -> float:
        return self.positions[number % len(self.positions)]

    def _key(self, stream: int) -> Array:
        return jax.random.fold_in(self.key, stream)

    def _check_stop(self) -> None:
        if self.stop.requested:
            raise Interrupted(f"stopped in scene {self.scene.name}; what was measured is in {self.folder.path}")


def mean_image(images: Float[np.ndarray, "K H W 3"]) -> Float[np.ndarray, "H W 3"]:
    """Mean over all calls of a cell."""
    return images.astype(np.float64).mean(0)
