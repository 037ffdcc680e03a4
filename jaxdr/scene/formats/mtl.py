"""MTL files, the materials of OBJ files: their diffuse colours."""

import dataclasses
import os
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.formats.obj import read_text
from jaxdr.untrusted import shortened

# Statements that change the look, and the values at which they don't. Illumination models name what others have said.
NEUTRAL = {"ks": (0.0,), "ke": (0.0,), "d": (1.0,), "tr": (0.0,), "tf": (1.0,)}
NO_EFFECT = ("ka", "ns", "ni", "illum", "sharpness", "map_ka")


@dataclasses.dataclass
class Surface:
    """A material: the linear diffuse `color`, the `image` by which it is multiplied, statements that are `unread`."""

    color: Float[np.ndarray, "3"]
    image: Path | None = None
    unread: tuple[str, ...] = ()


def read_mtl(path: Path) -> dict[str, Surface]:
    """The materials of an MTL file by name.

    Raises ValueError, with the line, for colours that are not three numbers in [0, 1], for images that are missing, and
    for a material without a name or none at all to which they belong.
    """
    found: dict[str, Surface] = {}
    name = ""
    for number, line in enumerate(read_text(path).split("\n"), 1):
        key, rest = [*line.partition("#")[0].split(None, 1), "", ""][:2]
        key, rest, place = key.lower(), rest.strip(), f"{path}, line {number}"
        if key == "newmtl":
            name = rest
            found[name] = Surface(np.ones(3))
        if key in ("newmtl", "kd", "map_kd") and not name:
            raise ValueError(f"{place}: needs the name of a material behind newmtl, in this line or before")
        if key == "kd":
            found[name].color = _color(place, rest)
        elif key == "map_kd":
            found[name].image = _image(place, path.parent, rest)
        elif name and key not in ("", "newmtl", *NO_EFFECT) and not _neutral(key, rest):
            found[name].unread += (key,)
    return found


def _color(place: str, text: str) -> Float[np.ndarray, "3"]:
    try:
        values = np.array(text.split(), float)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not ((values >= 0) & (values <= 1)).all():
        raise ValueError(f"{place}: Kd must be three numbers in [0, 1], got {shortened(text)}")
    return values


def _image(place: str, folder: Path, text: str) -> Path:
    if text.startswith("-"):
        raise ValueError(f"{place}: options of map_Kd are not supported, got {shortened(text)}; give the file alone")
    path = folder / text.replace("\\", "/")
    if not os.path.isfile(path):  # unlike Path.is_file, this takes any name
        raise ValueError(f"{place}: there is no image {path}; put it there")
    return path


def _neutral(key: str, text: str) -> bool:
    try:
        return key in NEUTRAL and set(map(float, text.split())) <= set(NEUTRAL[key])
    except ValueError:
        return False
