"""Points of the object from pairs of photographs: dense stereo (OpenCV), kept where several pairs agree."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.images import to_srgb
from jaxdr.optimize.reconstruction.evenly import evenly
from jaxdr.optimize.reconstruction.opencv import require_cv2
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.views.reading import read_ahead
from jaxdr.views.record import View, in_mask

NARROW, BEST, WIDE = 4.0, 10.0, 22.0  # degrees between two photographs of a pair, seen from the object
UNLIKE = 1.5  # ratio of the distances from which both photographs are taken, at most
PARTNERS, PAIRS = 3, 240  # of one photograph, and in all
SIDE = 520  # pixels along a rectified photograph at most
DEPTHS = 256  # disparities that are compared at most
BLOCK = 5  # pixels along the squares that are compared
EVEN = 0.1  # of the smoothness that OpenCV advises: all of it flattens round things by a third of a pixel
FROM_PAIR = 3000  # points of a pair that are kept
NEAR = 0.008  # of the longest side: points that agree are so near
NEIGHBOURS, AGREE = 12, 3  # of a point: so many are looked at, and so many of other pairs have to agree
PART = 16  # OpenCV's disparities are in so many parts of a pixel


class Pair(NamedTuple):
    """Two photographs turned to a common frame (rows: right, down, forward), in which they differ along x alone.

    Both have the focal length `focal` and `side` pixels along both sides, with the object's middle in theirs. `base`:
    how far apart they are. `depth`: of the object's middle.
    """

    frame: Float[np.ndarray, "3 3"]
    base: float
    depth: float
    focal: float
    side: int


def stereo_points(
    views: Sequence[View], pose: Pose, radius: float
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """(places of cameras, points of the object that they see), in the world; empty where photographs are far apart.

    `views` are masked; `pose` is where the object is, and `radius` that of a ball around its middle that holds it. The
    same photographs give the same bits. Raises ImportError without OpenCV.
    """
    from scipy.spatial import KDTree

    require_cv2()
    chosen = pairs_of(views, pose)
    found = list(read_ahead(lambda pair: _points_of(views[pair[0]], views[pair[1]], pose, radius), chosen))
    points = np.concatenate([np.zeros((0, 3)), *found])
    number = np.repeat(np.arange(len(found)), [len(each) for each in found])
    if len(points) <= NEIGHBOURS:
        return np.zeros((0, 3)), np.zeros((0, 3))
    distance, nearest = KDTree(points).query(points, NEIGHBOURS, distance_upper_bound=NEAR * pose.scale)
    others = np.isfinite(distance) & (number[np.minimum(nearest, len(points) - 1)] != number[:, None])
    agreed = others.sum(1) >= AGREE
    places = np.array([views[pair[0]].to_world[:3, 3] for pair in chosen]).reshape(-1, 3)
    return places[number[agreed]], points[agreed]


def pairs_of(views: Sequence[View], pose: Pose) -> list[tuple[int, int]]:
    """Photographs whose directions differ enough to tell depth, and so little that they look alike."""
    away = np.stack([view.to_world[:3, 3] - pose.centre for view in views])
    distance = np.linalg.norm(away, axis=1)
    away /= distance[:, None]
    angle = np.degrees(np.arccos(np.clip(away @ away.T, -1, 1)))
    ratio = distance[:, None] / distance
    useful = (angle > NARROW) & (angle < WIDE) & (ratio < UNLIKE) & (ratio > 1 / UNLIKE)
    chosen = []
    for number, row in enumerate(useful):
        partners = np.flatnonzero(row)
        order = np.argsort(np.abs(angle[number, partners] - BEST), kind="stable")
        chosen += [(number, int(partner)) for partner in partners[order][:PARTNERS]]
    return [chosen[i] for i in evenly(len(chosen), PAIRS)]


def _points_of(one: View, other: View, pose: Pose, radius: float) -> Float[np.ndarray, "n 3"]:
    """Points that the first photograph sees, in the world; none where the pair can't be compared."""
    nothing = np.zeros((0, 3))
    pair = rectified(one, other, pose, radius)
    if pair is None:
        return nothing
    cv2 = require_cv2()
    lowest, highest = (pair.focal * pair.base * (1 / (pair.depth + far) - 1 / pair.depth) for far in (radius, -radius))
    lowest, count = int(np.floor(lowest)) - 1, int(np.ceil((highest - lowest + 3) / 16)) * 16
    if count > DEPTHS:
        return nothing
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=BLOCK,
        P1=round(EVEN * 8 * 3 * BLOCK**2),
        P2=round(EVEN * 32 * 3 * BLOCK**2),
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=10,
        speckleWindowSize=50,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    maps = [_to_rectified(view, pair, pose) for view in (one, other)]
    size = (pair.side, pair.side)
    margin = count + abs(lowest)  # OpenCV knows no disparity so near to the left border
    left, right = (
        cv2.copyMakeBorder(
            cv2.warpPerspective(to_srgb(view.image), change, size, flags=cv2.INTER_LINEAR), 0, 0, margin, margin, 0
        )
        for view, change in zip((one, other), maps, strict=True)
    )
    disparity = matcher.compute(left, right).astype(float)[:, margin:-margin] / PART
    mask = cv2.warpPerspective((np.asarray(one.alpha) > 0.5).astype(np.uint8), maps[0], size, flags=cv2.INTER_NEAREST)
    y, x = np.nonzero((disparity >= lowest) & (mask > 0))
    some = evenly(len(y), FROM_PAIR)
    y, x = y[some], x[some]
    middle = pair.frame @ (pose.centre - one.to_world[:3, 3])
    depth = pair.focal * pair.base / (disparity[y, x] + pair.focal * pair.base / pair.depth)
    across = (np.stack([x, y], -1) + 0.5 - pair.side / 2) / pair.focal + middle[:2] / middle[2]
    points = np.concatenate([across * depth[:, None], depth[:, None]], 1) @ pair.frame + one.to_world[:3, 3]
    return points[in_mask(other, points)]


