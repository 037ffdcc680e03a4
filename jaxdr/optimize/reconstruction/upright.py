"""Which way is up, and cameras on a circle around it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxdr.scene.camera import look_at
from jaxdr.views.record import View, common_point

LEVEL = 0.1  # mean square of the sines of the film's tilt up to which cameras count as level
ABOVE = 0.34  # sine of the height of the circle's cameras, seen from its middle


def upright(views: Sequence[View]) -> Float[np.ndarray, "3"]:
    """The direction that is up: people hold cameras level, so one of two axes of the film is horizontal in all views.

    That of the rows, or that of the columns where pictures are stored on their side. There up is where most cameras
    are, seen from what they look at. Of cameras that are not level, it is the mean of what is up in their pictures.
    """
    poses = np.stack([view.to_world for view in views])
    mean = poses[:, :3, 1].mean(0)
    (tilt, up), (other, aside) = (_least_along(poses[:, :3, axis]) for axis in (0, 1))
    if len(views) < 3 or min(tilt, other) > LEVEL:
        length = np.linalg.norm(mean)
        return mean / length if length > 1e-6 else poses[0, :3, 1]
    if tilt <= other:
        return up * (1.0 if up @ mean >= 0 else -1.0)
    above = (poses[:, :3, 3] - common_point(poses)).mean(0)
    return aside * (1.0 if aside @ above >= 0 else -1.0)


def circle(
    up: Float[np.ndarray, "3"], centre: Float[np.ndarray, "3"], distance: float, count: int
) -> list[Float[np.ndarray, "4 4"]]:
    """Poses (camera to world) that look at a point from all around it, from a little above."""
    axis = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0, 1.0, 0])
    first = axis - (axis @ up) * up
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    poses = []
    for angle in 2 * np.pi * np.arange(count) / count:
        level = np.cos(angle) * first + np.sin(angle) * second
        offset = distance * (np.sqrt(1 - ABOVE**2) * level + ABOVE * up)
        poses.append(look_at(centre + offset, centre, up))
    return poses


def _least_along(axes: Float[np.ndarray, "N 3"]) -> tuple[float, Float[np.ndarray, "3"]]:
    """(mean square of the components along the direction that has least of them, this direction)."""
    values, vectors = np.linalg.eigh(axes.T @ axes / len(axes))
    return float(values[0]), vectors[:, 0]
