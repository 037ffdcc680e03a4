"""COLMAP models, text and binary, through pycolmap."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxdr.views.frames import Frame, checked_pose
from jaxdr.views.pictures import find_mask, find_picture

PLACES = ("sparse/0", "sparse", "colmap/sparse/0", ".")
MODELS = ("PINHOLE", "SIMPLE_PINHOLE")
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

    Raises ValueError, with the name of the file, and ImportError if pycolmap is missing.
    """
    pycolmap = require_pycolmap()
    model = find_model(folder)
    if model is None:
        raise ValueError(f"{folder}: has no COLMAP model; expected cameras, images and points3D in sparse/0")
    pycolmap.logging.minloglevel = 3  # our own error says what is wrong
    try:
        found = pycolmap.Reconstruction(str(model))
    except (ValueError, IndexError, RuntimeError) as problem:
        raise ValueError(f"{model}: is not a readable COLMAP model ({problem}); export it anew") from None
    images = sorted((image for image in found.images.values() if image.has_pose), key=lambda image: image.name)
    if not images:
        raise ValueError(f"{model}: the model has no image with a pose; register the photographs first")
    return [_frame(folder, model, image, found.cameras[image.camera_id]) for image in images]


def _frame(folder: Path, model: Path, image: Any, camera: Any) -> Frame:
    source = f"{model}: {image.name}"
    if camera.model.name not in MODELS:
        raise ValueError(
            f"{model}: camera {camera.camera_id} is {camera.model.name}; only {' and '.join(MODELS)} are supported: "
            "undistort the pictures first, with `colmap image_undistorter`"
        )
    base = folder / "images" if (folder / "images").is_dir() else folder
    picture = find_picture(base, image.name, model)
    world_to_camera = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
    pose = checked_pose(np.linalg.inv(world_to_camera), source) @ FROM_COLMAP
    focal = (float(camera.focal_length_x), float(camera.focal_length_y))
    centre = (float(camera.principal_point_x), float(camera.principal_point_y))
    held_out = Path(image.name).name.startswith("test_")
    size = (int(camera.width), int(camera.height))
    mask = find_mask(folder, image.name)
    return Frame(picture, mask, pose, source, focal, 0.0, centre, size, held_out)


def require_pycolmap() -> Any:
    """The package pycolmap. Raises ImportError, which says how to install it."""
    try:
        import pycolmap
    except ImportError as missing:
        raise ImportError('COLMAP models need pycolmap, which is optional: pip install "jaxdr[colmap]"') from missing
    return pycolmap