def rectified(one: View, other: View, pose: Pose, radius: float) -> Pair | None:
    """The common frame of two photographs; None where one is too near to the object, or ahead of the other."""
    base = other.to_world[:3, 3] - one.to_world[:3, 3]
    length = float(np.linalg.norm(base))
    right = base / length
    forward = one.to_world[:3, 2] + other.to_world[:3, 2]
    forward = forward - (forward @ right) * right
    size = np.linalg.norm(forward)
    if size < 0.5:
        return None
    forward /= size
    frame = np.stack([right, np.cross(forward, right), forward])
    depth = float(forward @ (pose.centre - one.to_world[:3, 3]))
    if depth < 1.3 * radius:
        return None
    distances = [np.linalg.norm(view.to_world[:3, 3] - pose.centre) for view in (one, other)]
    focal = float(np.mean([view.focal * far for view, far in zip((one, other), distances, strict=True)]) / depth)
    side = 2 * int(np.ceil(focal * radius / (depth - radius)) + BLOCK)
    return Pair(frame, length, depth, focal * min(1.0, SIDE / side), min(SIDE, side))


def _to_rectified(view: View, pair: Pair, pose: Pose) -> Float[np.ndarray, "3 3"]:
    """The map from pixels of a photograph to those of its rectified one; both count from the middle of the first."""
    own = np.stack([-view.to_world[:3, 0], -view.to_world[:3, 1], view.to_world[:3, 2]])
    middle = pair.frame @ (pose.centre - view.to_world[:3, 3])
    there = np.array(
        [
            [pair.focal, 0, pair.side / 2 - 0.5 - pair.focal * middle[0] / middle[2]],
            [0, pair.focal, pair.side / 2 - 0.5 - pair.focal * middle[1] / middle[2]],
            [0, 0, 1],
        ]
    )
    here = np.array([[view.focal, 0, view.centre[0] - 0.5], [0, view.focal, view.centre[1] - 0.5], [0, 0, 1]])
    return there @ pair.frame @ own.T @ np.linalg.inv(here)
