"""Reading and writing image files, tone mapping, and pictures of signed values with a colour bar.

The file formats themselves are in `jaxdr.image_formats`.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from jaxdr.argument_kinds import checked
from jaxdr.atomic_file import atomic_path
from jaxdr.image_formats import exr, pfm, png, rgbe
from jaxdr.untrusted import array_of, array_shape, check_pixels

# Ends and middle of the diverging map, sRGB: blue, white, red of Moreland 2009, "Diverging Color Maps for Scientific
# Visualization", with a lighter middle so that zero reads as empty.
NEGATIVE, ZERO, POSITIVE = np.array([[59, 76, 192], [247, 247, 247], [180, 4, 38]]) / 255


def to_srgb(image: Float[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
    """8-bit sRGB from linear RGB, for display only: values outside [0, 1] are clipped (IEC 61966-2-1)."""
    linear = np.clip(image, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255 * encoded).astype(np.uint8)


def diverging(values: Float[np.ndarray, "H W"], limit: float) -> UInt8[np.ndarray, "H W 3"]:
    """8-bit colours of signed values: blue at -limit and below, white at 0, red at +limit and above."""
    t = np.clip(values / limit, -1.0, 1.0)[..., None]
    return np.round(255 * (ZERO + np.where(t < 0, -t * (NEGATIVE - ZERO), t * (POSITIVE - ZERO)))).astype(np.uint8)


def from_srgb(encoded: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Linear values from sRGB-encoded values in [0, 1] (IEC 61966-2-1)."""
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear.astype(encoded.dtype)


@checked
def load_image(path: str | os.PathLike, *, raw: bool = False) -> Float[np.ndarray, "H W C"]:
    """Linear float32 values of an image file, top row first; C = 1 (grey), 3 (RGB) or 4 (RGB and alpha).

    `.exr`, `.hdr`, `.pfm` and `.npy` hold linear values. `.png` (8 or 16 bit), `.jpg`, `.bmp` and `.tga` hold sRGB,
    which is made linear; alpha is linear already. With `raw` their numbers are not made linear and stay in [0, 1]: use
    it for normal maps, roughness and masks.

    Raises ValueError for a missing or damaged file, an unknown suffix, a variant that is not supported, more than 2^27
    pixels, and EXR without the package OpenEXR. The message names the file.
    """
    path = Path(path)
    image_size(path)  # before pixels take memory
    image = _read(path, READERS)
    if path.suffix.lower() in ENCODED and not raw:
        for row in image:  # one by one, since all at once take several times the memory
            row[:, :3] = from_srgb(row[:, :3])
    return image


def load_stored(path: Path) -> np.ndarray:
    """The image of `load_image`, where possible as the whole numbers that the file holds: see `linear_of`.

    Raises ValueError like `load_image`.
    """
    image_size(path)
    stored: dict[str, Callable[[Path], Any]] = {**READERS, **dict.fromkeys(ENCODED, png.stored)}
    return _read(path, stored)


def linear_of(stored: np.ndarray) -> Float[np.ndarray, "*n C"]:
    """Linear values of what `load_stored` returned, or of some of its rows; alpha is linear already."""
    if stored.dtype.kind == "f":
        return stored
    steps = np.arange(np.iinfo(stored.dtype).max + 1, dtype=stored.dtype)
    linear = from_srgb(png.shares(steps))[stored]
    if stored.shape[-1] == 4:
        linear[..., 3] = png.shares(stored[..., 3])
    return linear


def image_size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) of the array that `load_image` returns; only the header of the file is read.

    Raises ValueError like `load_image`, for problems that the header shows.
    """
    width, height, channels = _read(path, SIZES)
    check_pixels(width, height, str(path))
    return width, height, channels


def _read(path: Path, functions: dict[str, Callable[[Path], Any]]) -> Any:
    suffix = path.suffix.lower()
    if suffix not in functions:
        raise ValueError(f"{path}: unknown image format {path.suffix!r}; known are {', '.join(functions)}")
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    try:
        return functions[suffix](path)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def check_image_path(path: Path) -> None:
    """Raise ValueError unless `write_image` could write to `path`: known suffix, existing folder, EXR support."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: unknown image format {path.suffix!r}; known are {', '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: folder {path.parent} does not exist")
    if path.suffix.lower() == ".exr" and not exr.is_available():
        raise ValueError(f"{path}: {exr.INSTALL}")


