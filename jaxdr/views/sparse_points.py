"""Sparse points of the scene, found with the cameras, and the photographs that saw them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxdr.views.layouts import colmap, transforms
from jaxdr.views.layouts.colmap_points import read_points
from jaxdr.views.layouts.colmap_tables import read_tables
from jaxdr.views.record import Views

OBSERVED = 3  # photographs: points that fewer of them saw are often wrong


class SparsePoints(NamedTuple):
    """`positions` in the world of the cameras, and whether each of the views `saw` a point."""

    positions: Float[np.ndarray, "N 3"]
    saw: Bool[np.ndarray, "V N"]


def sparse_points(views: Views) -> SparsePoints | None:
    """The points of a COLMAP model that three of its photographs or more saw; None where a folder has none.

    Raises ValueError, with the file and the place, for damaged tables.
    """
    model = colmap.find_model(views.folder)
    if model is None or transforms.files(views.folder):  # their world may be another one
        return None
    points = read_points(model)
    if points is None:
        return None
    _, images = read_tables(model)
    base = colmap.pictures_of(views.folder)
    number = {(base / image.name): key for key, image in images.items()}
    saw = np.zeros((len(views.views), len(points.positions)), bool)
    for row, view in enumerate(views.views):
        if (key := number.get(view.path)) is not None:
            saw[row, points.rows[points.images == key]] = True
    often = np.bincount(points.rows, minlength=len(points.positions)) >= OBSERVED
    return SparsePoints(points.positions[often], saw[:, often]) if often.any() else None
