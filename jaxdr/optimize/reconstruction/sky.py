"""The light as the optimisation has it: logarithms of a map of directions, and what photographs show of it."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.scene.environment_map import EnvironmentMap
from jaxdr.views.reading import read_ahead
from jaxdr.views.record import View

# The map's frame has y up; the world z, as in the data sets that people have. Only where the poles lie depends on it.
TO_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
DARKEST = 1e-3  # radiance that counts: logarithms need one
WHITE = 0.99  # photographs are clipped from here on
AGREE = 0.5  # share of the variance of the backgrounds that a map of directions must explain to count
ENOUGH = 4  # pixels that must show a direction


class Backdrop(NamedTuple):
    """What photographs show of the sky: `radiance` [H, W, 3], how far each texel is to be believed (`weight` [H, W]),
    and where it is clipped, a lower bound alone (`clipped` [H, W])."""

    radiance: Float[np.ndarray, "H W 3"]
    weight: Float[np.ndarray, "H W"]
    clipped: Float[np.ndarray, "H W"]


def environment(logarithms: Float[Array, "H W 3"]) -> EnvironmentMap:
    """The light, which can't be negative."""
    return EnvironmentMap(jnp.exp(logarithms), TO_WORLD)


def resampled(logarithms: Float[np.ndarray, "h w 3"], rows: int) -> Float[np.ndarray, "H W 3"]:
    """A map with so many rows, and twice as many columns less two; bilinear."""
    columns = columns_of(rows)
    old_rows, old_columns = logarithms.shape[:2]
    y = np.linspace(0, old_rows - 1, rows)
    x = (np.arange(columns) + 0.5) / columns * old_columns - 0.5
    top, left = np.minimum(y.astype(int), old_rows - 2), np.floor(x).astype(int)
    down, along = (y - top)[:, None, None], (x - left)[None, :, None]
    first, second = left % old_columns, (left + 1) % old_columns
    upper = (1 - along) * logarithms[top][:, first] + along * logarithms[top][:, second]
    lower = (1 - along) * logarithms[top + 1][:, first] + along * logarithms[top + 1][:, second]
    return ((1 - down) * upper + down * lower).astype(logarithms.dtype)


def columns_of(rows: int) -> int:
    """Columns of a map with so many rows: texels are about square at the equator."""
    return 2 * (rows - 1)


def solid_angles(rows: int) -> Float[np.ndarray, "H 1"]:
    """Share of the sphere of the texels of every row; that of one column."""
    edges = np.clip(np.pi * (np.arange(rows + 1) - 0.5) / (rows - 1), 0, np.pi)
    return ((np.cos(edges[:-1]) - np.cos(edges[1:])) / 2 / columns_of(rows))[:, None]


def directions(rows: int) -> Float[np.ndarray, "H W 3"]:
    """Unit directions of the texels, in the frame of the map."""
    theta = np.pi * np.arange(rows)[:, None] / (rows - 1)
    phi = 2 * np.pi * (np.arange(columns_of(rows))[None, :] + 0.5) / columns_of(rows)
    height = np.broadcast_to(np.cos(theta), (rows, columns_of(rows)))
    return np.stack([np.sin(theta) * np.sin(phi), height, -np.sin(theta) * np.cos(phi)], -1)


def find_backdrop(
    views: Sequence[View], rows: int, exposure: Float[np.ndarray, "N 3"] | None = None
) -> Backdrop | None:
    """The sky behind the object in photographs that show it; None where they do not, or do not agree about it.

    Colours are divided by the exposures, which are given as logarithms.

    Something near looks different in the same direction from other places. So the mean of every direction has to
    explain at least half of what varies between directions, over directions that several photographs show.
    """
    if not all(view.masked and view.backdrop for view in views):
        return None
    count = rows * columns_of(rows)
    columns = columns_of(rows)
    factors = np.ones((len(views), 3)) if exposure is None else np.exp(exposure)
    total, number, clipped = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    backgrounds = read_ahead(lambda view: _background(view, rows, columns), views)
    for (texel, colors), factor in zip(backgrounds, factors, strict=True):
        for channel in range(3):
            total[:, channel] += np.bincount(texel, colors[:, channel] / factor[channel], count)
        number += np.bincount(texel, minlength=count)
        clipped += np.bincount(texel, colors.max(1) >= WHITE, count)
    seen = number >= ENOUGH
    if not seen.any():
        return None
    # The same for each photograph's own mean of a texel, so that texture finer than a texel does not count.
    if _explained(views, rows, columns, factors) < AGREE:
        return None
    mean = total / np.maximum(number, 1)[:, None]
    shape = (rows, columns)
    return Backdrop(
        mean.reshape(*shape, 3),
        seen.astype(float).reshape(shape),
        (clipped > 0.5 * np.maximum(number, 1)).astype(float).reshape(shape),
    )


def _background(view: View, rows: int, columns: int):
    """(texel, colour) of the pixels behind the object."""
    image, alpha = view.picture.read()
    y, x = np.nonzero(alpha < 0.01)
    local = np.stack(
        [
            (view.centre[0] - x - 0.5) / view.focal,
            (view.centre[1] - y - 0.5) / view.focal,
            np.ones(len(x)),
        ],
        -1,
    )
    direction = local @ view.to_world[:3, :3].T @ TO_WORLD[:3, :3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    turns = np.arctan2(direction[:, 0], -direction[:, 2]) / (2 * np.pi)
    row = np.round(np.arccos(np.clip(direction[:, 1], -1, 1)) / np.pi * (rows - 1)).astype(int)
    column = np.floor(turns * columns).astype(int) % columns
    return row * columns + column, image[y, x].astype(float)


def _explained(views: Sequence[View], rows: int, columns: int, factors: Float[np.ndarray, "N 3"]) -> float:
    """Share of the variance of the photographs' means of texels that the mean over photographs explains."""
    count = rows * columns
    means = np.full((len(views), count), np.nan)
    backgrounds = read_ahead(lambda view: _background(view, rows, columns), views)
    for i, (texel, colors) in enumerate(backgrounds):
        number = np.bincount(texel, minlength=count)
        logarithms = np.log(np.maximum(colors / factors[i], DARKEST)).mean(1)
        enough = number >= ENOUGH
        means[i, enough] = np.bincount(texel, logarithms, count)[enough] / number[enough]
    several = np.isfinite(means).sum(0) >= 2
    if several.sum() < 2:
        return 0.0
    means = means[:, several]
    within = np.nanmean((means - np.nanmean(means, 0)) ** 2)
    total = np.nanmean((means - np.nanmean(means)) ** 2)
    return float(1 - within / total) if total > 0 else 0.0
