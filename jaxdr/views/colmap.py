"""COLMAP models, text and binary."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.views.colmap_tables import Camera, Image, read_tables
from jaxdr.views.frames import Frame, checked_pose
from jaxdr.views.pictures import find_mask, find_picture

PLACES = ("sparse/0", "sparse", "colmap/sparse/0", ".")
PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
# From a frame with x to the right, y down, z forward to one with x to the left, y up, z forward.
FROM_COLMAP = np.diag([-1.0, -1.0, 1.0, 1.0])


def find_model(folder: Path) -> Path | None:
    """The folder of the COLMAP model in a folder of photographs; None if there is none."""
    for place in PLACES:
        if any((folder / place / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder / place
    return None


def colmap_frames(folder: Path) -> list[Frame]:
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
    return [_frame(folder, model, image, cameras[image.camera]) for image in in_order]


def _frame(folder: Path, model: Path, image: Image, camera: Camera) -> Frame:
    source = f"{model}: {image.name}"
    if camera.model not in PINHOLES:
        raise ValueError(
            f"{model}: camera {image.camera} is {camera.model}; only {' and '.join(PINHOLES)} are supported: "
            "undistort the pictures first, with `colmap image_undistorter`"
        )
    base = folder / "images" if (folder / "images").is_dir() else folder
    picture = find_picture(base, image.name, model)
    pose = checked_pose(np.linalg.inv(_world_to_camera(image)), source) @ FROM_COLMAP
    *focal, x, y = camera.parameters
    held_out = Path(image.name).name.startswith("test_")
    mask = find_mask(folder, image.name)
    size = camera.width, camera.height
    return Frame(picture, mask, pose, source, (focal[0], focal[-1]), 0.0, (x, y), size, held_out)


def _world_to_camera(image: Image) -> Float[np.ndarray, "4 4"]:
    w, x, y, z = image.rotation
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.vstack([np.column_stack([rotation, image.translation]), [0, 0, 0, 1]])
