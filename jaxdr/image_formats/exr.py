"""OpenEXR (.exr), through the optional package OpenEXR."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.untrusted import MOST_PIXELS, check_pixels, damage

MOST_VALUES = 4 * MOST_PIXELS
INSTALL = 'EXR files need OpenEXR, which is optional: pip install -e ".[exr]"'
GROUPS = ("RGBA", "RGB", "Y")  # the package's names for the channels of one layer


def is_available() -> bool:
    """Whether the optional package is installed."""
    try:
        import OpenEXR  # noqa: F401
    except ImportError:
        return False
    return True


def read(path: Path) -> Float[np.ndarray, "H W C"]:
    """Linear values of the data window of the first part that has RGBA, RGB or Y, in float32.

    Raises ValueError for a damaged file, for one without these channels, and if the package is missing.
    """
    _check_values(_headers(path))
    import OpenEXR

    with damage("not a readable EXR file"), OpenEXR.File(str(path)) as file:
        parts = [{name: c.pixels for name, c in file.channels(i).items()} for i in range(max(1, len(file.parts)))]
    for channels in parts:
        if "RY" in channels or "BY" in channels:
            raise ValueError("luminance-chroma channels are not supported; save the file as RGB")
        for name in GROUPS:
            if name in channels:
                pixels = np.asarray(channels[name], np.float32)
                return pixels.reshape(*pixels.shape[:2], -1)
    found = ", ".join(name for channels in parts for name in channels)
    raise ValueError(f"there is no layer {', '.join(GROUPS)}; the file has {found or 'nothing'}")


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) of the image that `read` reads, from the header alone. Raises ValueError as `read`."""
    headers = _headers(path)
    for names, width, height in headers:
        for group in GROUPS:
            if set(group) <= names:
                return width, height, len(group)
    found = ", ".join(name for names, *_ in headers for name in sorted(names))
    raise ValueError(f"there is no layer {', '.join(GROUPS)}; the file has {found or 'nothing'}")


def _headers(path: Path) -> list[tuple[set[str], int, int]]:
    """(names of channels, width, height) of all parts. Raises ValueError if the package is missing."""
    if not is_available():
        raise ValueError(INSTALL)
    import OpenEXR

    with damage("not a readable EXR file"), OpenEXR.File(str(path), header_only=True) as file:
        headers = [file.header(i) for i in range(max(1, len(file.parts)))]
        windows = [np.array(header["dataWindow"], int) for header in headers]
        sizes = [(high - low + 1).tolist() for low, high in windows]
        return [({c.name for c in header["channels"]}, *size) for header, size in zip(headers, sizes, strict=True)]


def _check_values(headers: list[tuple[set[str], int, int]]) -> None:
    """The library reads all channels of all parts."""
    for _, width, height in headers:
        check_pixels(width, height)
    values = sum(len(names) * width * height for names, width, height in headers)
    if values > MOST_VALUES:
        raise ValueError(f"all its channels have {values} values; at most {MOST_VALUES} are read")


def write(path: Path, image: Float[np.ndarray, "H W C"]) -> None:
    """Write float32 values, C = 1, 3 or 4, losslessly. Raises OSError, and ValueError if the package is missing."""
    if not is_available():
        raise ValueError(INSTALL)
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    name = {1: "Y", 3: "RGB", 4: "RGBA"}[image.shape[2]]
    pixels = np.ascontiguousarray(image, np.float32)
    with OpenEXR.File(header, {name: pixels[..., 0].copy() if name == "Y" else pixels}) as file:
        try:
            file.write(str(path))
        except RuntimeError as error:  # the library raises it for a full disk
            raise OSError(str(error)) from error
