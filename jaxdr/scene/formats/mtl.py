"""MTL files, the materials of OBJ files: their diffuse colours."""

import dataclasses
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.load import read_text

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

    Raises ValueError, with the line, for colours that are not three numbers in [0, 1], and for images that are missing.
    """
    found: dict[str, Surface] = {}
    name = ""
    for number, line in enumerate(read_text(path).splitlines(), 1):
        key, _, rest = line.partition("#")[0].strip().partition(" ")
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            name = rest
            found[name] = Surface(np.ones(3))
        elif name and key == "kd":
            found[name].color = _color(f"{path}, line {number}", rest)
        elif name and key == "map_kd":
            found[name].image = _image(f"{path}, line {number}", path.parent, rest)
        elif name and key and key not in NO_EFFECT and not _neutral(key, rest):
            found[name].unread += (key,)
    return found


def _color(place: str, text: str) -> Float[np.ndarray, "3"]:
    try:
        values = np.array(text.split(), float)
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not ((values >= 0) & (values <= 1)).all():
        raise ValueError(f"{place}: Kd must be three numbers in [0, 1], got {text!r}")
    return values


def _image(place: str, folder: Path, text: str) -> Path:
    if text.startswith("-"):
        raise ValueError(f"{place}: options of map_Kd are not supported, got {text!r}; give the file alone")
    path = folder / text.replace("\\", "/")
    if not path.is_file():
        raise ValueError(f"{place}: there is no image {path}; put it there")
    return path


def _neutral(key: str, text: str) -> bool:
    try:
        return key in NEUTRAL and set(map(float, text.split())) <= set(NEUTRAL[key])
    except ValueError:
        return False
