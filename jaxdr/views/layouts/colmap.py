"""COLMAP models, text and binary."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.views.frames import Frame, all_there, checked_pose
from jaxdr.views.layouts.colmap_tables import Image, read_tables
from jaxdr.views.lens import Lens
from jaxdr.views.masks import find_mask
from jaxdr.views.pictures import find_picture

NAME = "a COLMAP model (sparse/0/cameras.bin or .txt)"
PLACES = ("sparse/0", "sparse", "colmap/sparse/0", ".")
TABLES = ("cameras", "images", "rigs", "frames")
# From a frame with x to the right, y down, z forward to one with x to the left, y up, z forward.
FROM_COLMAP = np.diag([-1.0, -1.0, 1.0, 1.0])


def find_model(folder: Path) -> Path | None:
    """The folder of the COLMAP model in a folder of photographs; None if there is none."""
    for place in PLACES:
        if any((folder / place / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder / place
    return None


def files(folder: Path) -> list[Path]:
    """The tables of cameras and images; none where there is no model."""
    model = find_model(folder)
    if model is None:
        return []
    return [file for name in TABLES for file in sorted(model.glob(f"{name}.*")) if file.is_file()]


def frames(folder: Path) -> list[Frame]:
    """All registered images of a model, sorted by name. Those called `test_*` are held out.

    Raises ValueError, with the name of the file.
    """
    model = find_model(folder)
    if model is None:
        raise ValueError(f"{folder}: has no COLMAP model; expected cameras and images in sparse/0")
    cameras, images = read_tables(model)
    if not images:
        raise ValueError(f"{model}: the model has no image with a pose; register the photographs first")
    in_order = sorted(images.values(), key=lambda image: image.name)
    return all_there(in_order, lambda image: _frame(folder, model, image, cameras[image.camera]), model)


def pictures_of(folder: Path) -> Path:
    """The folder to which names of pictures are relative."""
    return folder / "images" if (folder / "images").is_dir() else folder


def _frame(folder: Path, model: Path, image: Image, lens: Lens) -> Frame:
    source = f"{model}: {image.name}"
    picture = find_picture(pictures_of(folder), image.name, model)
    pose = checked_pose(np.linalg.inv(_world_to_camera(image)), source) @ FROM_COLMAP
    held_out = Path(image.name).name.startswith("test_")
    return Frame(picture, find_mask(folder, picture, image.name), pose, source, lens, held_out)


def _world_to_camera(image: Image) -> Float[np.ndarray, "4 4"]:
    w, x, y, z = image.rotation
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.vstack([np.column_stack([rotation, image.translation]), [0, 0, 0, 1]])
