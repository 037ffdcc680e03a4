"""Reads `transforms*.json` of NeRF synthetic scenes and of instant-ngp."""

from pathlib import Path

import numpy as np

from jaxdr.untrusted import MOST_PIXELS, finite, read_json, shortened
from jaxdr.views.frames import Frame, checked_pose
from jaxdr.views.pictures import find_mask, find_picture

TRAIN, TEST, ALL = "transforms_train.json", "transforms_test.json", "transforms.json"
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL")  # all are pinholes without distortion
# From a frame with x to the right, y up, z backward to one with x to the left, y up, z forward.
FROM_OPENGL = np.diag([-1.0, 1.0, -1.0, 1.0])


def is_transforms(folder: Path) -> bool:
    """Whether a folder has such files."""
    return any((folder / name).is_file() for name in (TRAIN, ALL))


def transforms_frames(folder: Path) -> list[Frame]:
    """All frames of a folder. Held out are those of `transforms_test.json`, and frames that say so with `held_out`.

    Raises ValueError, with the file.
    """
    if not (folder / TRAIN).is_file():
        return _frames(folder, folder / ALL, False)
    test = _frames(folder, folder / TEST, True) if (folder / TEST).is_file() else []
    return _frames(folder, folder / TRAIN, False) + test


def _frames(folder: Path, path: Path, held_out: bool) -> list[Frame]:
    document = read_json(path)
    entries = document.get("frames") if isinstance(document, dict) else None
    if not isinstance(entries, list) or not entries:
        raise ValueError(f"{path}: has no frames; expected a list `frames` of pictures with transform_matrix")
    return [_frame(folder, path, document, entry, i, held_out) for i, entry in enumerate(entries)]


def _frame(folder: Path, path: Path, document: dict, entry, number: int, held_out: bool) -> Frame:
    source = f"{path}: frames[{number}]"
    if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
        raise ValueError(f"{source}: has no file_path; every frame names its picture")
    values = {**{name: value for name, value in document.items() if name != "frames"}, **entry}
    _check_lens(values, source)
    picture = find_picture(folder, entry["file_path"], path)
    mask = entry.get("mask_path")
    if mask is not None and not isinstance(mask, str):
        raise ValueError(f"{source}: mask_path must be the name of a file, got {shortened(mask)}")
    mask = find_mask(folder, picture.name) if mask is None else find_picture(folder, mask, path)
    pose = checked_pose(entry.get("transform_matrix"), source) @ FROM_OPENGL
    focal, angle = None, 0.0
    if "fl_x" in values:
        focal = (_number(values, "fl_x", source), _number(values, "fl_y" if "fl_y" in values else "fl_x", source))
    elif "camera_angle_x" in values:
        angle = _number(values, "camera_angle_x", source)
    else:
        raise ValueError(f"{source}: says neither fl_x nor camera_angle_x; the focal length is needed")
    x, y = (_number(values, name, source) if name in values else None for name in ("cx", "cy"))
    size = _pixels(values, "w", source), _pixels(values, "h", source)
    own = entry.get("held_out", held_out)
    if not isinstance(own, bool):
        raise ValueError(f"{source}: held_out must be true or false, got {shortened(own)}")
    return Frame(picture, mask, pose, source, focal, angle, (x, y), size, own)


def _check_lens(values: dict, source: str) -> None:
    """Raises ValueError for lenses other than pinholes."""
    bent = [name for name in DISTORTION if name in values and _number(values, name, source)]
    if bent:
        raise ValueError(
            f"{source}: lens distortion ({', '.join(bent)}) is not supported; undistort the pictures first, "
            "with `colmap image_undistorter` for one"
        )
    model = values.get("camera_model", "PINHOLE")
    if model not in MODELS or values.get("is_fisheye"):
        raise ValueError(
            f"{source}: a lens {shortened(model)} is not supported; undistort the pictures to PINHOLE first"
        )


def _number(values: dict, name: str, source: str) -> float:
    return finite(values[name], f"{source}: {name}")


def _pixels(values: dict, name: str, source: str) -> int | None:
    """A width or height, which some programs write with a fraction of zero."""
    if name not in values:
        return None
    value = finite(values[name], f"{source}: {name}", 1, MOST_PIXELS)
    if value % 1:
        raise ValueError(f"{source}: {name} must be a whole number of pixels, got {shortened(values[name])}")
    return int(value)
