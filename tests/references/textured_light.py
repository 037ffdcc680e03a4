"""Radiance of a diffuse point under a level rectangular light whose radiance varies, behind a level rectangle.

The shadow of the rectangle on the light is a rectangle, so between the lines where anything jumps or folds all is
smooth, and Gauss-Legendre quadrature has it to ten digits. Nothing here comes from jaxdr: numpy, float64.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(12)


class Level(NamedTuple):
    """A rectangle across the z axis."""

    x0: float
    y0: float
    x1: float
    y1: float
    z: float


class Texture(NamedTuple):
    """Radiance = `basis` @ values: functions [N, K] of the shares s, t in [0, 1] of the way along x and y.

    `folds` are the shares along x and y at which they are not smooth.
    """

    basis: Callable
    folds: tuple[np.ndarray, np.ndarray]


def bilinear(height: int, width: int) -> Texture:
    """Pixels [H, W], row 0 at t = 1, interpolated between their centres and constant beyond the outer ones."""

    def hats(share, count):
        """Values of every pixel's function along one axis."""
        x = np.clip(share * count - 0.5, 0, count - 1)
        return np.maximum(1 - np.abs(x[:, None] - np.arange(count)), 0)

    def basis(s, t):
        return (hats(1 - t, height)[:, :, None] * hats(s, width)[:, None]).reshape(-1, height * width)

    return Texture(basis, tuple((np.arange(n) + 0.5) / n for n in (width, height)))


def two_triangles() -> Texture:
    """Values at the corners (0, 0), (0, 1), (1, 1), (1, 0), interpolated on both sides of the diagonal s = t."""

    def basis(s, t):
        zero = np.zeros_like(s)
        above, below = (1 - t, t - s, s, zero), (1 - s, zero, t, s - t)
        return np.where((t > s)[:, None], np.stack(above, 1), np.stack(below, 1))

    fine = np.linspace(0, 1, 41)  # the diagonal is not on the grid: cells small enough
    return Texture(basis, (fine, fine))


def texel_irradiances(point, light: Level, blocker: Level, texture: Texture) -> np.ndarray:
    """Irradiance [K] at a point with its normal along z that each value of the light's texture accounts for."""
    point = np.asarray(point, float)
    rise = light.z - point[2]
    along = rise / (blocker.z - point[2])
    shadow = [point[:2] + along * (np.array(corner) - point[:2]) for corner in (blocker[:2], blocker[2:4])]
    axes = []
    for axis in (0, 1):
        low, high = light[axis], light[axis + 2]
        cuts = [low + (high - low) * texture.folds[axis], [low, high], [corner[axis] for corner in shadow]]
        cuts = np.unique(np.clip(np.concatenate(cuts), low, high))
        half = np.diff(cuts) / 2
        x = (cuts[:-1] + half)[:, None] + half[:, None] * NODES
        hidden = (x > shadow[0][axis]) & (x < shadow[1][axis])
        axes.append((x.ravel(), (half[:, None] * WEIGHTS).ravel(), hidden.ravel(), (x.ravel() - low) / (high - low)))
    (x, dx, hidden_x, s), (y, dy, hidden_y, t) = axes
    x, y = x[:, None] - point[0], y[None] - point[1]
    kernel = rise**2 / (x**2 + y**2 + rise**2) ** 2 * dx[:, None] * dy
    kernel[hidden_x[:, None] & hidden_y] = 0.0
    s, t = np.broadcast_to(s[:, None], kernel.shape), np.broadcast_to(t, kernel.shape)
    return kernel.ravel() @ texture.basis(s.ravel(), t.ravel())
