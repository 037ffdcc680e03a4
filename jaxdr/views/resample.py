"""From the pixels of a file to those of a pinhole with square pixels: turned, reduced, without distortion."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from jaxdr.image_formats import png
from jaxdr.images import ENCODED
from jaxdr.views.area import area_mean
from jaxdr.views.lens import SQUARE, Lens, Pinhole

BLOCK = 1 << 18  # pixels that are projected at once
UPRIGHT = 1
ASIDE = (5, 6, 7, 8)  # EXIF's orientations that swap width and height
# What is done to the pixels of a file for each orientation: (transposed, rows from below, columns from the right).
TURNS = {
    **{1: (False, False, False), 2: (False, False, True), 3: (False, True, True), 4: (False, True, False)},
    **{5: (True, False, False), 6: (True, False, True), 7: (True, True, True), 8: (True, True, False)},
}
UNDONE = {6: 8, 8: 6}  # the others undo themselves


def orientation(path: Path) -> int:
    """EXIF's orientation of a picture, 1 to 8. Raises ValueError for a damaged header."""
    return png.turn(path) if path.suffix.lower() in ENCODED else UPRIGHT


def turned(pixels: np.ndarray, turn: int) -> np.ndarray:
    """Pixels [H, W, C] turned as an orientation of EXIF says."""
    transposed, rows, columns = TURNS[turn]
    pixels = pixels.swapaxes(0, 1) if transposed else pixels
    return pixels[:: -1 if rows else 1, :: -1 if columns else 1]


def turned_size(size: tuple[int, int], turn: int) -> tuple[int, int]:
    """(width, height) of a picture that is turned."""
    width, height = size
    return (height, width) if turn in ASIDE else size


def resampled(
    pixels: np.ndarray, values: Callable[[np.ndarray], Float[np.ndarray, "h w C"]], lens: Lens, longest: int | None
) -> Float[np.ndarray, "H W C"]:
    """A picture [h, w, C] of `lens` as its pinhole sees it: see `Lens.target`.

    `values`: numbers that may be averaged, of some rows. The picture may be that of the lens made smaller or larger.
    """
    straight, pinhole = lens.target(longest)
    height, width, channels = pixels.shape
    (fx, fy), size = straight.focal, (pinhole.width, pinhole.height)
    # New pixels for one of the picture's; never more than one, so a coarse mask becomes finer by bilinear values alone.
    wanted = pinhole.focal / fx * lens.width / width, pinhole.focal / fy * lens.height / height
    wanted = tuple(1.0 if abs(share - 1.0) <= SQUARE else share for share in wanted)
    plain = lens.straight and max(wanted) <= 1.0
    if plain and (width, height) == size:
        return np.ascontiguousarray(values(pixels), np.float32)
    shares = min(1.0, wanted[0]), min(1.0, wanted[1])
    reduced = size if plain else (max(1, int(np.ceil(width * shares[0]))), max(1, int(np.ceil(height * shares[1]))))
    count = values(pixels[:1]).shape[2] if height else channels
    found = area_mean(lambda first, end: values(pixels[first:end]), (width, height), reduced, shares, count)
    return found if plain else _looked_up(found, lens, pinhole, (width * shares[0], height * shares[1]))


def in_file(mask: Bool[np.ndarray, "H W"], lens: Lens, longest: int | None) -> Bool[np.ndarray, "h w"]:
    """A mask of the pinhole, as a mask of the lens's pictures, of about as many pixels: `resampled` the other way."""
    straight, pinhole = lens.target(longest)
    share = pinhole.focal / max(straight.focal)
    width, height = max(1, round(lens.width * share)), max(1, round(lens.height * share))
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * lens.width, (np.arange(height) + 0.5) / height * lens.height)
    directions = lens.directions(np.stack([x, y], -1).reshape(-1, 2))
    with np.errstate(invalid="ignore"):
        place = directions * pinhole.focal + np.array(pinhole.centre)
        framed = np.all((place >= 0) & (place < np.array([pinhole.width, pinhole.height])), axis=1)
    column, row = np.where(framed[:, None], place, 0).astype(int).T
    return (framed & mask[row, column]).reshape(height, width)


def _looked_up(
    pixels: Float[np.ndarray, "h w C"], lens: Lens, pinhole: Pinhole, size: tuple[float, float]
) -> Float[np.ndarray, "H W C"]:
    """Bilinear values where the lens shows what the centres of the pinhole's pixels see. `size`: of the picture."""
    from scipy.ndimage import map_coordinates

    made = np.empty((pinhole.height, pinhole.width, pixels.shape[2]), np.float32)
    scale = np.array([size[0] / lens.width, size[1] / lens.height])
    x = (np.arange(pinhole.width) + 0.5 - pinhole.centre[0]) / pinhole.focal
    step = max(1, BLOCK // pinhole.width)
    for first in range(0, pinhole.height, step):
        rows = np.arange(first, min(first + step, pinhole.height))
        y = (rows + 0.5 - pinhole.centre[1]) / pinhole.focal
        across, down = np.meshgrid(x, y)
        directions = np.stack([across, down, np.ones_like(across)], -1).reshape(-1, 3)
        place = (lens.project(directions) * scale - 0.5).T[::-1].reshape(2, *across.shape)
        for channel in range(pixels.shape[2]):
            made[rows, :, channel] = map_coordinates(pixels[..., channel], place, order=1, mode="nearest")
    return made
