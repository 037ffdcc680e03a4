"""The first hour of three people, as they would spend it: what README and pages say, in a fresh clone and environment.

    python -m experiments.first_hour.run [--only README] [--keep FOLDER]

Each step runs on a terminal of its own (a pseudo-terminal), with empty caches of programs at the beginning. Printed
for each: seconds to the first word, the longest silence, seconds in all, and lines of noise: what other packages print.
A student reads README, the quickstart, tutorials and a notebook. A user of Mitsuba has a scene file. Somebody has
photographs. Somebody comes from PyTorch.
"""

import argparse
import fcntl
import os
import pty
import re
import select
import shlex
import struct
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
NOISE = re.compile(r"^(Warp |Module |   \S.*|[WEI]\d{4} .*|WARNING.*|.*\w+Warning: .*|.*CUDA.*)$")
OWN = re.compile(r"^ {3}(\d|step)")  # our own indented lines


class Step(NamedTuple):
    """A command of a person, as a line for the shell."""

    person: str
    name: str
    command: str


class Measured(NamedTuple):
    """Seconds, and lines of other packages."""

    first: float
    silence: float
    total: float
    noise: list[str]
    status: int


def blocks(page: str, language: str) -> list[str]:
    """The fenced blocks of a page that are in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", (ROOT / page).read_text(), re.DOTALL | re.MULTILINE)


def steps(folder: Path) -> list[Step]:
    """What the three do. Code of pages is written to files of the folder."""
    (folder / "twenty_lines.py").write_text(blocks("README.md", "python")[0])
    (folder / "quickstart.py").write_text("\n".join(blocks("docs/quickstart.md", "python")))
    install, *job = blocks("README.md", "sh")[0].splitlines()
    scene = "experiments/data/reference_scenes/direct_spot/scene.xml"
    run = f"jupyter nbconvert --to notebook --execute --output-dir {folder}"
    return [
        Step("photographs", "README: install", install.partition("&& ")[2].partition("&& ")[2]),
        *[Step("photographs", f"README: {line}", line) for line in job],
        Step("photographs", "look at it", "jaxdr view runs/cow -o runs/cow.html"),
        Step("student", "README: twenty lines", f"python {folder / 'twenty_lines.py'}"),
        Step("student", "quickstart: command", "jaxdr optimize configs/quickstart.toml"),
        Step("student", "quickstart: code", f"python {folder / 'quickstart.py'}"),
        *[
            Step("student", f"tutorial: {name}", f"python examples/{name}.py")
            for name in ("first_gradient", "optimise_a_pose", "mesh_from_views", "your_own_bsdf")
        ],
        Step("student", "install notebooks", 'pip install -e ".[notebooks]"'),
        Step("student", "notebook: first gradient", f"{run} docs/notebooks/first_gradient.ipynb"),
        Step("Mitsuba", "help", "jaxdr --help"),
        Step("Mitsuba", "image", f"jaxdr render {scene} -o runs/image.png --spp 256"),
        Step("Mitsuba", "gradient", f"jaxdr gradient {scene} --wrt spot.translate.x -o runs/derivative.png"),
        Step("Mitsuba", "a mistake", f"jaxdr gradient {scene} --wrt spott.translate.x -o runs/other.png"),
        Step("PyTorch", "install", 'pip install -e ".[torch]"'),
        Step("PyTorch", "tutorial: torch_optimiser", "python examples/torch_optimiser.py"),
    ]


def measured(command: str, folder: Path, environment: dict[str, str], log: Path) -> Measured:
    """Run a line on a terminal. A silence is the time between two outputs, or before the first, or after the last."""
    outside, inside = pty.openpty()
    fcntl.ioctl(inside, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    start = last = time.perf_counter()
    process = subprocess.Popen(
        command, shell=True, cwd=folder, env=environment, stdin=inside, stdout=inside, stderr=inside, close_fds=True
    )
    os.close(inside)
    first, silence, output = None, 0.0, b""
    while True:
        ready = select.select([outside], [], [], 0.05)[0]
        try:
            data = os.read(outside, 1 << 16) if ready else b""
        except OSError:  # the other end is closed
            break
        if not data:
            if process.poll() is not None and not ready:
                break
            continue
        now = time.perf_counter()
        first = now - start if first is None else first
        silence, last, output = max(silence, now - last), now, output + data
    status = process.wait()
    os.close(outside)
    end = time.perf_counter()
    lines = output.decode(errors="replace").replace("\r\n", "\n").split("\n")
    log.write_text("\n".join(line.rpartition("\r")[2] for line in lines))
    noise = [line for line in lines if NOISE.match(line) and not OWN.match(line) and not command.startswith("pip")]
    return Measured(end - start if first is None else first, max(silence, end - last), end - start, noise, status)


def environment_of(folder: Path) -> dict[str, str]:
    """Variables of a fresh user: a new home, a new Python environment, and a terminal."""
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True)
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith(("JAX", "XLA", "PYTHON", "VIRTUAL"))
    }
    path = f"{folder / 'venv/bin'}:{os.environ['PATH']}"
    home = {"HOME": str(folder / "home"), "XDG_CACHE_HOME": str(folder / "home/.cache")}
    (folder / "home").mkdir()
    return kept | home | {"PATH": path, "VIRTUAL_ENV": str(folder / "venv"), "TERM": "xterm", "COLUMNS": "120"}


def main() -> None:
    """Prints a table, a line for each step as it ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="steps whose person or name has this text, and those that install")
    parser.add_argument("--keep", type=Path, help="an empty folder for clone, environment and logs; default: temporary")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (options.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        clone = folder / "clone"
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        environment = environment_of(folder)
        print("| person | step | first word, s | longest silence, s | all, s | lines of noise | status |")
        print("| --- | --- | --- | --- | --- | --- | --- |")
        for number, step in enumerate(steps(folder)):
            if options.only not in f"{step.person} {step.name}" and "install" not in step.name:
                continue
            log = folder / f"{number:02d}.log"
            found = measured(step.command, clone, environment, log)
            times = f"{found.first:.1f} | {found.silence:.1f} | {found.total:.0f}"
            name = step.name if len(step.name) < 60 else f"{step.name[:57]}..."
            print(f"| {step.person} | {name} | {times} | {len(found.noise)} | {found.status} |", flush=True)
            for line in found.noise:
                print(f"    {shlex.quote(line.strip())}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
