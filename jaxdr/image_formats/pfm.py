"""Portable float map (.pfm): uncompressed float32, grey or RGB, bottom row first."""

import math
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

# Kind, width, height, scale (negative: little-endian), then one whitespace character before the data.
HEADER = re.compile(rb"(PF|Pf)\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]{1,40})\s", re.ASCII)
LONGEST_HEADER = 1 << 10  # bytes


def read(path: Path) -> Float[np.ndarray, "H W C"]:
    """Linear values, C = 1 or 3, times the scale that the header gives. Raises ValueError for a damaged file."""
    data = path.read_bytes()
    header = _header(data)
    width, height, channels = _size(header)
    try:
        scale = float(header[4])
    except ValueError:
        raise ValueError(f"the scale {header[4].decode()!r} is not a number") from None
    if np.float32(scale) == 0 or not math.isfinite(np.float32(scale)):
        raise ValueError(f"the scale must not be {scale}")
    expected, found = 4 * width * height * channels, len(data) - header.end()
    if found != expected or expected == 0:
        raise ValueError(f"{width} x {height} pixels take {expected} bytes, the file has {found}")
    stored = np.frombuffer(data, "<f4" if scale < 0 else ">f4", offset=header.end())
    with np.errstate(over="ignore"):  # told below
        pixels = stored.astype(np.float32) * np.float32(abs(scale))
    if np.isfinite(stored).sum() != np.isfinite(pixels).sum():
        raise ValueError(f"its values times the scale {scale:g} are too large")
    return pixels.reshape(height, width, channels)[::-1]


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, channels), from the header alone. Raises ValueError for a header that is damaged."""
    with open(path, "rb") as file:
        return _size(_header(file.read(LONGEST_HEADER)))


def _header(data: bytes) -> re.Match:
    header = HEADER.match(data)
    if header is None:
        raise ValueError("the header is not that of a PFM file (PF or Pf, width, height, scale)")
    return header


def _size(header: re.Match) -> tuple[int, int, int]:
    return int(header[2]), int(header[3]), 3 if header[1] == b"PF" else 1


def write(path: Path, image: Float[np.ndarray, "H W C"]) -> None:
    """Write float32 values, C = 1 or 3."""
    height, width, channels = image.shape
    kind = {1: b"Pf", 3: b"PF"}[channels]
    header = b"%s\n%d %d\n-1.0\n" % (kind, width, height)
    path.write_bytes(header + image[::-1].astype("<f4").tobytes())
