"""The object in one photograph: cut out by its colours, from what is known for certain (GrabCut)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8

from jaxdr.images import to_srgb
from jaxdr.optimize.reconstruction.automatic_masks.region import Region
from jaxdr.optimize.reconstruction.opencv import require_cv2
from jaxdr.views.record import View
from jaxdr.views.sparse_points import SparsePoints

ROUNDS = 4  # of GrabCut: colours of both sides, then the cheapest border between them
MARK = 0.006  # of the longer side: radius of what a sparse point marks
FEW = 10  # pixels of each side that colours need
BALL = 1.3  # of the region's radius: what lies outside is not the object

# GrabCut's names of pixels.
OTHER, OWN, MAYBE_OTHER, MAYBE_OWN = range(4)


class Guess(NamedTuple):
    """What is thought of a photograph: where the object may be, where it is `likely`, and where it is for `certain`."""

    possible: Bool[np.ndarray, "H W"]
    likely: Bool[np.ndarray, "H W"]
    certain: Bool[np.ndarray, "H W"]


def first_guess(view: View, region: Region, points: SparsePoints | None) -> Guess:
    """The object is within the ball, and likely in the convex hull of its points, or in a smaller ball."""
    possible = _ball(view, region, BALL)
    likely = _ball(view, region, 1.0) if points is None else _convex(view, points.positions[region.own])
    return Guess(possible, likely & possible, np.zeros_like(possible))


def cut_out(
    view: View, guess: Guess, region: Region, points: SparsePoints | None, saw: Bool[np.ndarray, " N"]
) -> Bool[np.ndarray, "H W"]:
    """Where the object is. Points that the photograph `saw` mark it and what is not it."""
    cv2 = require_cv2()
    marks = np.full(guess.possible.shape, MAYBE_OTHER, np.uint8)
    marks[guess.likely] = MAYBE_OWN
    marks[~guess.possible] = OTHER
    if points is not None:
        for chosen, mark in ((region.others, OTHER), (region.own, OWN)):
            _mark(marks, view, points.positions[chosen & saw], mark)
    marks[guess.certain] = OWN
    own = (marks == OWN) | (marks == MAYBE_OWN)
    if own.sum() < FEW or (~own).sum() < FEW:
        return own
    colors = np.ascontiguousarray(to_srgb(view.image)[..., ::-1])
    window = _window(guess.possible)
    cut = np.ascontiguousarray(marks[window])
    cv2.setRNGSeed(0)  # of this thread: it draws where the colours of both sides start
    colors, models = np.ascontiguousarray(colors[window]), (np.zeros((1, 65)), np.zeros((1, 65)))
    cv2.grabCut(colors, cut, (0, 0, 0, 0), *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
    found = np.zeros_like(own)
    found[window] = (cut == OWN) | (cut == MAYBE_OWN)
    return found


def _ball(view: View, region: Region, share: float) -> Bool[np.ndarray, "H W"]:
    """Pixels whose rays meet the ball, made larger by `share`."""
    centre = (region.centre - view.to_world[:3, 3]) @ view.to_world[:3, :3]
    y, x = np.mgrid[0 : view.height, 0 : view.width] + 0.5
    rays = np.stack([(view.centre[0] - x) / view.focal, (view.centre[1] - y) / view.focal, np.ones_like(x)], -1)
    along = rays @ centre / np.linalg.norm(rays, axis=-1)
    beside = centre @ centre - along**2
    radius = share * region.radius
    return (beside < radius**2) & ((along > 0) | (centre @ centre < radius**2))


def _convex(view: View, points: np.ndarray) -> Bool[np.ndarray, "H W"]:
    """The convex hull of points, as the photograph sees it."""
    cv2 = require_cv2()
    made = np.zeros((view.height, view.width), np.uint8)
    x, y, depth = view.project(points)
    ahead = depth > 0
    if ahead.sum() >= 3:
        corners = np.clip(np.stack([x[ahead], y[ahead]], -1), -1e4, 1e4).astype(np.float32)
        cv2.fillConvexPoly(made, cv2.convexHull(corners).astype(np.int32), 1)
    return made > 0


def _mark(marks: UInt8[np.ndarray, "H W"], view: View, points: np.ndarray, mark: int) -> None:
    cv2 = require_cv2()
    framed, rows, columns = view.pixels(points)
    radius = max(1, round(MARK * max(view.width, view.height)))
    for column, row in zip(columns[framed], rows[framed], strict=True):
        cv2.circle(marks, (int(column), int(row)), radius, mark, -1)


def _window(possible: Bool[np.ndarray, "H W"]) -> tuple[slice, slice]:
    """Rows and columns of what is possible, twice as large: colours of the background come from around the object."""
    bounds = []
    for axis in (1, 0):
        there = np.flatnonzero(possible.any(axis))
        low, high = (int(there[0]), int(there[-1]) + 1) if len(there) else (0, possible.shape[1 - axis])
        margin = (high - low) // 2
        bounds.append(slice(max(0, low - margin), min(possible.shape[1 - axis], high + margin)))
    return bounds[0], bounds[1]
