"""Radiance HDR (.hdr): eight bits for each colour and one exponent for each pixel, run-length encoded (Ward 1991)."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from jaxdr.callers_line import warn

RESOLUTION = re.compile(rb"-Y (\d{1,9}) \+X (\d{1,9})")
LONGEST_HEADER = 1 << 16  # bytes
RUN_LENGTH_WIDTHS = range(8, 32768)  # other scanlines can only be stored flat
LONGEST_RUN, LONGEST_LITERAL, SHORTEST_RUN = 127, 128, 4


def read(path: Path) -> Float[np.ndarray, "H W 3"]:
    """Linear RGB as stored.

    Flat and "new" run-length encoded scanlines are read. An EXPOSURE other than 1 in the header gives a warning: the
    values are taken as stored, as other renderers do. Raises ValueError for a damaged file, XYZ colours, an image that
    is not stored from the top left, and the run-length encoding of before 1991.
    """
    header, width, height, pixels = _parts(path.read_bytes())
    _check_exposure(path, header)
    # The least number of bytes of a scanline. The check keeps a damaged size from asking for too much memory.
    shortest = min(4 * width, 4 + 8 * math.ceil(width / LONGEST_RUN))
    if not 0 < height * shortest <= len(pixels):
        raise ValueError(f"{len(pixels)} bytes are too few for {width} x {height} pixels")
    stored, end = _scanlines(pixels, height, width)
    if end < len(pixels):
        warn(f"{path}: the {len(pixels) - end} bytes after the last of its {height} rows are left out")
    return _floats(stored)


def size(path: Path) -> tuple[int, int, int]:
    """(width, height, 3), from the header alone. Raises ValueError for a header that is damaged."""
    with open(path, "rb") as file:
        _, width, height, _ = _parts(file.read(LONGEST_HEADER))
    return width, height, 3


def _parts(data: bytes) -> tuple[bytes, int, int, bytes]:
    """(lines of the header, width, height, bytes after the header)."""
    if not data.startswith(b"#?"):
        raise ValueError("the first line is not that of a Radiance file (#?RADIANCE)")
    header, separator, rest = data.partition(b"\n\n")
    line, _, pixels = rest.partition(b"\n")
    if not separator:
        raise ValueError("the header has no end")
    if wrong := [value for name, value in _fields(header) if name == "FORMAT" and value != "32-bit_rle_rgbe"]:
        raise ValueError(f"FORMAT={wrong[0][:40]} is not supported; expected 32-bit_rle_rgbe")
    resolution = RESOLUTION.fullmatch(line)
    if resolution is None:
        raise ValueError(f"expected a size such as '-Y 512 +X 1024', got {line[:40].decode(errors='replace')!r}")
    return header, int(resolution[2]), int(resolution[1]), pixels


def write(path: Path, image: Float[np.ndarray, "H W 3"]) -> None:
    """Write linear RGB, each pixel within 0.4 % of its largest colour.

    Raises ValueError for values the format can't hold: negative, not finite, above 1.7e38.
    """
    image = np.asarray(image, np.float64)
    if not (np.isfinite(image).all() and image.min() >= 0 and image.max() < 2.0**127):
        raise ValueError("values must be finite and not negative in this format; .exr and .pfm hold any")
    height, width = image.shape[:2]
    pixels = _bytes(image)
    lines = pixels.tobytes() if width not in RUN_LENGTH_WIDTHS else b"".join(_encoded(row) for row in pixels)
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (height, width) + lines)


def _fields(header: bytes) -> list[tuple[str, str]]:
    """Names and values of the lines of a header."""
    lines = [line.decode(errors="replace").partition("=") for line in header.splitlines()[1:]]
    return [(name.strip(), value.strip()) for name, _, value in lines]


def _check_exposure(path: Path, header: bytes) -> None:
    for name, value in _fields(header):
        if name == "EXPOSURE" and value not in ("1", "1.0"):
            short = value[:40]
            text = f"{path}: EXPOSURE={short}: values are taken as stored; divide by it for the radiance photographed"
            warnings.warn(text, stacklevel=5)


def _floats(pixels: UInt8[np.ndarray, "H W 4"]) -> Float[np.ndarray, "H W 3"]:
    """Values mantissa / 256 · 2^(exponent - 128); exponent 0 means black."""
    exponent = pixels[..., 3:].astype(np.int32)
    return np.where(exponent > 0, np.ldexp(pixels[..., :3].astype(np.float32), exponent - 136), np.float32(0))


def _bytes(image: Float[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 4"]:
    _, exponent = np.frexp(image.max(-1))
    exponent += np.round(np.ldexp(image.max(-1), 8 - exponent)) == 256  # rounded up to the next power of two
    mantissa = np.round(np.ldexp(image, (8 - exponent)[..., None]))
    stored = exponent + 128
    pixels = np.concatenate([mantissa, stored[..., None]], -1)
    return np.where(((stored > 0) & (image.max(-1) > 0))[..., None], pixels, 0).astype(np.uint8)


def _scanlines(data: bytes, height: int, width: int) -> tuple[UInt8[np.ndarray, "H W 4"], int]:
    """(Pixels, end of their bytes)."""
    image, position = np.empty((height, width, 4), np.uint8), 0
    for y in range(height):
        start = data[position : position + 4]
        if width in RUN_LENGTH_WIDTHS and start[:2] == b"\2\2" and len(start) == 4 and start[2] < 128:
            if int.from_bytes(start[2:]) != width:
                raise ValueError(f"row {y} is damaged: it has {int.from_bytes(start[2:])} pixels instead of {width}")
            line, position = _decoded(data, position + 4, 4 * width, y)
            image[y] = np.frombuffer(line, np.uint8).reshape(4, width).T
        else:
            line = data[position : position + 4 * width]
            if len(line) < 4 * width:
                raise ValueError(f"the file ends in row {y} of {height}")
            image[y] = np.frombuffer(line, np.uint8).reshape(width, 4)
            if (image[y, :, :3] == 1).all(-1).any():
                raise ValueError(f"row {y} has the run-length encoding of before 1991; save the file anew")
            position += 4 * width
    return image, position


def _decoded(data: bytes, position: int, count: int, y: int) -> tuple[bytearray, int]:
    """(`count` bytes of row y, start of the next row), from runs (length + 128, byte) and literals (length, bytes)."""
    line = bytearray()
    while len(line) < count and position < len(data):
        length = data[position]
        if length > 128:
            line += data[position + 1 : position + 2] * (length - 128)
            position += 2
        else:
            line += data[position + 1 : position + 1 + length]
            position += 1 + length
    if len(line) != count:
        raise ValueError(f"row {y} is damaged: its runs are {len(line)} bytes long instead of {count}")
    return line, position


def _encoded(row: UInt8[np.ndarray, "W 4"]) -> bytes:
    """One encoded scanline: the four components one after the other."""
    line = bytearray(b"\2\2" + len(row).to_bytes(2))
    for component in row.T:
        bounds = np.flatnonzero(np.diff(component)) + 1
        starts, ends = np.concatenate([[0], bounds]), np.concatenate([bounds, [len(row)]])
        long = ends - starts >= SHORTEST_RUN
        literal = 0  # everything before this index is written
        for start, end in zip(starts[long].tolist(), ends[long].tolist(), strict=True):
            _add_literal(line, component[literal:start].tobytes())
            for first in range(start, end, LONGEST_RUN):
                line += bytes([128 + min(LONGEST_RUN, end - first), component[first]])
            literal = end
        _add_literal(line, component[literal:].tobytes())
    return bytes(line)


def _add_literal(line: bytearray, values: bytes) -> None:
    for first in range(0, len(values), LONGEST_LITERAL):
        part = values[first : first + LONGEST_LITERAL]
        line += bytes([len(part)]) + part
