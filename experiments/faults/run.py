"""What a user sees when a run is killed, told to end, or loses its disk; and whether it goes on with the same bits.

    python -m experiments.faults.run [CASE ...]

Every case is a real `jaxdr optimize` in a process of its own. Full and read-only disks are small file systems in
memory. Only root may mount those; without root these cases are left out, and the report says so.
"""

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np

STEPS = 40
CONFIG = f"""
environment = 0.5
[target]
shape = "sphere"
parameters = {{ subdivisions = 2 }}
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
iterations = {STEPS}
views_per_step = 2
[report]
pictures = 10
chamfer = 10
checkpoint = 4
views = 2
"""


class Run:
    """A run in a folder, with its config beside it."""

    def __init__(self, place: Path):
        self.output, self.config = place / "run", place.parent / f"{place.name}.toml"
        self.config.write_text(f'output = "{self.output}"\n{CONFIG}')

    def start(self, *options: str) -> subprocess.Popen:
        """The process; what it says goes to a file that no full disk can stop."""
        command = [sys.executable, "-m", "jaxdr", "optimize", str(self.config), *options]
        self.said = tempfile.TemporaryFile("w+")
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=self.said)

    def wait_for_step(self, process: subprocess.Popen, step: int) -> None:
        """Until so many steps are recorded."""
        while self.steps() < step and process.poll() is None:
            time.sleep(0.02)

    def steps(self) -> int:
        """Steps that are recorded."""
        try:
            return max(0, (self.output / "metrics.csv").read_text().count("\n") - 1)
        except OSError:
            return 0

    def end(self, process: subprocess.Popen) -> None:
        """Print what the user sees."""
        code = process.wait(timeout=600)
        self.said.seek(0)
        lines = [line for line in self.said.read().splitlines() if "Warp" not in line and "kept in" not in line]
        print(f"    exit code {code}; the last lines of what it says:")
        for line in lines[-2:]:
            print(f"    | {line}")

    def resume(self) -> None:
        """Go on to the end."""
        process = self.start("--resume")
        self.end(process)

    def result(self) -> dict:
        """All that must be the same: the arrays of the last checkpoint, the mesh, the metrics without times."""
        with np.load(self.output / "checkpoint.npz") as file:
            arrays = {name: file[name].tobytes() for name in file.files if name != "seconds"}
        rows = [line.split(",") for line in (self.output / "metrics.csv").read_text().splitlines()]
        column = rows[0].index("seconds")
        timeless = [row[:column] + row[column + 1 :] for row in rows]
        return arrays | {"rows": timeless, "mesh": (self.output / "meshes" / "result.glb").read_bytes()}


def killed(run: Run) -> None:
    """kill -9 in the middle of a step."""
    process = run.start()
    run.wait_for_step(process, 11)
    process.kill()
    run.end(process)
    run.resume()


def terminated(run: Run) -> None:
    """SIGTERM, as schedulers send it."""
    process = run.start()
    run.wait_for_step(process, 11)
    process.send_signal(signal.SIGTERM)
    run.end(process)
    run.resume()


def full_disk(run: Run) -> None:
    """Something else fills the disk; later there is room again."""
    with small_disk(run.output.parent):
        process = run.start()
        run.wait_for_step(process, 9)
        ballast = run.output.parent / "ballast"
        with open(ballast, "wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                pass
        run.end(process)
        ballast.unlink()
        run.resume()
        run.found = run.result()


def read_only(run: Run) -> None:
    """The file system turns read-only, as broken disks do; later it can be written again."""
    with small_disk(run.output.parent):
        process = run.start()
        run.wait_for_step(process, 9)
        # A file that is open for writing at that moment refuses it: then again.
        while subprocess.run(["mount", "-o", "remount,ro", run.output.parent], capture_output=True).returncode:
            time.sleep(0.001)
        run.end(process)
        subprocess.run(["mount", "-o", "remount,rw", run.output.parent], check=True)
        run.resume()
        run.found = run.result()


def removed(run: Run) -> None:
    """The folder of the run is deleted while it goes on: nothing is left to go on from."""
    process = run.start()
    run.wait_for_step(process, 9)
    shutil.rmtree(run.output, ignore_errors=True)
    shutil.rmtree(run.output, ignore_errors=True)
    run.end(process)
    run.found = None


# A case with two processes goes here: a function of a Run, which leaves a finished run or sets `found`.
CASES: dict[str, Callable[[Run], None]] = {
    "killed": killed,
    "terminated": terminated,
    "full_disk": full_disk,
    "read_only": read_only,
    "removed": removed,
}


@contextmanager
def small_disk(place: Path, size: str = "2m"):
    """A file system in memory; raises PermissionError where it may not be mounted."""
    place.mkdir(exist_ok=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place], capture_output=True, text=True
    )
    if done.returncode:
        raise PermissionError(done.stderr.strip())
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def main(names: list[str]) -> int:
    """Run the cases; the exit code is the number of those that did not end as they should."""
    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        straight = Run(Path(place) / "straight")
        straight.output.parent.mkdir()
        print(f"straight: {STEPS} steps without a fault")
        straight.end(straight.start())
        expected = straight.result()
        for name in names or CASES:
            run = Run(Path(place) / name)
            run.output.parent.mkdir()
            print(f"{name}: {CASES[name].__doc__}")
            try:
                CASES[name](run)
            except PermissionError as problem:
                print(f"    left out: no small file system can be mounted here ({problem})")
                continue
            found = run.found if hasattr(run, "found") else run.result()
            if found is not None:
                # The config is the same but for its output, which the checkpoint does not have.
                different = [key for key in expected if found[key] != expected[key]]
                wrong += bool(different)
                print("    the same bits as without the fault" if not different else f"    DIFFERENT: {different}")
    return wrong


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
