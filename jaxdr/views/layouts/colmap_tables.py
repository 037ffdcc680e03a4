"""The tables `cameras` and `images` of a COLMAP model, text and binary (colmap.github.io/format.html).

Read here and not by pycolmap: it takes numbers behind the end of a cut file for what should be there, and runs out of
memory, hangs or ends the process for counts that are damaged, in tables that photographs don't need, too.
"""

import re
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

from jaxdr.untrusted import MOST_PIXELS, check_pixels, damage, finite, shortened, text_of, whole
from jaxdr.views.lens import Lens

# Numbers of parameters by model; the order is that of the ids.
PARAMETERS = {
    **{"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8},
    **{"FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12},
    **{"RAD_TAN_THIN_PRISM_FISHEYE": 16, "SIMPLE_DIVISION": 4, "DIVISION": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4},
    **{"EUCM": 6, "EQUIRECTANGULAR": 2},
}
MODELS = list(PARAMETERS)
UNIT = 1e-3  # the length of a quaternion may differ from one by so much
LARGEST_ID = 2**32 - 1
CAMERA, IMAGE, POINT = 40, 73, 24  # fewest bytes of a camera and of an image, bytes of a point in an image
OF_POINTS = "0123456789+-.eE \t\r"  # characters of a line of points
ANEW = "export the model anew"

T = TypeVar("T")


class Image(NamedTuple):
    """A row of `images`: a quaternion (w, x, y, z) and a translation, world to camera, and the id of the camera."""

    name: str
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    camera: int


def read_tables(model: Path) -> tuple[dict[int, Lens], dict[int, Image]]:
    """(cameras, images) of a model by id; the binary files if there are both. Other tables are not read.

    Poses are those in `images`, which COLMAP also writes if it has `rigs` and `frames`. Raises ValueError, with the
    file and the place, for files that are damaged, cut off or too long, and for an image of a camera that is missing.
    """
    for suffix, cameras_of, images_of in ((".bin", _binary_cameras, _binary_images), (".txt", _cameras, _images)):
        files = [model / f"{name}{suffix}" for name in ("cameras", "images")]
        if all(file.is_file() for file in files):
            cameras, images = cameras_of(files[0]), images_of(files[1])
            break
    else:
        raise ValueError(f"{model}: has no table of images beside that of cameras, .bin or .txt; {ANEW}")
    names = set()
    for number, image in images.items():
        if image.camera not in cameras:
            raise ValueError(f"{files[1]}: image {number} has camera {image.camera}, which is missing; {ANEW}")
        if image.name in names:
            raise ValueError(f"{files[1]}: two images are called {shortened(image.name)}; take one out")
        names.add(image.name)
    return cameras, images


class Bytes:
    """A binary file, which is read from its start on. Every count is compared with the bytes that are left."""

    def __init__(self, path: Path):
        self.path, self.at = path, 0
        with damage(f"{path}: can't be read"):
            self.data = path.read_bytes()

    def take(self, kinds: str, where: str) -> tuple:
        """The next numbers, of kinds as in `struct`."""
        start = self.skip(struct.calcsize(f"<{kinds}"), where)
        return struct.unpack_from(f"<{kinds}", self.data, start)

    def skip(self, size: int, where: str) -> int:
        """Go on by so many bytes; returns where they start."""
        start, left = self.at, len(self.data) - self.at
        if size > left:
            raise ValueError(f"{self.path}: {where}: takes {size} bytes, the file has {left} more; {ANEW}")
        self.at = start + size
        return start

    def text(self, where: str) -> str:
        """The text up to the next zero."""
        start, end = self.at, self.data.find(b"\0", self.at)
        if end < 0:
            raise ValueError(f"{self.path}: {where}: the file ends inside of a name; {ANEW}")
        self.at = end + 1
        with damage(f"{self.path}: {where}: a name that is not UTF-8; rename the picture"):
            return self.data[start:end].decode()

    def rows(self, least: int, what: str, read: Callable[[str], tuple[int, T]]) -> dict[int, T]:
        """All rows of the file by id: their number, and rows of at least so many bytes, which `read` reads."""
        (count,) = self.take("Q", f"the number of {what}s")
        if count * least > len(self.data) - self.at:
            raise ValueError(
                f"{self.path}: says {count} {what}s, which take {count * least} bytes or more; it has "
                f"{len(self.data) - self.at}; {ANEW}"
            )
        found = _by_id((read(f"{what} row {row}") for row in range(count)), self.path, what)
        if self.at < len(self.data):
            raise ValueError(f"{self.path}: has {len(self.data) - self.at} bytes behind its last {what}; {ANEW}")
        return found


def _binary_cameras(path: Path) -> dict[int, Lens]:
    file = Bytes(path)

    def read(where: str) -> tuple[int, Lens]:
        number, model, width, height = file.take("IiQQ", where)
        if not 0 <= model < len(MODELS):
            raise ValueError(f"{path}: {where}: camera model {model} is unknown; {ANEW}")
        values = file.take(f"{PARAMETERS[MODELS[model]]}d", where)
        return number, _camera(MODELS[model], width, height, values, f"{path}: camera {number}")

    return file.rows(CAMERA, "camera", read)


def _binary_images(path: Path) -> dict[int, Image]:
    file = Bytes(path)

    def read(where: str) -> tuple[int, Image]:
        number, *pose, camera = file.take("I7dI", where)
        name = file.text(where)
        (points,) = file.take("Q", where)
        file.skip(points * POINT, f"{where}: its {points} points")
        return number, _image(name, pose, camera, f"{path}: image {number}")

    return file.rows(IMAGE, "image", read)


def _cameras(path: Path) -> dict[int, Lens]:
    text = text_of(path)

    def read() -> Iterator[tuple[int, Lens]]:
        for number, line in enumerate(text.split("\n"), 1):
            words, where = line.split(), f"{path}: line {number}"
            if not words or words[0].startswith("#"):
                continue
            if len(words) < 4:
                raise ValueError(f"{where}: a camera needs an id, a model, width, height and parameters; {ANEW}")
            values = [number_of(word, where) for word in words[4:]]
            width, height = (whole_of(word, where) for word in words[2:4])
            yield whole_of(words[0], where), _camera(words[1], width, height, values, where)

    return _as_many_as_said(_by_id(read(), path, "camera"), text, path, "camera")


def _images(path: Path) -> dict[int, Image]:
    text = text_of(path)

    def read() -> Iterator[tuple[int, Image]]:
        lines = enumerate(text.split("\n"), 1)
        for number, line in lines:
            words, where = line.split(None, 9), f"{path}: line {number}"
            if not words or words[0].startswith("#"):
                continue
            if len(words) < 10:
                raise ValueError(
                    f"{where}: an image needs an id, a quaternion, a translation, a camera and a name; {ANEW}"
                )
            pose = [number_of(word, where) for word in words[1:8]]
            yield whole_of(words[0], where), _image(words[9].strip(), pose, whole_of(words[8], where), where)
            points = next(lines, (0, ""))[1]
            if points.strip(OF_POINTS) or len(points.split()) % 3:
                raise ValueError(
                    f"{path}: line {number + 1}: expected the points of {shortened(words[9].strip())}, three numbers "
                    "each; every image has a line of points behind its own, which may be empty"
                )

    return _as_many_as_said(_by_id(read(), path, "image"), text, path, "image")


def _camera(model: str, width: int, height: int, values, where: str) -> Lens:
    if model not in PARAMETERS:
        raise ValueError(f"{where}: camera model {shortened(model)} is unknown; {ANEW}")
    expected = PARAMETERS[model]
    if len(values) != expected:
        raise ValueError(f"{where}: a {model} camera has {expected} parameters, got {len(values)}; {ANEW}")
    check_pixels(width, height, where)
    parameters = tuple(finite(value, f"{where}: a parameter") for value in values)
    return Lens(model, parameters, width, height)


def _image(name: str, pose, camera: int, where: str) -> Image:
    pose = tuple(finite(value, f"{where}: the pose") for value in pose)
    length = sum(value * value for value in pose[:4]) ** 0.5
    if abs(length - 1) > UNIT:
        raise ValueError(f"{where}: the quaternion must have length 1, it has {length:g}; {ANEW}")
    return Image(name, tuple(value / length for value in pose[:4]), pose[4:], camera)


def _by_id(rows: Iterator[tuple[int, T]], path: Path, what: str) -> dict[int, T]:
    found: dict[int, T] = {}
    for number, row in rows:
        if number in found:
            raise ValueError(f"{path}: {what} {number} is there twice; take one out")
        found[number] = row
    return found


def _as_many_as_said(found: dict[int, T], text: str, path: Path, what: str) -> dict[int, T]:
    """The rows. Raises ValueError if a comment says more of them, as COLMAP writes it: the end of a text may be cut."""
    said = re.search(rf"^# Number of {what}s: (\d{{1,18}})\b", text, re.MULTILINE)
    if said and int(said[1]) > len(found):
        raise ValueError(
            f"{path}: has {len(found)} of the {said[1]} {what}s that its comment says; {ANEW}, or correct the comment"
        )
    return found


def number_of(word: str, where: str) -> float:
    """A number of a text. Raises ValueError, with the place."""
    with damage(f"{where}: expected a number, got {shortened(word)}"):
        return float(word.replace("_", "?"))  # 1_000 is Python's


def whole_of(word: str, where: str) -> int:
    """A whole number of a text. Raises ValueError, with the place."""
    with damage(f"{where}: expected a whole number, got {shortened(word)}"):
        value = int(word.replace("_", "?"))
    return whole(value, where, 0, max(LARGEST_ID, MOST_PIXELS))
