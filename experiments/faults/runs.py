"""Real runs of `jaxdr optimize` and `jaxdr reconstruct`, each in a process of its own, that can be disturbed."""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from examples.take_photographs import main as take_photographs

OPTIMIZE = """
environment = 0.5
[target]
path = "{input}"
size = 0.9
[initial]
subdivisions = 2
radius = 0.3
[cameras]
views = 3
resolution = 32
[integrator]
max_depth = 2
[samples]
target = 16
image = 4
gradient = 4
pictures = 4
[optimizer]
iterations = 40
views_per_step = 2
[report]
pictures = 10
chamfer = 10
checkpoint = 4
views = 2
"""
RECONSTRUCT = """
[start]
grid = 24
[samples]
image = 4
gradient = 4
pictures = 4
[[levels]]
steps = 12
resolution = 24
vertices = 200
views = 2
sky = 3
[[levels]]
steps = 12
resolution = 32
vertices = 300
views = 2
sky = 5
texture = 64
[report]
checkpoint = 4
pictures = 8
texture = 64
turntable = 2
"""


class Run:
    """A run in `place/run`, with its config and its input beside `place`: `input` is a file that it reads."""

    name, steps, result_file, config_text = "optimize", 40, "meshes/result.glb", OPTIMIZE

    def __init__(self, place: Path, shared: Path):
        place.mkdir()
        self.place, self.output, self.config = place, place / "run", place.parent / f"{place.name}.toml"
        self.input = self.make_input(shared)
        self.config.write_text(self.words().format(input=self.input, output=self.output))
        self.found: dict[str, Any] | None = None

    def make_input(self, shared: Path) -> Path:
        """A file that all runs of this kind read, made once."""
        import jaxdr as jd

        path = shared / "sphere.obj"
        if not path.exists():
            jd.save_mesh(path, jd.shapes.sphere(2))
        return path

    def words(self) -> str:
        """The text of the config."""
        return 'output = "{output}"\n' + self.config_text

    def command(self) -> list[str]:
        """What a user writes, without options."""
        return ["optimize", str(self.config)]

    def start(self, *options: str) -> subprocess.Popen:
        """The process; what it says goes to a file that no full disk can stop."""
        self.said = tempfile.TemporaryFile("w+")
        command = [sys.executable, "-m", "jaxdr", *self.command(), *options]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=self.said)

    def wait_for_step(self, process: subprocess.Popen, step: int) -> None:
        """Until so many steps are recorded."""
        while self.steps_done() < step and process.poll() is None:
            time.sleep(0.02)

    def steps_done(self) -> int:
        """Steps that are recorded."""
        try:
            return max(0, (self.output / "metrics.csv").read_text().count("\n") - 1)
        except OSError:
            return 0

    def end(self, process: subprocess.Popen) -> tuple[int, list[str]]:
        """(exit code, lines that the user sees) when the process has ended.

        A traceback is an error of ours, except one of Ctrl-C, as while Python imports: this one is told.
        """
        code = process.wait(timeout=900)
        self.said.seek(0)
        text = self.said.read()
        tracebacks, interrupted = text.count("Traceback"), len(re.findall("^KeyboardInterrupt", text, re.MULTILINE))
        assert tracebacks == interrupted, text
        if tracebacks:
            print("    a traceback of KeyboardInterrupt")
        return code, [line for line in text.splitlines() if "Warp" not in line and "kept in" not in line]

    def ended(self, process: subprocess.Popen) -> tuple[int, list[str]]:
        """As `end`, and prints it."""
        code, lines = self.end(process)
        print(f"    exit code {code}; the last lines of what it says:")
        for line in lines[-2:]:
            print(f"    | {line}".replace(str(self.place.parent), "PLACE"))
        return code, lines

    def result(self) -> dict[str, Any]:
        """All that must be the same: the arrays of the last checkpoint, the mesh, the metrics without times."""
        with np.load(self.output / "checkpoint.npz") as file:
            arrays = {name: file[name].tobytes() for name in file.files if name not in ("seconds", "config")}
        rows = [line.split(",") for line in (self.output / "metrics.csv").read_text().splitlines()]
        column = rows[0].index("seconds")
        timeless = [row[:column] + row[column + 1 :] for row in rows]
        return arrays | {"rows": timeless, "result": (self.output / self.result_file).read_bytes()}


class Reconstruction(Run):
    """A run of `jaxdr reconstruct`, from photographs of a duck."""

    name, steps, result_file, config_text = "reconstruct", 24, "asset.glb", RECONSTRUCT

    def make_input(self, shared: Path) -> Path:
        """A photograph in a folder of ten."""
        folder = shared / "photographs"
        if not folder.exists():
            take_photographs(str(folder), count=10, pixels=32, samples=16)
        return sorted((folder / "images").iterdir())[2]

    def words(self) -> str:
        """The text of the config; output and photographs are named on the command line."""
        return self.config_text

    def command(self) -> list[str]:
        """What a user writes, without options."""
        photographs = str(self.input.parent.parent)
        return ["reconstruct", photographs, "-o", str(self.output), "--config", str(self.config)]
