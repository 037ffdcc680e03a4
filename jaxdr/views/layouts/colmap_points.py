"""The table `points3D` of a COLMAP model, text and binary (colmap.github.io/format.html)."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxdr.untrusted import damage, finite, text_of
from jaxdr.views.layouts.colmap_tables import ANEW, Bytes, number_of, whole_of

POINT, ELEMENT = 51, 8  # fewest bytes of a point, bytes of an element of its track


class Points(NamedTuple):
    """Sparse points: `positions`, and of every observation the row of its point and the id of its image."""

    positions: Float[np.ndarray, "N 3"]
    rows: Int[np.ndarray, " M"]
    images: Int[np.ndarray, " M"]


def read_points(model: Path) -> Points | None:
    """The points of a model; None where it has none. Raises ValueError, with the file and the place, for damage."""
    for name, read in (("points3D.bin", _binary), ("points3D.txt", _text)):
        if (model / name).is_file():
            rows = list(read(model / name))
            if not rows:
                return None
            counts = [len(images) for _, images in rows]
            return Points(
                np.array([position for position, _ in rows], float),
                np.repeat(np.arange(len(rows)), counts),
                np.concatenate([np.asarray(images, np.int64) for _, images in rows]),
            )
    return None


def _binary(path: Path) -> list[tuple[list[float], np.ndarray]]:
    file = Bytes(path)

    def read(where: str) -> tuple[int, tuple[list[float], np.ndarray]]:
        number, *position = file.take("Q3d", where)
        file.skip(11, where)  # colour and error
        (length,) = file.take("Q", where)
        start = file.skip(length * ELEMENT, f"{where}: its track of {length}")
        images = np.frombuffer(file.data, np.uint32, 2 * length, start)[::2]
        return number, ([finite(value, f"{path}: {where}") for value in position], images)

    return list(file.rows(POINT, "point", read).values())


def _text(path: Path) -> Iterator[tuple[list[float], np.ndarray]]:
    for number, line in enumerate(text_of(path).split("\n"), 1):
        words, where = line.split(), f"{path}: line {number}"
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 8 or len(words) % 2:
            raise ValueError(f"{where}: a point needs an id, a position, a colour, an error and a track; {ANEW}")
        position = [finite(number_of(word, where), where) for word in words[1:4]]
        with damage(where):
            yield position, np.array([whole_of(word, where) for word in words[8::2]], np.int64)
