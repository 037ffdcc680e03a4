"""`jaxdr.Picture`: images and derivatives in a notebook, in a row, with titles."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from jaxdr.argument_kinds import checked
from jaxdr.images import signed_picture, to_srgb
from jaxdr.whole_numbers import whole

GAP, HEADER, LETTERS = 8, 22, 13  # pixels between pictures, above them for a title, and of its letters
NOT_A_NUMBER = (255, 0, 255)  # a colour that no rendering has by chance
Images = Float[Array, "..."] | Float[np.ndarray, "..."]


@checked
class Picture:
    """Images as a notebook shows them: the last line of a cell. Nothing is printed, and no file is written.

    - `images`: one image [H, W, 3], [H, W, 1] or [H, W], linear RGB, or several of them, of any sizes.
    - `titles`: words above each image; a string for one image.
    - `signed`: for derivatives; one for all, or one for each image. The mean of the channels is shown, red where it is
      positive, blue where it is negative, with a colour bar.
    - `limit`: the value of the darkest red; by default the largest magnitude, but for one pixel in 200 of each image.
      All signed images share it.
    - `height`: pixels on the screen; smaller images are enlarged to about that by a whole number, so that pixels stay
      squares. Larger ones stay as they are.
    - `columns`: images in a row.

    Colours are sRGB; what is outside [0, 1] is clipped. NaN is magenta. `pixels` is the picture, 8-bit sRGB [h, w, 3].

    Raises ValueError for arrays of another shape, traced ones, no image, other numbers of `titles` or `signed` than of
    images, a `limit` that is not positive, and for `height` or `columns` below 1.
    """

    pixels: UInt8[np.ndarray, "h w 3"]

    def __init__(
        self,
        images: Images | Sequence[Images],
        titles: str | Sequence[str] | None = None,
        *,
        signed: bool | Sequence[bool] = False,
        limit: float | None = None,
        height: int = 256,
        columns: int = 4,
    ):
        arrays = _arrays(images)
        words = [titles] if isinstance(titles, str) else [""] * len(arrays) if titles is None else list(titles)
        signs = [signed] * len(arrays) if isinstance(signed, bool) else list(signed)
        for name, given in (("titles", words), ("signed", signs)):
            if len(given) != len(arrays):
                raise ValueError(f"Picture: {len(given)} {name} for {len(arrays)} images; give one each")
        for name, value in (("height", height), ("columns", columns)):
            if not whole(value):
                raise ValueError(f"Picture: {name} must be a positive whole number, got {value!r}")
        if limit is not None and not limit > 0:
            raise ValueError(f"Picture: limit must be positive, got {limit}")
        greys = [array.mean(-1) if sign else None for array, sign in zip(arrays, signs, strict=True)]
        end = _limit([grey for grey in greys if grey is not None]) if limit is None else float(limit)
        # One bar is enough for signed images beside each other: they share the limit.
        beside = [(i + 1) % columns and i + 1 < len(greys) and greys[i + 1] is not None for i in range(len(greys))]
        cells = [
            _plain(array, height) if grey is None else _signed(grey, end, height, bar=not more)
            for array, grey, more in zip(arrays, greys, beside, strict=True)
        ]
        self.pixels = _rows(cells, words, columns)

    def __repr__(self) -> str:
        return f"jaxdr.Picture of {self.pixels.shape[1]} x {self.pixels.shape[0]} pixels"

    def _repr_png_(self) -> bytes:
        """The PNG file that a notebook shows and keeps."""
        file = BytesIO()
        Image.fromarray(self.pixels).save(file, "PNG", optimize=True)
        return file.getvalue()


def _arrays(images: Any) -> list[np.ndarray]:
    """Every image as an array [H, W, C]."""
    single = isinstance(images, jax.Array | np.ndarray) and images.ndim < 4
    found = []
    for image in [images] if single else list(images):
        if isinstance(image, Tracer):
            raise ValueError("Picture: the image is traced, so it has no pixels yet; make the picture outside of jit")
        array = np.asarray(image, np.float32)
        array = array[..., None] if array.ndim == 2 else array
        if array.ndim != 3 or array.shape[-1] not in (1, 3) or 0 in array.shape:
            raise ValueError(
                f"Picture: each of images must have shape [H, W, 3], [H, W, 1] or [H, W], got {list(np.shape(image))}"
            )
        found.append(array)
    if not found:
        raise ValueError("Picture: there is no image to show")
    return found


def _limit(greys: list[np.ndarray]) -> float:
    """The end of the colour bar: nearly the largest magnitude, as a few pixels of noise may be far larger."""
    sizes = [np.abs(grey[np.isfinite(grey)]) for grey in greys if np.isfinite(grey).any()]
    found = max((float(np.quantile(size, 0.995)) for size in sizes), default=0.0)
    return found or max((float(size.max()) for size in sizes), default=0.0) or 1.0


def _plain(array: Float[np.ndarray, "H W C"], height: int) -> UInt8[np.ndarray, "h w 3"]:
    missing = np.asarray(np.isnan(array).any(-1))
    pixels = to_srgb(np.broadcast_to(np.where(missing[..., None], 0.0, array), (*array.shape[:2], 3)))
    pixels[missing] = NOT_A_NUMBER
    factor = max(1, height // len(pixels))
    return pixels.repeat(factor, 0).repeat(factor, 1)


def _signed(grey: Float[np.ndarray, "H W"], limit: float, height: int, bar: bool) -> UInt8[np.ndarray, "h w 3"]:
    missing = np.isnan(grey)
    pixels = signed_picture(np.where(missing, 0.0, grey), limit, height).copy()
    factor = max(1, height // len(grey))
    places = missing.repeat(factor, 0).repeat(factor, 1)
    inside = pixels[: len(places), : places.shape[1]]
    inside[places] = NOT_A_NUMBER
    return pixels if bar else inside


def _rows(cells: list[UInt8[np.ndarray, "_ _ 3"]], titles: list[str], columns: int) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures in rows on white, each with its title."""
    header = HEADER if any(titles) else 0
    font = ImageFont.load_default(LETTERS)
    sizes = [
        (max(cell.shape[1], int(font.getlength(t)) + 2), cell.shape[0]) for cell, t in zip(cells, titles, strict=True)
    ]
    places, x, y, right = [], 0, 0, 0
    for start in range(0, len(cells), columns):
        row = sizes[start : start + columns]
        x = 0
        for width, _ in row:
            places.append((x, y))
            x += width + GAP
        right = max(right, x - GAP)
        y += header + max(height for _, height in row) + GAP
    canvas = Image.new("RGB", (right, y - GAP), (255, 255, 255))
    draw = ImageDraw.Draw(canvas)
    for cell, title, (x, y) in zip(cells, titles, places, strict=True):
        canvas.paste(Image.fromarray(cell), (x, y + header))
        draw.text((x, y + header // 2), title, fill=(40, 40, 40), font=font, anchor="lm")
    return np.asarray(canvas)
