"""One damaged input after the other: what a reader made of it, how long it took, and what memory it took."""

import shutil
import time
import traceback
import warnings
from fnmatch import fnmatch
from pathlib import Path
from random import Random
from typing import NamedTuple

from tests.fuzz.kind import Kind
from tests.fuzz.mutations import damaged

REFUSALS = (ValueError, OSError, ImportError)
SECONDS, MEGABYTES = 20.0, 1024.0  # more is a fault
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


class Outcome(NamedTuple):
    """`fault`: what is wrong, in words; empty where the input was read or refused as it should be."""

    fault: str
    refused: bool
    seconds: float
    megabytes: float


def example(kind: Kind, folder: Path) -> Path:
    """The valid input of a kind, in a folder of its own."""
    folder.mkdir(parents=True)
    kind.write(folder)
    return folder


def damage_input(kind: Kind, original: Path, folder: Path, seed: int) -> Path:
    """Make `folder` a copy of the valid input with one damaged file, which is returned."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(original, folder)
    random = Random(seed)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    chosen = [path for path in files if any(fnmatch(path.name, pattern) for pattern in kind.damaged)]
    file = random.choice(chosen)
    file.write_bytes(damaged(file.read_bytes(), random, kind.text))
    return file


def examine(kind: Kind, original: Path, folder: Path, seed: int) -> Outcome:
    """Read an input that the seed damages."""
    file = damage_input(kind, original, folder, seed)
    before, start = _peak(reset=True), time.perf_counter()
    fault, refused = "", False
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind.read(folder)
    except REFUSALS as problem:
        refused = True
        if folder.name not in str(problem) and file.name not in str(problem):
            fault = f"the message does not name the file: {problem}"
    except Exception:
        fault = traceback.format_exc()
    seconds, megabytes = time.perf_counter() - start, _peak() - before
    if not fault and seconds > SECONDS:
        fault = f"it took {seconds:.0f} s"
    if not fault and megabytes > MEGABYTES:
        fault = f"it took {megabytes:.0f} MB"
    return Outcome(fault, refused, seconds, megabytes)


def _peak(reset: bool = False) -> float:
    """The largest resident memory since the last reset, in MB; 0 where the system does not tell."""
    if not STATUS.exists():
        return 0.0
    if reset and CLEAR.exists():
        CLEAR.write_text("5")
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024
