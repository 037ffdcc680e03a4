"""IDR, NeuS, DTU: `cameras_sphere.npz` or `cameras.npz`, with a projection and a normalisation of each picture.

The world is that of the normalised scene, as in these projects: the object is in the unit sphere.
"""

import re
from pathlib import Path

import numpy as np

from jaxdr.untrusted import arrays_of
from jaxdr.views.frames import Frame
from jaxdr.views.layouts.matrices import ANEW, camera_of, check_order, checked_array, masks_in, pictures_in
from jaxdr.views.masks import FOLDERS, find_mask

NAME = "cameras_sphere.npz or cameras.npz (IDR, NeuS, DTU)"
TABLES = ("cameras_sphere.npz", "cameras.npz")
PICTURES = ("image", "images")


def files(folder: Path) -> list[Path]:
    """The file of matrices; none where there is none."""
    return [folder / name for name in TABLES if (folder / name).is_file()][:1]


def frames(folder: Path) -> list[Frame]:
    """All pictures, in the order of their names: the first has the matrices with the lowest number.

    Raises ValueError, with the file.
    """
    (path,) = files(folder)
    arrays = arrays_of(path, f"{path}: not a readable NPZ file")
    numbers = sorted(int(found[1]) for name in arrays if (found := re.fullmatch(r"world_mat_(\d{1,9})", name)))
    place = next((folder / name for name in PICTURES if (folder / name).is_dir()), folder / PICTURES[0])
    pictures = pictures_in(place)
    if len(pictures) != len(numbers) or not numbers:
        raise ValueError(
            f"{path}: has {len(numbers)} matrices world_mat_0, world_mat_1, …; {place} has {len(pictures)} pictures; "
            "there must be one for each"
        )
    check_order(pictures)
    masks = _masks(folder, pictures)
    return [
        _frame(path, arrays, number, picture, mask)
        for number, picture, mask in zip(numbers, pictures, masks, strict=True)
    ]


def _frame(path: Path, arrays: dict[str, np.ndarray], number: int, picture: Path, mask: Path | None) -> Frame:
    world, scale = (_matrix(path, arrays, f"{name}_{number}") for name in ("world_mat", "scale_mat"))
    source = f"{path}: world_mat_{number}"
    lens, pose = camera_of((world @ scale)[:3], source)
    return Frame(picture, mask, pose, source, lens)


def _matrix(path: Path, arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    if name not in arrays:
        raise ValueError(f"{path}: has no {name}; every picture needs world_mat and scale_mat, {ANEW}")
    found = checked_array(arrays[name], [(4, 4), (3, 4)], f"{path}: {name}")
    return np.vstack([found[:3], [0, 0, 0, 1]])  # the last row of NeuS's own is this one


def _masks(folder: Path, pictures: list[Path]) -> list[Path | None]:
    """Masks by name. Where that leaves some out, by order: DTU has `image/000000.png` and `mask/000.png`."""
    named = [find_mask(folder, picture, picture.name) for picture in pictures]
    place = next((folder / name for name in FOLDERS if (folder / name).is_dir()), None)
    if all(named) or place is None:
        return named
    ordered = masks_in(place)
    if len(ordered) != len(pictures):
        return named
    check_order(ordered)
    return list(ordered)
