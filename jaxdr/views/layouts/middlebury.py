"""Middlebury's multi-view sets (temple, dino): `NAME_par.txt`, and pictures beside it."""

from collections import Counter
from pathlib import Path

import numpy as np

from jaxdr.untrusted import shortened, text_of
from jaxdr.views.frames import Frame, all_there, some_of
from jaxdr.views.layouts.matrices import ANEW, lens_of, numbers_in, pose_of
from jaxdr.views.masks import find_mask
from jaxdr.views.pictures import find_picture

NAME = "NAME_par.txt (Middlebury multi-view)"
NUMBERS = 21  # of a picture: calibration and rotation, row by row, and translation


def files(folder: Path) -> list[Path]:
    """The files of cameras; none where there are none."""
    return sorted(path for path in folder.glob("*_par.txt") if path.is_file())


def frames(folder: Path) -> list[Frame]:
    """All pictures, in the order of the lines. Raises ValueError, with the file."""
    path, *more = files(folder)
    if more:
        raise ValueError(
            f"{folder}: has several files of cameras, {some_of(file.name for file in (path, *more))}; keep one"
        )
    lines = [(number, line) for number, line in enumerate(text_of(path).split("\n"), 1) if line.strip()]
    said, rows = lines[0][1].strip() if lines else "", lines[1:]
    if said != str(len(rows)) or not rows:
        raise ValueError(
            f"{path}: line 1 must be the number of pictures, and {len(rows)} follow; got {shortened(said)}; {ANEW}"
        )
    ((name, count),) = Counter(line.split()[0] for _, line in rows).most_common(1)
    if count > 1:
        raise ValueError(f"{path}: {count} lines are of the picture {shortened(name)}; keep one")
    return all_there(rows, lambda row: _frame(folder, path, *row), path)


def _frame(folder: Path, path: Path, number: int, line: str) -> Frame:
    name, *words = line.split()
    source = f"{path}: line {number}"
    values = np.array(numbers_in(" ".join(words), NUMBERS, source))
    rotation, translation = values[9:18].reshape(3, 3), values[18:]
    pose = pose_of(rotation, -rotation.T @ translation, source)
    lens = lens_of(values[:9].reshape(3, 3), source)
    picture = find_picture(folder, name, path)
    return Frame(picture, find_mask(folder, picture, name), pose, source, lens)
