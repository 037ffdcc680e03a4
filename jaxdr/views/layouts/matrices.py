"""What layouts share whose cameras are matrices, and whose pictures are those of a folder."""

import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy.linalg
from jaxtyping import Float

from jaxdr.images import READERS
from jaxdr.untrusted import LARGEST, damage, finite
from jaxdr.views.frames import checked_pose
from jaxdr.views.layouts.colmap import FROM_COLMAP
from jaxdr.views.layouts.colmap_tables import number_of
from jaxdr.views.lens import SQUARE, Lens
from jaxdr.views.masks import SUFFIXES, is_mask

ANEW = "export the cameras anew"
SINGULAR = 1e-12  # share of the longest axis below which an axis of a camera matrix is none


def checked_array(array: np.ndarray, shapes: Iterable[tuple[int, ...]], where: str) -> Float[np.ndarray, "..."]:
    """An array of a file in float64. Raises ValueError for another shape, other types, and numbers not finite."""
    shapes = list(shapes)
    if array.dtype.kind not in "fiu" or array.shape not in shapes:
        expected = " or ".join(str(list(shape)) for shape in shapes)
        raise ValueError(
            f"{where}: expected numbers of shape {expected}, got {list(array.shape)} of {array.dtype}; {ANEW}"
        )
    found = array.astype(np.float64)
    if not (np.abs(found) <= LARGEST).all():
        raise ValueError(f"{where}: has numbers that are not finite, or beyond {LARGEST:g}; {ANEW}")
    return found


def numbers_in(text: str, count: int, where: str) -> list[float]:
    """So many numbers of a text, finite. Raises ValueError otherwise."""
    words = text.split()
    if len(words) != count:
        raise ValueError(f"{where}: expected {count} numbers, got {len(words)}; {ANEW}")
    return [finite(number_of(word, where), where) for word in words]


def camera_of(projection: Float[np.ndarray, "3 4"], where: str) -> tuple[Lens, Float[np.ndarray, "4 4"]]:
    """(lens, pose) of the matrix that takes points of the world to pixels, which counts up to a factor.

    Raises ValueError for a matrix that is singular, and as `lens_of` does.
    """
    matrix, shift = projection[:, :3], projection[:, 3]
    if np.linalg.det(matrix) < 0:  # a factor of -1, as a rotation has no mirror
        matrix, shift = -matrix, -shift
    upper, rotation = scipy.linalg.rq(matrix)
    diagonal = np.diag(upper)
    if not np.abs(diagonal).min() > SINGULAR * np.abs(diagonal).max():
        raise ValueError(f"{where}: the projection is singular, it has no position; {ANEW}")
    signs = np.sign(diagonal)
    calibration = upper * signs / np.abs(diagonal[2])
    return lens_of(calibration, where), pose_of(signs[:, None] * rotation, -np.linalg.solve(matrix, shift), where)


def lens_of(calibration: Float[np.ndarray, "3 3"], where: str) -> Lens:
    """The lens of a calibration matrix (focal lengths, principal point). Raises ValueError for one that is skewed."""
    (fx, skew, x), (low, fy, y), last = calibration
    if max(abs(low), *np.abs(last - [0, 0, 1])) > SQUARE:
        raise ValueError(f"{where}: a calibration has zeros below its diagonal and ends with 1; {ANEW}")
    if abs(skew) > SQUARE * abs(fx):
        raise ValueError(
            f"{where}: the pixels are skewed by {skew / fx if fx else np.inf:.3g}; resample the pictures without skew"
        )
    return Lens.pinhole((float(fx), float(fy)), (float(x), float(y)))


def pose_of(
    rotation: Float[np.ndarray, "3 3"], position: Float[np.ndarray, "3"], where: str
) -> Float[np.ndarray, "4 4"]:
    """The pose of a camera. The rotation is world to camera, with x to the right, y down, z forward."""
    return checked_pose(np.column_stack([rotation.T, position]), where) @ FROM_COLMAP


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder that are no masks of others, sorted by name; none if it is not there."""
    with damage(f"{folder}: can't be read"):
        there = sorted(folder.iterdir()) if folder.is_dir() else []
    return [
        path
        for path in there
        if path.suffix.lower() in READERS
        and path.is_file()
        and not (is_mask(path) or path.name.startswith("."))  # macOS adds files of this kind
    ]


def masks_in(folder: Path) -> list[Path]:
    """The masks of a folder of masks, sorted by name."""
    with damage(f"{folder}: can't be read"):
        return [path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES and path.name[0] != "."]


def check_order(paths: Sequence[Path]) -> None:
    """Raises ValueError where the order of names is not that of the numbers in them: `10.png` is before `9.png`."""
    for before, path in pairwise(paths):
        alike = re.sub(r"\d+", "0", before.stem) == re.sub(r"\d+", "0", path.stem)
        if alike and _numbers(path) < _numbers(before):
            raise ValueError(
                f"{path.parent}: {before.name} comes before {path.name} by name, but not by number; write numbers with "
                "leading zeros"
            )


def _numbers(path: Path) -> list[tuple[int, str]]:
    """The numbers in a name, which may be of any length."""
    digits = [found.lstrip("0") for found in re.findall(r"\d+", path.stem)]
    return [(len(found), found) for found in digits]
