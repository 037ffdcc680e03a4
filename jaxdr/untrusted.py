"""Files that come from elsewhere: the limits that all readers share, and one error that names the file.

A damaged or hostile file gives what its format says, or one ValueError with the file and the place. Libraries raise
anything for such files, hang, or ask for more memory than there is. So a reader calls a library inside of `damage`, and
checks counts, numbers and depths with the functions here before it believes them.
"""

import contextlib
import io
import json
import math
import os
import re
import stat
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from PIL import Image, ImageFile

DEEPEST = 64  # levels of lists and tables in each other
LARGEST = 1e18  # of a number that is computed with: its square is finite in float32
LARGEST_WHOLE = 2**53  # beyond, floats are not exact
MOST_PIXELS = 1 << 27  # of a picture or a film: 1.5 GiB of linear RGB; Pillow refuses a third more
NPY = b"\x93NUMPY"


@contextlib.contextmanager
def damage(what: str) -> Iterator[None]:
    """Whatever a library raises in the block for a damaged file becomes a ValueError: `what` (the library's words).

    `what` begins with the file where the caller does not add it. Keep the block small: it hides mistakes of our own.
    """
    try:
        yield
    except Exception as problem:
        raise ValueError(f"{what} ({reason(problem)})") from problem


def reason(problem: BaseException) -> str:
    """The words of an error, in one line."""
    if isinstance(problem, RecursionError):
        return "it is nested too deeply"
    if isinstance(problem, MemoryError):
        return "it asks for more memory than there is"
    words = problem.strerror if isinstance(problem, OSError) and problem.strerror else str(problem)
    if "sys.set_int_max_str_digits" in words:  # Python's remedy is none for the reader of a file
        return "a whole number of thousands of digits"
    return re.sub(r" ?<\S+ object at 0x\w+>", "", " ".join(words.split())) or type(problem).__name__


def finite(value: Any, where: str, low: float | int = -LARGEST, high: float | int = LARGEST) -> float:
    """A number from a file, within a range. Raises ValueError with `where`, the file and the place."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{where}: expected a number, got {shortened(value)}")
    if not low <= value <= high or not math.isfinite(value):
        raise ValueError(f"{where}: must be a finite number from {low:g} to {high:g}, got {shortened(value)}")
    return float(value)


def whole(value: Any, where: str, low: int = 0, high: int = LARGEST_WHOLE) -> int:
    """A whole number from a file, within a range. Raises ValueError with `where`, the file and the place."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{where}: expected a whole number, got {shortened(value)}")
    if not low <= value <= high:
        raise ValueError(f"{where}: must be a whole number from {low} to {high}, got {shortened(value)}")
    return value


def shortened(value: Any, most: int = 60) -> str:
    """A value as Python writes it, cut where it is long."""
    try:
        text = repr(value)
    except ValueError:  # Python does not write whole numbers of more than 4,300 digits
        return "a number of thousands of digits"
    return text if len(text) <= most else f"{text[:most]}…"


def text_of(path: Path) -> str:
    """The text of a file in UTF-8. Raises ValueError with the file for one that can't be read or decoded."""
    with damage(f"{path}: can't be read as text in UTF-8"):
        return path.read_text(encoding="utf-8-sig")


def json_of(content: str | bytes, where: str) -> Any:
    """The value of a text of JSON. Raises ValueError with `where`.

    Numbers must be finite, of at most 400 digits where they are whole, and nesting is bounded by `DEEPEST`.
    """
    with damage(f"{where}: is not readable JSON"):
        text = content.decode("utf-8-sig") if isinstance(content, bytes) else content
        found = json.loads(text, parse_int=_whole_text, parse_float=_float_text, parse_constant=_constant)
        _check_depth(found)
    return found


def json_text(value: Any) -> str:
    """A text that `json_of` reads. JSON has no NaN and no infinity: they become null."""

    def finite_or_none(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: finite_or_none(inner) for key, inner in part.items()}
        if isinstance(part, list | tuple):
            return [finite_or_none(inner) for inner in part]
        return None if isinstance(part, float) and not math.isfinite(part) else part

    return json.dumps(finite_or_none(value), indent=2, allow_nan=False) + "\n"


def read_json(path: Path) -> Any:
    """The value of a file of JSON; see `json_of`."""
    with damage(f"{path}: can't be read"):
        content = path.read_bytes()
    return json_of(content, str(path))


