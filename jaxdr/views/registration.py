"""Finds the cameras of photographs: features (SIFT), pairs, and incremental mapping, by pycolmap."""

import dataclasses
import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from jaxdr.atomic_file import CannotWrite, atomic_folder
from jaxdr.views.camera_folder import check_output, link_all, mark
from jaxdr.views.photographs import Photographs, find_photographs

LENS = "SIMPLE_RADIAL"  # more parameters made the error 2 % smaller, and parts of the photographs agree less
LONGEST = 1600  # pixels along the longer side in which features are looked for
EVERY_PAIR = 100  # photographs of which every pair is compared
NEXT = 10  # of more: each with so many that follow by name,
SPREAD = 70  # … and every pair of so many that are spread over all
THREADS = 16  # at most; each takes about 0.3 GiB
FEW, LARGE = 0.8, 1.5  # share of photographs and error in pixels at which advice is given
PROGRAM = Path(__file__).with_name("mapping_process.py")

ADVICE = (
    "take more photographs that overlap by two thirds, sharp, of one zoom, of an object that stays where it is; "
    "texture around it helps, such as a newspaper under it"
)

Progress = Callable[[str, int, int], None]


@dataclasses.dataclass(frozen=True)
class Registration:
    """What was found.

    - `photographs`: how many there are. `registered`: how many have a camera now; `missing`: names of the others.
    - `error`: mean distance between features and the points that they belong to, pixels. `points`: their number.
    - `focal`: focal length of each camera, pixels. `lens`: COLMAP's name of the lens model.
    - `others`: numbers of photographs that belong together, but not to those that are registered.
    - `unused`: numbers of files of kinds that are not read, by suffix. `seconds`: the time it took.
    """

    photographs: int
    registered: int
    missing: tuple[str, ...]
    error: float
    points: int
    focal: tuple[float, ...]
    lens: str
    others: tuple[int, ...]
    unused: dict[str, int]
    seconds: float


def find_cameras(
    photos: Path, output: Path, *, seed: int = 0, overwrite: bool = False, progress: Progress | None = None
) -> Registration:
    """Cameras of the photographs in a folder, written to a folder that `load_views` reads.

    `output` gets `sparse/0` (a COLMAP model), `images` and masks, which are links to the folders of the photographs, or
    copies where there are no links, and `registration.json` with the numbers. It appears complete or not at all. Same
    photographs and seed, same bits of the model. `progress` gets the stage, what of it is done, and what there is.

    Up to 100 photographs every pair is compared. Of more, each is compared with those that are next by name.

    Raises ValueError, with the place and the remedy, for photographs that `find_photographs` refuses, fewer than three
    that can be registered, and an `output` that must not be written to; ImportError without pycolmap; OSError if
    pycolmap fails or the disk is full.
    """
    start = time.monotonic()
    require_pycolmap()
    photos, output = Path(photos), Path(output)
    check_output(photos, output, overwrite)
    found = find_photographs(photos)
    with atomic_folder(output) as folder:
        model, work = folder / "sparse/0", folder / "work"
        model.mkdir(parents=True)
        work.mkdir()
        job = {
            "photographs": str(found.folder.resolve()),
            "cameras": found.cameras,
            "pairs": pairs(found.names),
            "work": str(work.resolve()),
            "model": str(model.resolve()),
            "seed": seed % 2**31,
            "threads": min(THREADS, _cores()),
            "lens": LENS,
            "longest": LONGEST,
        }
        numbers = _run(photos, job, work, progress or (lambda stage, done, total: None))
        registration = _registration(photos, found, numbers, time.monotonic() - start)
        shutil.rmtree(work)
        link_all(found, folder, output)
        mark(folder, dataclasses.asdict(registration))
    return registration


def report(registration: Registration) -> list[str]:
    """Lines for people: what was found, and what to do if that is little."""
    found = registration
    focal = ", ".join(f"{length:.0f}" for length in found.focal)
    lines = [
        f"{found.registered} of {found.photographs} photographs registered, error {found.error:.2f} pixels, "
        f"{found.points} points, focal length {focal} pixels ({found.lens}), {found.seconds:.0f} s"
    ]
    if found.missing:
        lines.append(f"without a camera: {', '.join(found.missing)}")
    if found.others:
        lines.append(
            f"groups of {', '.join(map(str, found.others))} photographs belong together, but not to the rest: take "
            "some between them"
        )
    if found.registered < FEW * found.photographs:
        lines.append(f"to register more: {ADVICE}")
    if found.error > LARGE:
        lines.append("the error is large: leave out photographs that are blurred, or in which something has moved")
    if found.unused:
        kinds = ", ".join(f"{count} {suffix}" for suffix, count in found.unused.items())
        lines.append(f"files of other kinds are not used: {kinds}; save them as JPEG or PNG")
    return lines


def require_pycolmap() -> None:
    """Raises ImportError, which says how to install pycolmap. It is not loaded here: see `mapping_process`."""
    if find_spec("pycolmap") is None:
        raise ImportError('finding cameras needs pycolmap, which is optional: pip install -e ".[reconstruct]"')


def pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """The pairs of photographs that are compared; `names` are in the order in which they were taken."""
    count = len(names)
    if count <= EVERY_PAIR:
        return list(itertools.combinations(names, 2))
    chosen = {(i, j) for i in range(count) for j in range(i + 1, min(i + NEXT + 1, count))}
    spread = [i * count // SPREAD for i in range(SPREAD)]
    # Walks around an object end where they began.
    chosen |= set(itertools.combinations(spread, 2)) | {(i, j) for i in range(NEXT) for j in range(count - NEXT, count)}
    return [(names[i], names[j]) for i, j in sorted(chosen)]


def _run(photos: Path, job: dict[str, Any], work: Path, progress: Progress) -> dict[str, Any]:
    """The numbers of the largest model. Raises OSError if the process ends without them."""
    file, log = work / "job.json", work / "log.txt"
    try:
        file.write_text(json.dumps(job), encoding="utf-8")
        errors = log.open("w")
    except OSError as problem:
        raise CannotWrite.of(file, problem) from problem
    # -P: modules beside the program are none of its own.
    command = [sys.executable, "-P", str(PROGRAM), str(file)]
    result = None
    with (
        errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, encoding="utf-8") as process,
    ):
        try:
            for line in process.stdout or ():
                if not line.startswith("{"):
                    continue
                said = json.loads(line)
                if "result" in said:
                    result = said["result"]
                else:
                    progress(said["stage"], said["done"], said["total"])
        finally:
            process.kill()
    if result is None:
        told = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
        why = " ".join((told or ["it was killed; is there enough memory?"])[-1].split())
        raise OSError(f"{photos}: pycolmap failed ({why}); take out what it names, or try again with fewer photographs")
    return result


def _registration(photos: Path, found: Photographs, numbers: dict[str, Any], seconds: float) -> Registration:
    if "unreadable" in numbers:
        path = found.folder / numbers["unreadable"][0]
        raise ValueError(f"{path}: pycolmap can't read it; save it as JPEG or PNG, or take it out")
    names, registered = found.names, numbers["registered"]
    if not registered:
        raise ValueError(f"{photos}: none of the {len(names)} photographs could be registered; {ADVICE}")
    return Registration(
        photographs=len(names),
        registered=len(registered),
        missing=tuple(name for name in names if name not in set(registered)),
        error=numbers["error"],
        points=numbers["points"],
        focal=tuple(numbers["focal"]),
        lens=numbers["lens"],
        others=tuple(numbers["others"]),
        unused=found.others,
        seconds=seconds,
    )


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
