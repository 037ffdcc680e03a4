"""What the readers of mesh files make, and what they share: checked numbers, triangles of polygons, split vertices."""

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxdr.untrusted import LARGEST, shortened


@dataclasses.dataclass
class Triangles:
    """One mesh of a file. `uvs` and `normals` belong to the vertices, or are None.

    - `stored`: further numbers of a PLY file, by element ("vertex", "face") and property.
    - `colored`: what has colours that are no part of a mesh: "vertices", "faces" or "materials"; None if nothing has.
    - `material`: the name of the material in an OBJ file, or None.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "V 2"] | None = None
    normals: Float[np.ndarray, "V 3"] | None = None
    stored: dict[str, dict[str, np.ndarray]] = dataclasses.field(default_factory=dict)
    colored: str | None = None
    material: str | None = None

    def corner_normals(self) -> Float[np.ndarray, "F 3 3"]:
        """The stored normal at each corner; without stored normals that of the face."""
        if self.normals is not None:
            return self.normals[self.faces]
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.repeat(unit(np.cross(b - a, c - a))[:, None], 3, axis=1)


def unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """The vectors divided by their lengths. A zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def check_numbers(name: str, values: Float[np.ndarray, "n _"]) -> None:
    """Raises ValueError, with the first such row, for numbers that are not finite or too large to compute with."""
    good = (np.abs(values) <= LARGEST).all(axis=1)
    if not good.all():
        row = int(np.argmin(good))
        raise ValueError(
            f"{name}[{row}] = {values[row].tolist()} is not finite, or beyond {LARGEST:g} ({np.sum(~good)} such rows)"
        )


def check_corners(corners: Int[np.ndarray, " c"], counts: Int[np.ndarray, " n"], vertices: int) -> None:
    """Raises ValueError, with the first such face, for indices out of range. Faces have so many corners in turn."""
    outside = (corners < 0) | (corners >= vertices)
    if outside.any():
        first = int(np.argmax(outside))
        face = int(np.searchsorted(np.cumsum(counts), first, side="right"))
        raise ValueError(f"face {face} has vertex {corners[first]}, and there are {vertices}, from 0 on")


def fans(counts: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " F"]]:
    """(for every triangle the places of its corners in the list of all corners, its polygon), in the polygons' order.

    `counts` are the polygons' numbers of corners, three at least. A triangle is the first corner of its polygon and two
    neighbours. That is right for convex polygons, and the usual thing for all.
    """
    triangles = counts - 2
    polygon = np.repeat(np.arange(len(counts)), triangles)
    first = (np.cumsum(counts) - counts)[polygon]
    step = np.arange(len(polygon)) - (np.cumsum(triangles) - triangles)[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon


def split_vertices(
    columns: Sequence[Int[np.ndarray, "F 3"]],
) -> tuple[Int[np.ndarray, "F 3"], list[Int[np.ndarray, " n"]]]:
    """One index instead of several: (faces that have it, what it stands for in each column).

    A corner has an index in every column, such as position and normal; a column of -1 says nothing. New indices are in
    the order of the first column.
    """
    keys = columns[0].reshape(-1)
    for column in columns[1:]:
        if column.max() >= 0:
            _, keys = np.unique(keys * (column.max() + 1) + column.reshape(-1), return_inverse=True)
    if keys.max() > 4 * len(keys):  # a table of all keys would be large, as for one of many materials
        _, keys = np.unique(keys, return_inverse=True)
    used, corner = np.zeros(keys.max() + 1, bool), np.zeros(keys.max() + 1, np.int64)
    used[keys] = True
    corner[keys] = np.arange(len(keys))  # one of those with this key
    faces = (np.cumsum(used) - 1)[keys]
    return faces.reshape(-1, 3), [column.reshape(-1)[corner[used]] for column in columns]


def table_of(rows: Sequence[str], lines: Sequence[int], what: str, least: int, most: int) -> Float[np.ndarray, "n _"]:
    """The first `least` numbers of rows of text, which have `most` at most.

    Raises ValueError with the line of the first row that has other words, a wrong number of numbers, or one that is not
    finite or too large. `what` names such a row in the message.
    """
    found = _table(rows, least, most)
    if found is not None:
        return found
    low, high = 0, len(rows)  # the rows before `low` are good, those before `high` are not
    while high - low > 1:
        middle = (low + high) // 2
        if _table(rows[low:middle], least, most) is None:
            high = middle
        else:
            low = middle
    limit = f"{least}{f' to {most}' if most > least else ''} finite numbers up to {LARGEST:g}"
    raise ValueError(f"line {lines[low]}: {what} needs {limit}, got {shortened(rows[low])}")


def _table(rows: Sequence[str], least: int, most: int) -> Float[np.ndarray, "n _"] | None:
    """None if a row can't be read."""
    found = _even_table(rows)
    if found is not None:
        return found[:, :least] if least <= found.shape[1] <= most or not rows else None
    widths = np.array([len(row.split()) for row in rows])
    if widths.min() < least or widths.max() > most or widths.min() == widths.max():
        return None
    table = np.zeros((len(rows), least))
    for width in np.unique(widths):
        places = np.flatnonzero(widths == width)
        part = _even_table([rows[place] for place in places.tolist()])
        if part is None:
            return None
        table[places] = part[:, :least]
    return table


def _even_table(rows: Sequence[str]) -> Float[np.ndarray, "n _"] | None:
    """The numbers of rows that have equally many; None for others."""
    if not rows:
        return np.zeros((0, 3))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = np.loadtxt(rows, comments=None, ndmin=2, encoding=None)
    except (ValueError, UserWarning):
        return None
    # NumPy leaves out empty rows.
    return found if len(found) == len(rows) and (np.abs(found) <= LARGEST).all() else None
