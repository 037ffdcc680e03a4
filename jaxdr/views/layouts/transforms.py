"""Reads `transforms*.json` of NeRF synthetic scenes and of instant-ngp."""

from pathlib import Path

import numpy as np

from jaxdr.untrusted import MOST_PIXELS, finite, read_json, shortened
from jaxdr.views.frames import Frame, all_there, checked_pose
from jaxdr.views.layouts.colmap_tables import PARAMETERS
from jaxdr.views.lens import ONE_FOCAL, Lens
from jaxdr.views.masks import find_mask
from jaxdr.views.pictures import MissingPicture, find_picture

NAME = "transforms.json or transforms_train.json (NeRF, instant-ngp, nerfstudio)"
TRAIN, TEST, ALL = "transforms_train.json", "transforms_test.json", "transforms.json"
# Numbers of distortion, in the order of COLMAP's models.
OF_OPENCV = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
OF_FISHEYE = ("k1", "k2", "k3", "k4")
# Models whose distortion is that of OpenCV; those that have less of it leave numbers out.
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV")
FISHEYE = "OPENCV_FISHEYE"
OWN = "camera_params"  # ours: the parameters of COLMAP's model, where the names above do not have it
# From a frame with x to the right, y up, z backward to one with x to the left, y up, z forward.
FROM_OPENGL = np.diag([-1.0, 1.0, -1.0, 1.0])


def files(folder: Path) -> list[Path]:
    """The files of cameras in a folder; none where neither of the two that may stand alone is there."""
    there = [folder / name for name in (TRAIN, TEST, ALL) if (folder / name).is_file()]
    return there if any(path.name != TEST for path in there) else []


def frames(folder: Path) -> list[Frame]:
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
    numbered = list(enumerate(entries))
    return all_there(numbered, lambda each: _frame(folder, path, document, each[1], each[0], held_out), path)


def _frame(folder: Path, path: Path, document: dict, entry, number: int, held_out: bool) -> Frame:
    source = f"{path}: frames[{number}]"
    if not isinstance(entry, dict) or not isinstance(entry.get("file_path"), str):
        raise ValueError(f"{source}: has no file_path; every frame names its picture")
    values = {**{name: value for name, value in document.items() if name != "frames"}, **entry}
    lens = _lens(values, source)
    own = entry.get("held_out", held_out)
    if not isinstance(own, bool):
        raise ValueError(f"{source}: held_out must be true or false, got {shortened(own)}")
    pose = checked_pose(entry.get("transform_matrix"), source) @ FROM_OPENGL
    picture = find_picture(folder, entry["file_path"], path)
    return Frame(picture, _mask(folder, path, entry, picture, source), pose, source, lens, own)


def _mask(folder: Path, path: Path, entry: dict, picture: Path, source: str) -> Path | None:
    named = entry.get("mask_path")
    if named is None:
        return find_mask(folder, picture, entry["file_path"])
    if not isinstance(named, str):
        raise ValueError(f"{source}: mask_path must be the name of a file, got {shortened(named)}")
    try:
        return find_picture(folder, named, path)
    except MissingPicture:
        return None


def _lens(values: dict, source: str) -> Lens:
    """The lens of a frame."""
    size = _pixels(values, "w", source), _pixels(values, "h", source)
    model = values.get("camera_model", "PINHOLE")
    fisheye = model == FISHEYE or bool(values.get("is_fisheye"))
    if not fisheye and model not in MODELS and not (isinstance(model, str) and model in PARAMETERS and OWN in values):
        raise ValueError(
            f"{source}: a lens {shortened(model)} is not supported; undistort the pictures to PINHOLE first"
        )
    if OWN in values:
        numbers = values[OWN]
        if not isinstance(numbers, list) or len(numbers) != PARAMETERS[model]:
            raise ValueError(f"{source}: {OWN} of a {model} lens must be {PARAMETERS[model]} numbers")
        return Lens(model, tuple(finite(number, f"{source}: {OWN}") for number in numbers), *size)
    bent = {name: _number(values, name, source) for name in dict.fromkeys((*OF_OPENCV, *OF_FISHEYE)) if name in values}
    x, y = (_number(values, name, source) if name in values else None for name in ("cx", "cy"))
    if "fl_x" in values:
        focal = _number(values, "fl_x", source), _number(values, "fl_y" if "fl_y" in values else "fl_x", source)
    elif "camera_angle_x" in values:
        angle = _number(values, "camera_angle_x", source)
        if fisheye or any(bent.values()):
            raise ValueError(f"{source}: has distortion but no fl_x; give the focal length in pixels")
        return Lens("PINHOLE", (None, None, x, y), *size, angle)
    else:
        raise ValueError(f"{source}: says neither fl_x nor camera_angle_x; the focal length is needed")
    if not fisheye and not any(bent.values()):
        return Lens.pinhole(focal, (x, y), size)
    if None in (x, y) or 0 in size:
        raise ValueError(f"{source}: has distortion but not all of cx, cy, w, h; give them in pixels")
    names = OF_FISHEYE if fisheye else OF_OPENCV
    numbers = [bent.get(name, 0.0) for name in names]
    if fisheye:
        return Lens(FISHEYE, (*focal, x, y, *numbers), *size)
    if any(numbers[4:]):
        return Lens("FULL_OPENCV", (*focal, x, y, *numbers), *size)
    return Lens("OPENCV", (*focal, x, y, *numbers[:4]), *size)


def lens_entries(lens: Lens) -> dict:
    """What a frame says of a lens that has no gaps: by the names of nerfstudio where these have it."""
    named = {"w": lens.width, "h": lens.height}
    (fx, fy), (x, y) = lens.focal, lens.centre
    pixels = {"fl_x": fx, "fl_y": fy, "cx": x, "cy": y}
    if lens.straight:
        return pixels | named
    bent = {"OPENCV": OF_OPENCV, "FULL_OPENCV": OF_OPENCV, FISHEYE: OF_FISHEYE, "SIMPLE_RADIAL": ("k1",)}
    bent["RADIAL"] = ("k1", "k2")
    if lens.model not in bent:
        return {"camera_model": lens.model, OWN: list(lens.parameters)} | named
    first = 3 if lens.model in ONE_FOCAL else 4
    numbers = dict(zip(bent[lens.model], lens.parameters[first:], strict=False))
    model = FISHEYE if lens.model == FISHEYE else "OPENCV"
    return pixels | named | {"camera_model": model} | numbers


def _number(values: dict, name: str, source: str) -> float:
    return finite(values[name], f"{source}: {name}")


def _pixels(values: dict, name: str, source: str) -> int:
    """A width or height, which some programs write with a fraction of zero; 0 if it is not there."""
    if name not in values:
        return 0
    value = finite(values[name], f"{source}: {name}", 1, MOST_PIXELS)
    if value % 1:
        raise ValueError(f"{source}: {name} must be a whole number of pixels, got {shortened(values[name])}")
    return int(value)
