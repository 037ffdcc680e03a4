"""Photographs as a level needs them: reduced, cut to one size around the object, cameras to go with them."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.views.record import View
from jaxdr.views.rendering import Pinhole

MARGIN = 0.03  # of the longer side of the window, around the object
MULTIPLE = 8  # pixels: what the sides of a window are multiples of


class Pose(NamedTuple):
    """Where the object is in the world of the cameras: `centre`, and the `scale` of its longest side."""

    centre: Float[np.ndarray, "3"]
    scale: float

    def moved(self, to_world: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """The pose of a camera in the frame of the object, where its longest side is 1."""
        moved = np.array(to_world, float)
        moved[:3, 3] = (moved[:3, 3] - self.centre) / self.scale
        return moved


class Cut(NamedTuple):
    """A photograph of a level: `color` linear, over black where there is `alpha`, and its camera.

    `trust`: share of a pixel whose colour is the object's or black for certain. Pixels at the border of a mask show
    both the object and what is behind it.
    """

    color: Float[np.ndarray, "H W 3"]
    alpha: Float[np.ndarray, "H W"] | None
    trust: Float[np.ndarray, "H W"]
    camera: Pinhole


def cuts(views: Sequence[View], pose: Pose, resolution: int) -> list[Cut]:
    """The photographs reduced to `resolution` pixels along their longer side, and cut to one size around the object.

    Without masks nothing is cut off. Light is averaged over the area of the new pixels.
    """
    reduced = [_reduced(view, resolution) for view in views]
    height, width = _window_size([alpha for _, alpha, _, _ in reduced], reduced[0][0].shape[:2])
    made = []
    for view, (color, alpha, trust, scale) in zip(views, reduced, strict=True):
        x0, y0 = (0, 0) if alpha is None else _corner(alpha, width, height)
        window = np.s_[y0 : y0 + height, x0 : x0 + width]
        focal = view.focal * scale[0]
        centre = view.centre[0] * scale[0] - x0, view.centre[1] * scale[1] - y0
        fov = np.degrees(2 * np.arctan(0.5 * width / focal))
        axis = (0.5 - centre[0] / width, 0.5 - centre[1] / height)
        camera = Pinhole(*(jnp.asarray(x, float) for x in (pose.moved(view.to_world), fov, axis)))
        made.append(Cut(color[window], None if alpha is None else alpha[window], trust[window], camera))
    return made


def _reduced(view: View, resolution: int):
    """(colours over black, alpha, trust, (pixels along x and y a pixel of the photograph))."""
    share = min(1.0, resolution / max(view.width, view.height))
    size = max(1, round(view.width * share)), max(1, round(view.height * share))
    color = _averaged(view.over_black, size)
    alpha = None if view.alpha is None else _averaged(view.alpha[..., None], size)[..., 0]
    trust = _averaged(_trust(view)[..., None], size)[..., 0]
    return color, alpha, trust, (size[0] / view.width, size[1] / view.height)


def _trust(view: View) -> Float[np.ndarray, "H W"]:
    """0 beside the border of a mask, else 1."""
    if view.alpha is None or not view.backdrop:
        return np.ones((view.height, view.width), np.float32)
    from scipy.ndimage import maximum_filter, minimum_filter

    same = maximum_filter(view.alpha, 3) == minimum_filter(view.alpha, 3)
    return same.astype(np.float32)


def _averaged(pixels: Float[np.ndarray, "H W C"], size: tuple[int, int]) -> Float[np.ndarray, "h w C"]:
    if size == (pixels.shape[1], pixels.shape[0]):
        return pixels
    channels = [Image.fromarray(np.ascontiguousarray(pixels[..., c])) for c in range(pixels.shape[2])]
    return np.stack([np.asarray(channel.resize(size, Image.Resampling.BOX)) for channel in channels], -1)


def _bounds(alpha: Float[np.ndarray, "H W"]) -> tuple[int, int, int, int]:
    """(x0, y0, x1, y1) of the object."""
    rows, columns = np.flatnonzero((alpha > 0.1).any(1)), np.flatnonzero((alpha > 0.1).any(0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _window_size(alphas, full: tuple[int, int]) -> tuple[int, int]:
    """(height, width) of a window that holds the object of every photograph, with a margin."""
    if any(alpha is None for alpha in alphas):
        return full
    boxes = [_bounds(alpha) for alpha in alphas]
    sides = max(b[3] - b[1] for b in boxes), max(b[2] - b[0] for b in boxes)
    margin = 2 * round(MARGIN * max(sides)) + 4
    height, width = (
        min(-(-(side + margin) // MULTIPLE) * MULTIPLE, all) for side, all in zip(sides, full, strict=True)
    )
    return height, width


def _corner(alpha, width: int, height: int) -> tuple[int, int]:
    """Upper left corner of the window around the object."""
    x0, y0, x1, y1 = _bounds(alpha)
    x, y = (x0 + x1 - width) // 2, (y0 + y1 - height) // 2
    return int(np.clip(x, 0, alpha.shape[1] - width)), int(np.clip(y, 0, alpha.shape[0] - height))
