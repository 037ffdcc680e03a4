"""OpenEXR (.exr), through the optional package OpenEXR."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

INSTALL = 'EXR files need OpenEXR, which is optional: pip install "jaxdr[exr]"'
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
    if not is_available():
        raise ValueError(INSTALL)
    import OpenEXR

    try:
        with OpenEXR.File(str(path)) as file:
            parts = [{name: c.pixels for name, c in file.channels(i).items()} for i in range(max(1, len(file.parts)))]
    except Exception as error:  # the library raises many kinds for broken files
        raise ValueError(f"not a readable EXR file ({error})") from error
    for channels in parts:
        if "RY" in channels or "BY" in channels:
            raise ValueError("luminance-chroma channels are not supported; save the file as RGB")
        for name in GROUPS:
            if name in channels:
                pixels = channels[name].astype(np.float32)
                return pixels.reshape(*pixels.shape[:2], -1)
    found = ", ".join(name for channels in parts for name in channels)
    raise ValueError(f"there is no layer {', '.join(GROUPS)}; the file has {found or 'nothing'}")


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels) of the image that `read` reads, from the header alone. Raises ValueError as `read`."""
    if not is_available():
        raise ValueError(INSTALL)
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            headers = [file.header(i) for i in range(max(1, len(file.parts)))]
            found = [({c.name for c in header["channels"]}, header["dataWindow"]) for header in headers]
    except Exception as error:  # the library raises many kinds for broken files
        raise ValueError(f"not a readable EXR file ({error})") from error
    for names, (low, high) in found:
        for group in GROUPS:
            if set(group) <= names:
                return int(high[0] - low[0] + 1), int(high[1] - low[1] + 1), len(group)
    raise ValueError(f"there is no layer {', '.join(GROUPS)}")


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
