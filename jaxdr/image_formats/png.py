"""PNG, JPEG, BMP and TGA through Pillow. Values are as stored: nothing is decoded from sRGB here."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageFile

FORMATS = ("PNG", "JPEG", "BMP", "TGA")


def read(path: Path | BytesIO) -> Float[np.ndarray, "H W C"]:
    """Stored values / 255 (or / 65535 with 16 bits), C = 1, 3 or 4; alpha last. Palettes are looked up.

    Raises ValueError for a damaged file, CMYK, and 16-bit images with grey and alpha or with one transparent colour.
    """
    try:
        with Image.open(path, formats=FORMATS) as image:
            pixels = _pixels(image, path)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"not a readable PNG, JPEG, BMP or TGA file ({error})") from error
    return pixels.reshape(*pixels.shape[:2], -1)


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) of the image that `read` reads, from the header alone. Raises ValueError as `read`."""
    try:
        with Image.open(path, formats=FORMATS) as image:
            mode = image.mode if _deep(image) else _mode(image)
            return *image.size, 1 if mode == "I;16" else len(mode)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"not a readable PNG, JPEG, BMP or TGA file ({error})") from error


def write(path: Path, pixels: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write 8-bit RGB as a PNG."""
    Image.fromarray(pixels).save(path, format="PNG")


def _pixels(image: ImageFile.ImageFile, path: Path | BytesIO) -> np.ndarray:
    if raw_mode := _deep(image):
        if image.mode == "I;16":
            return np.asarray(image).astype(np.float32) / 65535
        # Pillow keeps only the first byte of each 16-bit value. Decoded in the opposite byte order, the same file gives
        # the second bytes.
        high = np.asarray(image).astype(np.uint16)
        with Image.open(path) as again:
            again.tile = [tile._replace(args=raw_mode.replace(";16B", ";16L")) for tile in again.tile]
            low = np.asarray(again)
        return (256 * high + low).astype(np.float32) / 65535
    return np.asarray(image.convert(_mode(image))).astype(np.float32) / 255


def _deep(image: ImageFile.ImageFile) -> str:
    """Pillow's name for the values of a file with 16 bits; empty for other files."""
    raw_mode = image.tile[0].args if image.tile and isinstance(image.tile[0].args, str) else ""
    if not raw_mode.endswith(";16B"):
        return ""
    if raw_mode == "LA;16B" or "transparency" in image.info:
        raise ValueError("16-bit grey with alpha and 16-bit transparent colours are not supported; use RGBA")
    return raw_mode


def _mode(image: ImageFile.ImageFile) -> str:
    """The Pillow mode to which a file with 8 bits is converted."""
    if image.mode == "CMYK":
        raise ValueError("CMYK colours are not supported; save the file as RGB")
    if image.has_transparency_data:
        return "RGBA"
    return "L" if image.mode in ("1", "L") else "RGB"
