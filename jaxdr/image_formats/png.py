"""PNG, JPEG, BMP and TGA through Pillow. Values are as stored: nothing is decoded from sRGB here."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from PIL import Image, ImageFile

from jaxdr.untrusted import damage, opened_picture

FORMATS = ("PNG", "JPEG", "BMP")
ORIENTATION = 0x0112  # EXIF's number
TGA = ("TGA",)  # has no signature, so that any bytes may look like it: by name only
DEFLATED = 1032  # bytes at most that a byte of a PNG file stands for
JPEG_PIXELS = 1024  # at most for a byte: a block of 8 x 8 takes a bit or more; twice as many for odd sampling


def read(path: Path | BytesIO) -> Float[np.ndarray, "H W C"]:
    """Stored values / 255 (or / 65535 with 16 bits), C = 1, 3 or 4; alpha last. Palettes are looked up.

    Raises ValueError for a damaged file, CMYK, and 16-bit images with grey and alpha or with one transparent colour.
    """
    return shares(stored(path))


def stored(path: Path | BytesIO) -> UInt8[np.ndarray, "H W C"] | UInt16[np.ndarray, "H W C"]:
    """The values of `read` as whole numbers, which take a quarter of the memory. Raises ValueError as `read`."""
    with opened_picture(path, _formats(path)) as image:
        channels = _channels(image)
        _check_length(path, image)
        if image.format == "PNG":
            _check_sums(path)
        with damage(f"not a readable {image.format} file"):
            pixels = _pixels(image, path)
    return pixels.reshape(*pixels.shape[:2], channels)


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) of the image that `read` reads, from the header alone. Raises ValueError as `read`."""
    with opened_picture(path, _formats(path)) as image:
        return *image.size, _channels(image)


def write(path: Path, pixels: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write 8-bit RGB as a PNG."""
    Image.fromarray(pixels).save(path, format="PNG")


def _formats(path: Path | BytesIO) -> tuple[str, ...]:
    return FORMATS + TGA if isinstance(path, Path) and path.suffix.lower() == ".tga" else FORMATS


def _channels(image: ImageFile.ImageFile) -> int:
    mode = image.mode if _deep(image) else _mode(image)
    return 1 if mode == "I;16" else len(mode)


def _check_length(path: Path | BytesIO, image: ImageFile.ImageFile) -> None:
    """Raises ValueError unless the file can hold its pixels. libjpeg makes grey ones of those that are missing."""
    length = path.getbuffer().nbytes if isinstance(path, BytesIO) else path.stat().st_size
    bits = 1 if image.mode in ("1", "L", "P") else 8 * len(image.getbands())
    a_byte_holds = {"PNG": 8 * DEFLATED // bits, "JPEG": JPEG_PIXELS}.get(image.format or "")
    if a_byte_holds and image.width * image.height > a_byte_holds * length:
        raise ValueError(f"{image.width} x {image.height} pixels take more bytes, the file has {length}")


def _check_sums(path: Path | BytesIO) -> None:
    # Pillow looks at the check sums of pixels only when it is asked to, and can't read the file afterwards.
    with opened_picture(path, ("PNG",)) as again, damage("not a readable PNG file"):
        again.verify()


def _pixels(image: ImageFile.ImageFile, path: Path | BytesIO) -> np.ndarray:
    if raw_mode := _deep(image):
        if image.mode == "I;16":
            return np.asarray(image)
        # Pillow keeps only the first byte of each 16-bit value. Decoded in the opposite byte order, the same file gives
        # the second bytes.
        high = np.asarray(image).astype(np.uint16)
        with opened_picture(path, ("PNG",)) as again:
            again.tile = [tile._replace(args=raw_mode.replace(";16B", ";16L")) for tile in again.tile]
            low = np.asarray(again)
        return 256 * high + low
    return np.asarray(image.convert(_mode(image)))


def shares(stored: np.ndarray) -> Float[np.ndarray, "*n"]:
    """Whole numbers over the largest one of their kind."""
    found = stored.astype(np.float32)
    found /= np.float32(np.iinfo(stored.dtype).max)  # in place, since pictures are large
    return found


def turn(path: Path) -> int:
    """EXIF's orientation, 1 to 8: how a picture has to be turned to be upright. 1 where a file does not say."""
    with opened_picture(path, _formats(path)) as image:
        if image.format == "PNG" and "exif" not in image.info:
            return 1  # Pillow would read all pixels to see whether it comes behind them
        with damage(f"not a readable {image.format} file"):
            found = image.getexif().get(ORIENTATION, 1)
    return found if found in range(1, 9) else 1


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
