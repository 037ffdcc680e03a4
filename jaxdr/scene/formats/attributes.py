"""Attributes that mesh files store at vertices and faces, by the names that Mitsuba's `mesh_attribute` uses."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.load import Triangles

Attributes = dict[str, Float[np.ndarray, "_ _"] | None]

RENAMED = {"red": "r", "green": "g", "blue": "b", "alpha": "a"}
# Properties that are no attributes: positions, normals and texture coordinates.
GEOMETRY = frozenset(("x", "y", "z", "nx", "ny", "nz", "u", "v", "s", "t"))


def mesh_attributes(parts: Sequence[Triangles], rows: Int[np.ndarray, " n"]) -> Attributes:
    """Attributes of the joined parts: `vertex_<name>` with a row for each vertex of the mesh, `face_<name>` each face.

    `rows` is the mesh's vertex for every vertex of the parts, part after part. An attribute is None if vertices that
    became one have different values. Attributes that only some parts have are left out.
    """
    found: Attributes = {}
    for element in ("vertex", "face"):
        named = [_named(part.stored.get(element, {})) for part in parts]
        for name in named[0] if named else ():
            if all(name in one for one in named) and len({one[name].shape[1] for one in named}) == 1:
                values = np.concatenate([one[name] for one in named])
                found[f"{element}_{name}"] = _joined(values, rows) if element == "vertex" else values
    return found


def _joined(values: Float[np.ndarray, "n C"], rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "V C"] | None:
    joined = np.zeros((rows.max(initial=-1) + 1, values.shape[1]))
    joined[rows] = values
    return joined if np.array_equal(joined[rows], values) else None


def _named(stored: dict[str, np.ndarray]) -> dict[str, Float[np.ndarray, "_ _"]]:
    """Attributes from columns: neighbours such as `color_0`, `color_1`, … are one attribute; r, g and b are `color`."""
    columns = {RENAMED.get(name, name): values for name, values in stored.items()}
    found = {}
    if {"r", "g", "b"} <= set(columns):
        found["color"] = [columns[name] for name in "rgb"]
    others = [name for name in columns if name not in GEOMETRY and "_" in name]
    for stem, group in groupby(others, lambda name: name.rpartition("_")[0]):
        names = list(group)
        attribute = f"{stem}_color" if names[0].rpartition("_")[2] in "rgb" else stem  # Mitsuba's rule
        found.setdefault(attribute, [columns[name] for name in names])
    return {name: np.stack(values, axis=1).astype(float) for name, values in found.items()}
