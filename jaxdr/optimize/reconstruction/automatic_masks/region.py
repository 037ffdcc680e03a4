"""Where the object is: a ball around what the photographs show in their middle, above what it stands on."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxdr.optimize.reconstruction.hull import look
from jaxdr.optimize.reconstruction.upright import upright
from jaxdr.views.record import View
from jaxdr.views.sparse_points import SparsePoints

MIDDLE = 0.25  # of the longer side: standard deviation of the attention that a photograph pays around its middle
REACH = 1.6  # the ball's radius over the median distance of what is paid attention to
ROUNDS = 5
WITHOUT_POINTS = 0.5  # the ball's radius over what the narrowest photograph shows, where there are no points
UPRIGHT = 20.0  # degrees: what the object stands on is level up to so much
THICK = 0.05  # of the radius: points of the support are so near to its plane
SUPPORT = 0.15  # share of the points around the object that a support has at least
TRIALS = 2000
BEYOND = 1.15  # of the radius: points farther away are the background's


class Support(NamedTuple):
    """The plane that the object stands on: a point of it, and its unit normal, which points up."""

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]

    def height(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """Heights of points above it."""
        return (points - self.point) @ self.normal


class Region(NamedTuple):
    """A ball that holds the object, `up`, its `support` or None, and which of the sparse points are its own.

    `own` and `others` are disjoint; points beside the support are neither. Both are empty without points.
    """

    centre: Float[np.ndarray, "3"]
    radius: float
    up: Float[np.ndarray, "3"]
    support: Support | None
    own: Bool[np.ndarray, " N"]
    others: Bool[np.ndarray, " N"]

    @property
    def thickness(self) -> float:
        """How far points of the support may be from its plane."""
        return THICK * self.radius


def find_region(views: Sequence[View], points: SparsePoints | None, seed: int) -> Region:
    """The region of the object. Raises ValueError where the cameras look at nothing in common."""
    up = upright(views)
    if points is None:
        centre, reach = look(views)
        nothing = np.zeros(0, bool)
        return Region(centre, WITHOUT_POINTS * reach, up, None, nothing, nothing)
    attention = _attention(views, points)
    positions = points.positions
    centre = _weighted_median(positions, attention)
    radius = 0.0
    for _ in range(ROUNDS):
        distance = np.linalg.norm(positions - centre, axis=1)
        radius = REACH * float(_weighted_median(distance[:, None], attention)[0])
        near = distance < radius
        centre = _weighted_median(positions[near], attention[near])
    distance = np.linalg.norm(positions - centre, axis=1)
    support = _support(positions[distance < 1.5 * radius], centre, radius, up, seed)
    own, others = distance < radius, distance > BEYOND * radius
    if support is not None:
        height = support.height(positions)
        own, others = own & (height > 2 * THICK * radius), others | (height < THICK * radius)
    return Region(centre, radius, up, support, own, others)


def _attention(views: Sequence[View], points: SparsePoints) -> Float[np.ndarray, " N"]:
    """How much the photographs that saw a point show it in their middle."""
    total = np.zeros(len(points.positions))
    for view, saw in zip(views, points.saw, strict=True):
        x, y, depth = view.project(points.positions)
        off = (x - 0.5 * view.width) ** 2 + (y - 0.5 * view.height) ** 2
        weight = np.exp(-0.5 * off / (MIDDLE * max(view.width, view.height)) ** 2)
        total += np.where(saw & (depth > 0), weight, 0.0)
    return total


def _weighted_median(values: Float[np.ndarray, "N d"], weight: Float[np.ndarray, " N"]) -> Float[np.ndarray, " d"]:
    medians = []
    for column in values.T:
        order = np.argsort(column, kind="stable")
        total = np.cumsum(weight[order])
        medians.append(column[order][min(int(np.searchsorted(total, total[-1] / 2)), len(column) - 1)])
    return np.array(medians)


def _support(
    points: Float[np.ndarray, "N 3"],
    centre: Float[np.ndarray, "3"],
    radius: float,
    up: Float[np.ndarray, "3"],
    seed: int,
) -> Support | None:
    """The level plane below the centre with most points near it (RANSAC); None where it has few of them."""
    if len(points) < 3:
        return None
    random = np.random.default_rng(seed)
    best, most = None, 0
    for _ in range(TRIALS):
        a, b, c = points[random.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0:
            continue
        normal *= np.sign(normal @ up) / length
        if normal @ up < np.cos(np.radians(UPRIGHT)) or (centre - a) @ normal < 0:
            continue
        count = int((np.abs((points - a) @ normal) < THICK * radius).sum())
        if count > most:
            best, most = Support(a, normal), count
    return best if most >= SUPPORT * len(points) else None
