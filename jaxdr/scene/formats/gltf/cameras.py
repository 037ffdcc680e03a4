"""Cameras of glTF files, and a camera that frames the scene of a file without any."""

import numpy as np

from jaxdr.geometry.gltf.document import Document, number
from jaxdr.geometry.gltf.nodes import Node, named
from jaxdr.scene.camera import Camera, Orthographic, Perspective, look_at
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Shape
from jaxdr.untrusted import LARGEST, check_pixels, shortened

SMALLEST = 1 / LARGEST  # length, and ratio of lengths
FRAMING_FOV = 40.0  # degrees
FRAMING_DIRECTION = np.array([0.4, 0.3, 1.0])  # from the scene to the camera: assets face +z, and y is up


def read_camera(
    document: Document,
    nodes: list[Node],
    shapes: dict[str, Shape],
    width: int,
    height: int | None,
    chosen: str | int | None = None,
) -> Camera:
    """The chosen camera of the file, by default the first, or one that frames the scene if there is none.

    Raises ValueError for a choice that is none of them, or more than one.
    """
    cameras = list(named(nodes, "camera"))
    if chosen is None and not cameras:
        return _framing(shapes, width, height)
    node, index = cameras[0 if chosen is None else _number(document, cameras, chosen)]
    camera = document.item("cameras", index, node.label)
    with document.at(document.label("cameras", index)):
        matrix = node.to_world @ np.diag([-1.0, 1, -1, 1])  # glTF looks along -z with x to the right
        lengths = np.linalg.norm(matrix[:3, :3], axis=0)
        if not (lengths > 0).all():
            raise ValueError(f"{node.label} scales it to nothing")
        matrix[:3, :3] /= lengths
        kind = camera["type"]
        if kind not in LENSES:
            raise ValueError(f"a camera must be of type {' or '.join(LENSES)}, not {shortened(kind)}")
        return LENSES[kind](matrix, camera[kind], width, height)


def _number(document: Document, cameras: list[tuple[Node, int]], chosen: str | int) -> int:
    """The number of the camera with this number or name; the names of a camera are its node's and its own."""
    owners = [(node.header, document.item("cameras", index, node.label)) for node, index in cameras]
    names = [list(dict.fromkeys(owner["name"] for owner in pair if owner.get("name"))) for pair in owners]
    listed = ", ".join(f"{i}: " + (" or ".join(map(repr, found)) or "without name") for i, found in enumerate(names))
    if isinstance(chosen, int) and not isinstance(chosen, bool) and 0 <= chosen < len(cameras):
        return chosen
    found = [number for number, own in enumerate(names) if chosen in own]
    if not found:
        raise ValueError(f"there is no camera {chosen!r}; the scene has {listed or 'none'}")
    if len(found) > 1:
        raise ValueError(f"several cameras are called {chosen!r}; choose one by its number: {listed}")
    return found[0]


def _perspective(matrix: np.ndarray, lens: dict, width: int, height: int | None) -> Perspective:
    aspect = _positive(lens, "aspectRatio", 1.0)
    film = _film(width, height or max(1, round(width / aspect)))
    near, angle = _positive(lens, "znear"), np.degrees(_positive(lens, "yfov"))
    return Perspective(matrix, angle, film, "y", near, _positive(lens, "zfar", min(1e6 * near, LARGEST)))


def _orthographic(matrix: np.ndarray, lens: dict, width: int, height: int | None) -> Orthographic:
    """A camera without perspective. `xmag` and `ymag` are half the width and half the height of what it shows."""
    x, y = (abs(number(lens, name, -LARGEST)) for name in ("xmag", "ymag"))
    if not x > 0 < y:
        raise ValueError("xmag and ymag must not be zero")
    near, far = number(lens, "znear", 0.0), _positive(lens, "zfar")
    film = _film(width, height or max(1, round(width * (y / x))))
    # The film covers y in proportion to its height. With this scale its upper edge is at `ymag`.
    matrix = matrix @ np.diag([x, y * film.width / film.height, 1, 1])
    return Orthographic(matrix, film, max(near, 1e-6 * far), far)


def _film(width: int, height: int) -> Film:
    check_pixels(width, height, "the film")
    return Film(width, height)


def _positive(lens: dict, name: str, default: float | None = None) -> float:
    return number(lens, name, SMALLEST, default=default)


LENSES = {"perspective": _perspective, "orthographic": _orthographic}


def _framing(shapes: dict[str, Shape], width: int, height: int | None) -> Perspective:
    points = np.concatenate([np.asarray(shape.mesh.vertices) for shape in shapes.values()])
    lower, upper = points.min(0), points.max(0)
    centre, radius = (lower + upper) / 2, np.linalg.norm(upper - lower) / 2
    distance = radius / np.sin(np.radians(FRAMING_FOV) / 2)
    origin = centre + distance * FRAMING_DIRECTION / np.linalg.norm(FRAMING_DIRECTION)
    matrix = look_at(origin, centre, (0, 1, 0))
    return Perspective(matrix, FRAMING_FOV, Film(width, height or width), "smaller", 1e-3 * distance, 1e3 * distance)
