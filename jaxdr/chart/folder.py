"""The folder of a chart. Every call has a file of its own, so that an interrupted chart can go on."""

import glob
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxdr.atomic_file import atomic_path
from jaxdr.chart.config import ChartConfig
from jaxdr.optimize.results_folder import MARKER, Results, files_of, results_folder
from jaxdr.untrusted import array_of, arrays_of, json_text, read_json

KEPT = {"references": "npy", "cells": "json", "calls": "npz", "terms": "npz"}  # folders, and their kind of files


class Cell(NamedTuple):
    """A point of a chart: the name of the scene, the number of the line, and the samples per pixel."""

    scene: str
    line: int
    samples: int

    @property
    def file(self) -> str:
        """The beginning of the names of its files."""
        return f"{self.scene}/{self.line:02d}_{self.samples}"


class ChartFolder:
    """Names and formats of what a chart writes.

    While it runs it writes `references/` (batches), `cells/` (status, seconds to compile, memory), `calls/` and
    `terms/` (arrays and seconds of single calls). Results are `rows.csv`, `terms.csv`, a picture of each scene,
    `index.html` and `summary.json`.
    """

    def __init__(self, config: ChartConfig):
        self.path = Path(config.output)
        self.config = config

    def opened(self, resume: bool, overwrite: bool) -> AbstractContextManager[None]:
        """Inside the block the folder is this chart's alone. Raises ValueError as `results_folder` does."""
        free = ("output", "folder", "until")  # where files are, and what pictures show
        scenes = [glob.escape(scene.name) for scene in self.config.scenes]
        writes = ("rows.csv", "terms.csv", "index.html", "summary.json", "references/*.npy")
        inside = [f"{kind}/{name}/*.{end}" for kind, end in KEPT.items() for name in scenes]
        pictures = [picture for name in scenes for picture in (f"{name}.png", f"{name}_*.png")]
        inputs = files_of(self.config)
        results = Results(
            self.path, "chart", self.config, "chart.json", free, (MARKER, *writes, *inside, *pictures), inputs
        )
        return results_folder(results, resume, overwrite)

    def kept(self, name: str, make: Callable[[], np.ndarray]) -> np.ndarray:
        """The array in `references/`; `make` makes it if there is no file. Raises ValueError for a damaged file."""
        path = self._file("references", f"{name}.npy")
        if not path.exists():
            array = make()
            with atomic_path(path) as temporary:
                np.save(temporary, array)
        try:
            return array_of(path, str(path))
        except ValueError as problem:
            raise ValueError(f"{problem}; delete it and --resume") from None

    def status(self, name: str) -> dict | None:
        """What is known about a cell; None if nothing is."""
        path = self._file("cells", f"{name}.json")
        if not path.exists():
            return None
        found = read_json(path)
        if not isinstance(found, dict) or not isinstance(found.get("status", ""), str):
            raise ValueError(f"{path}: is damaged; delete it and --resume")
        return found

    def save_status(self, name: str, values: dict) -> dict:
        """Write what is known about a cell, and return it."""
        with atomic_path(self._file("cells", f"{name}.json")) as temporary:
            temporary.write_text(json_text(values))
        return values

    def has_call(self, cell: Cell, number: int, kind: str = "calls") -> bool:
        """Whether a call was made and kept."""
        return self._file(kind, f"{cell.file}_{number}.npz").exists()

    def save_call(self, cell: Cell, number: int, values: dict[str, Any], kind: str = "calls") -> None:
        """Write arrays and seconds of a call."""
        with atomic_path(self._file(kind, f"{cell.file}_{number}.npz")) as temporary:
            np.savez(temporary, allow_pickle=False, **values)

    def calls(self, cell: Cell, count: int, kind: str = "calls") -> dict[str, np.ndarray]:
        """Arrays of the calls 0 … count - 1 of a cell, stacked. Raises ValueError for damaged files."""
        found = []
        for number in range(count):
            path = self._file(kind, f"{cell.file}_{number}.npz")
            try:
                found.append(arrays_of(path, str(path)))
            except (OSError, ValueError) as problem:
                raise ValueError(f"{problem}; delete it and --resume") from None
        return {name: np.stack([values[name] for values in found]) for name in found[0]}

    def write_text(self, name: str, text: str) -> None:
        """Write a result that is text."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def write_bytes(self, name: str, content: bytes) -> None:
        """Write a result that is a picture."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_bytes(content)

    def _file(self, kind: str, name: str) -> Path:
        path = self.path / kind / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
