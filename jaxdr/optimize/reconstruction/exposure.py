"""Exposures of photographs before the first step: from EXIF, or from the colours that they show of the same points."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.paint import shown_colors
from jaxdr.optimize.reconstruction.pictures import Photographs
from jaxdr.views.photographs import EXIF
from jaxdr.views.record import View

DIFFER = 0.04  # standard deviation of logarithms: shading makes half of it, photographs that differ make more
POINTS = 1000  # of the surface: medians over more of them change little
DARKEST, BRIGHTEST = 0.01, 0.99  # linear; what is darker is noise, what is brighter is clipped
ROUNDS = 30
TIME, FNUMBER, ISO = 33434, 33437, 34855  # of EXIF


def told_exposures(views: Sequence[View]) -> Float[np.ndarray, " N"] | None:
    """Logarithms of time times sensitivity over squared f-number, of mean zero; None unless every file tells them."""
    told = [_told(view) for view in views]
    values = np.array([value for value in told if value is not None])
    return values - values.mean() if len(values) == len(told) else None


def _told(view: View) -> float | None:
    if not view.path.is_file():  # pixels in memory
        return None
    try:
        with Image.open(view.path) as image:
            table = image.getexif().get_ifd(EXIF)
            time, number, speed = (float(table[tag]) for tag in (TIME, FNUMBER, ISO))
    except (OSError, KeyError, ValueError, TypeError, ZeroDivisionError, SyntaxError):
        return None  # no picture for Pillow, or tables that lack a number
    positive = min(time, number, speed) > 0 and np.isfinite([time, number, speed]).all()
    return float(np.log(time * speed / number**2)) if positive else None


def seen_exposures(mesh: Mesh, photographs: Photographs) -> Float[np.ndarray, "N 3"]:
    """Logarithms of how much brighter each photograph shows points of the surface than the others do, of mean zero.

    Medians over points of ratios to medians over photographs: highlights and wrong parts of the surface are in the
    minority. A photograph that shares no point with others gets zero.
    """
    every = -(-len(mesh.vertices) // POINTS)
    mesh = mesh.smooth()
    points, normals = (np.asarray(a, float)[::every] for a in (mesh.vertices, mesh.vertex_normals()))
    colors = shown_colors(mesh, points, normals, photographs)
    useful = (colors.min(-1) > DARKEST) & (colors.max(-1) < BRIGHTEST)  # False for NaN
    useful &= useful.sum(0) >= 2
    logarithms = np.ma.masked_array(
        np.log(np.where(useful[..., None], colors, 1.0)), np.broadcast_to(~useful[..., None], colors.shape)
    )
    found = np.zeros((len(photographs), 3))
    for _ in range(ROUNDS):
        left = logarithms - found[:, None]
        found += np.ma.median(left - np.ma.median(left, axis=0), axis=1).filled(0.0)
        found -= found.mean(0)
    return found


def spread(exposures: Float[np.ndarray, "N *C"]) -> float:
    """Standard deviation of the exposures of photographs, of their mean colour."""
    return float((exposures.mean(-1) if exposures.ndim == 2 else exposures).std())


def first_exposures(mesh: Mesh | None, photographs: Photographs) -> tuple[Float[np.ndarray, "N 3"], str]:
    """(exposures to begin with, what was found, for people). Zero where photographs agree.

    Without a first `mesh` of the object EXIF alone tells. With one, the colours tell whether photographs differ. Then
    EXIF is the start where it explains a part of that, else the colours are.
    """
    told = told_exposures(photographs.views)
    if mesh is None:
        if told is None or spread(told) < DIFFER:
            return np.zeros((len(photographs), 3)), ""
        return np.repeat(told[:, None], 3, 1), f"EXIF says that exposures differ by {spread(told):.0%}"
    seen = seen_exposures(mesh, photographs)
    differ = f"photographs differ in exposure by {spread(seen):.0%}"
    if spread(seen) < DIFFER:
        return np.zeros_like(seen), ""
    if told is not None and spread(seen.mean(1) - told) < spread(seen):
        return np.repeat(told[:, None], 3, 1), f"{differ}, and EXIF by {spread(told):.0%}"
    return seen, differ
