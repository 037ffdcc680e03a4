"""LLFF: `poses_bounds.npy`, and pictures in `images`, or reduced ones in `images_4`, `images_8`."""

import re
from pathlib import Path

import numpy as np

from jaxdr.untrusted import MOST_PIXELS, array_of, finite
from jaxdr.views.frames import Frame
from jaxdr.views.layouts.matrices import ANEW, checked_array, pictures_in, pose_of
from jaxdr.views.lens import Lens
from jaxdr.views.masks import find_mask

NAME = "poses_bounds.npy (LLFF)"
TABLE = "poses_bounds.npy"
# A row: five columns of a 3 x 5 matrix, row by row, then the nearest and the farthest depth, which are not used.
ROW, POSE = 17, (3, 5)


def files(folder: Path) -> list[Path]:
    """The file of poses; none where there is none."""
    return [path for path in [folder / TABLE] if path.is_file()]


def frames(folder: Path) -> list[Frame]:
    """All pictures, in the order of their names, which is that of the rows. Raises ValueError, with the file."""
    (path,) = files(folder)
    table = array_of(path, str(path))
    if table.ndim != 2:
        raise ValueError(f"{path}: expected an array of shape [N, {ROW}], got {list(table.shape)}; {ANEW}")
    place = _place(folder)
    pictures = pictures_in(place)
    if len(pictures) != len(table) or not pictures:
        raise ValueError(
            f"{path}: has {len(table)} rows, {place} has {len(pictures)} pictures; there must be one for each"
        )
    return [_frame(folder, f"{path}: row {i}", row, pictures[i]) for i, row in enumerate(table)]


def _place(folder: Path) -> Path:
    """The folder of pictures: the largest ones that are there."""
    reduced = {
        int(found[1]): path for path in folder.iterdir() if (found := re.fullmatch(r"images_(\d{1,4})", path.name))
    }
    there = [folder / "images", *(reduced[share] for share in sorted(reduced))]
    return next((path for path in there if path.is_dir()), there[0])


def _frame(folder: Path, source: str, row: np.ndarray, picture: Path) -> Frame:
    down, right, back, position, camera = checked_array(row[:-2], [(ROW - 2,)], source).reshape(POSE).T
    height, width = (_pixels(value, source) for value in camera[:2])
    pose = pose_of(np.stack([right, down, -back]), position, source)
    lens = Lens.pinhole(float(camera[2]), size=(width, height))
    return Frame(picture, find_mask(folder, picture, picture.name), pose, source, lens)


def _pixels(value: float, source: str) -> int:
    found = finite(float(value), f"{source}: height and width", 1, MOST_PIXELS)
    if found % 1:
        raise ValueError(f"{source}: height and width must be whole numbers of pixels, got {found:g}; {ANEW}")
    return int(found)