def array_of(source: Path | bytes, where: str) -> np.ndarray:
    """The array of an `.npy` file. Raises ValueError with `where` for anything else, an archive and objects among it.

    The bytes that the header promises are compared with those that are there before memory is taken.
    """
    content = io.BytesIO(source) if isinstance(source, bytes) else None
    with damage(f"{where}: not a readable NPY file"), content or open(source, "rb") as file:
        length = file.seek(0, io.SEEK_END)
        file.seek(0)
        _header(file, length)
        file.seek(0)
        return np.load(file, allow_pickle=False)


def array_shape(path: Path, where: str) -> tuple[int, ...]:
    """The shape in the header of an `.npy` file, whose bytes are counted. Raises ValueError as `array_of` does."""
    with damage(f"{where}: not a readable NPY file"), open(path, "rb") as file:
        length = file.seek(0, io.SEEK_END)
        file.seek(0)
        return _header(file, length)


def arrays_of(path: Path, where: str) -> dict[str, np.ndarray]:
    """The arrays of an `.npz` file by name. Raises ValueError with `where` for anything else.

    Raises FileNotFoundError for a file that is missing.
    """
    if not path.exists():
        raise FileNotFoundError(f"{where}: there is no such file")
    with damage(where), zipfile.ZipFile(path) as archive:
        found = {}
        for member in archive.infolist():
            check_memory(member.file_size, member.filename)
            found[member.filename.removesuffix(".npy")] = array_of(archive.read(member), member.filename)
        return found


def _header(file: Any, length: int) -> tuple[int, ...]:
    """The shape of an array in a file of `length` bytes, behind whose header `file` stands afterwards."""
    magic = file.read(len(NPY))
    if magic != NPY:
        archive = magic[:2] == b"PK"
        raise ValueError("it is an archive of arrays (.npz)" if archive else "it is of another format")
    file.seek(0)
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
    shape, _, kind = read(file)
    if kind.hasobject:
        raise ValueError("it holds Python objects")
    needed, there = math.prod(shape) * kind.itemsize, length - file.tell()
    if any(n < 0 for n in shape) or needed > there:
        raise ValueError(f"an array of shape {list(shape)} takes {needed} bytes, the file has {there}")
    return tuple(shape)


@contextlib.contextmanager
def opened_picture(source: Path | io.BytesIO, formats: tuple[str, ...]) -> Iterator[ImageFile.ImageFile]:
    """A picture of one of Pillow's `formats`, and no other: some formats start programs. Pixels are not read yet.

    Raises ValueError for other formats, and for more than `MOST_PIXELS`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # our limit is told instead
        with damage(f"not a readable {' or '.join(formats)} file"):
            image = Image.open(source, formats=formats)
    with image:
        check_pixels(*image.size)
        yield image


def check_pixels(width: int, height: int, where: str = "") -> None:
    """Raises ValueError for a picture or a film of more than `MOST_PIXELS`, or without any."""
    if not (width > 0 and height > 0 and width * height <= MOST_PIXELS):
        place = f"{where}: " if where else ""
        found = f"{shortened(width)} x {shortened(height)}"
        raise ValueError(f"{place}expected 1 to {MOST_PIXELS} pixels, got {found}")


def check_memory(needed: int, where: str) -> None:
    """Raises ValueError where something asks for more bytes than this machine has at all."""
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # no POSIX
        return
    if needed > there:
        raise ValueError(f"{where}: takes {needed / 2**30:.1f} GiB, this machine has {there / 2**30:.1f} GiB")


def is_own_file(path: Path) -> bool:
    """Whether a path is a regular file itself, and no symbolic link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _whole_text(text: str) -> int:
    if len(text) > 400:
        raise ValueError(f"a whole number of {len(text)} digits")
    return int(text)


def _float_text(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {shortened(text)} is too large")
    return value


def _constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")


def _check_depth(value: Any) -> None:
    level, depth = [value], 0
    while level:
        parts = [list(v.values()) if isinstance(v, dict) else v for v in level if isinstance(v, dict | list)]
        level, depth = [v for part in parts for v in part if isinstance(v, dict | list)], depth + 1
        if depth > DEEPEST:
            raise ValueError(f"it is nested more than {DEEPEST} levels deep")