@checked
def write_image(path: str | os.PathLike, image: Float[np.ndarray, "H W C"] | Float[Array, "H W C"]) -> None:
    """Write linear RGB [H, W, 3], top row first.

    `.exr`, `.pfm` and `.npy` keep float32 values, and may hold one channel instead (C = 1). `.hdr` rounds them to RGBE.
    `.png` holds 8-bit sRGB: values are clipped to [0, 1].

    The file appears complete or not at all. Raises ValueError for an unknown suffix, a missing folder, EXR without the
    package OpenEXR, and negative values in `.hdr`.
    """
    path = Path(path)
    check_image_path(path)
    try:
        with atomic_path(path) as temporary:
            WRITERS[path.suffix.lower()](temporary, np.asarray(image, np.float32))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def save_png(path: Path, pixels: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write 8-bit sRGB pixels; the file appears complete or not at all."""
    with atomic_path(path) as temporary:
        png.write(temporary, pixels)


def _read_npy(path: Path) -> Float[np.ndarray, "H W C"]:
    stored = array_of(path, "the array")
    if stored.dtype.kind not in "fiub":
        raise ValueError(f"expected numbers, got {stored.dtype}")
    with np.errstate(over="ignore"):  # told below
        image = stored.astype(np.float32)
    if np.isfinite(stored).sum() != np.isfinite(image).sum():
        raise ValueError("it has values that are too large for float32")
    return image


def _npy_size(path: Path) -> tuple[int, int, int]:
    shape = array_shape(path, "the array")
    if len(shape) != 3 or shape[2] not in (1, 3, 4):
        raise ValueError(f"expected an array of shape [H, W, 1, 3 or 4], got {list(shape)}")
    return shape[1], shape[0], shape[2]


ENCODED = (".png", ".jpg", ".jpeg", ".bmp", ".tga")
READERS = {
    ".png": png.read,
    ".jpg": png.read,
    ".jpeg": png.read,
    ".bmp": png.read,
    ".tga": png.read,
    ".exr": exr.read,
    ".hdr": rgbe.read,
    ".pfm": pfm.read,
    ".npy": _read_npy,
}
SIZES = {
    **{suffix: png.size for suffix in ENCODED},
    ".exr": exr.size,
    ".hdr": rgbe.size,
    ".pfm": pfm.size,
    ".npy": _npy_size,
}
WRITERS = {
    ".png": lambda path, image: png.write(path, to_srgb(image)),
    ".exr": exr.write,
    ".hdr": rgbe.write,
    ".pfm": pfm.write,
    ".npy": np.save,
}
SUFFIXES = tuple(WRITERS)


def signed_picture(values: Float[np.ndarray, "H W"], limit: float, height: int = 512) -> UInt8[np.ndarray, "h w 3"]:
    """Picture of signed values, enlarged to about `height` pixels, with a colour bar labelled ±limit.

    Pixels stay sharp squares: the enlargement is by a whole number. Raises ValueError unless limit > 0.
    """
    if not limit > 0:
        raise ValueError(f"signed_picture: limit must be positive, got {limit}")
    factor = max(1, height // values.shape[0])
    picture = diverging(values, limit).repeat(factor, 0).repeat(factor, 1)

    rows = max(len(picture), 96)  # room for the labels beside a small picture
    canvas = np.full((rows, picture.shape[1] + 112, 3), 255, np.uint8)
    canvas[: len(picture), : picture.shape[1]] = picture
    left, top, bottom = picture.shape[1] + 12, 10, rows - 10
    ramp = np.linspace(limit, -limit, bottom - top)[:, None].repeat(18, 1)
    canvas[top:bottom, left : left + 18] = diverging(ramp, limit)

    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    draw.rectangle((left - 1, top - 1, left + 18, bottom), outline=(90, 90, 90))
    for share in (1.0, 0.5, 0.0, -0.5, -1.0):
        y = top + (1 - share) / 2 * (bottom - top - 1)
        text = f"{share * limit:+.3g}" if share else "0"
        draw.text((left + 24, y), text, fill=(0, 0, 0), font=ImageFont.load_default(12), anchor="lm")
    return np.asarray(image)


def labelled_grid(
    titles: list[str], rows: list[list[UInt8[np.ndarray, "H W 3"]]], gap: int = 4
) -> UInt8[np.ndarray, "h w 3"]:
    """Pictures of equal size in rows and columns on white, with a title over each column."""
    height, width = rows[0][0].shape[:2]
    factor = max(1, 128 // height)
    cell_height, cell_width, header = factor * height, factor * width, 18
    size = (header + len(rows) * (cell_height + gap), len(titles) * (cell_width + gap) - gap, 3)
    canvas = np.full(size, 255, np.uint8)
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            y, x = header + i * (cell_height + gap), j * (cell_width + gap)
            canvas[y : y + cell_height, x : x + cell_width] = cell.repeat(factor, 0).repeat(factor, 1)
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    for j, title in enumerate(titles):
        place = (j * (cell_width + gap) + cell_width // 2, header // 2)
        draw.text(place, title, fill=(0, 0, 0), font=ImageFont.load_default(12), anchor="mm")
    return np.asarray(image)
