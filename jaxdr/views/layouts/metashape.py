"""Agisoft Metashape (PhotoScan): cameras that are exported as XML, and pictures in `images` or beside the file.

Poses are x to the right, y down, z forward, in the frame of the chunk. What the chunk or its component says of the
world is applied, except for georeferenced ones: their world has its origin in the middle of the earth.
"""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.callers_line import warn
from jaxdr.images import READERS
from jaxdr.untrusted import shortened
from jaxdr.views.frames import Frame, all_there, some_of
from jaxdr.views.layouts.matrices import ANEW, numbers_in, pictures_in, pose_of
from jaxdr.views.layouts.metashape_lens import lens_of
from jaxdr.views.lens import Lens
from jaxdr.views.masks import find_mask
from jaxdr.views.pictures import find_picture
from jaxdr.xml_file import Node, read_tree

NAME = "exported cameras *.xml (Metashape)"
HEAD = 4096  # bytes in which the first elements are
OFF = ("0", "false")
# Origins farther away than so many times the extent of the cameras cost float32 a share of a pixel.
FAR = 1000


class Camera(NamedTuple):
    """A camera with a pose: rotation and position in the chunk, and the ids of its sensor and its component."""

    label: str
    rotation: Float[np.ndarray, "3 3"]
    position: Float[np.ndarray, "3"]
    sensor: str
    component: str | None


class World(NamedTuple):
    """From a chunk to the world: x to scale * rotation @ x + translation."""

    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]
    scale: float


def files(folder: Path) -> list[Path]:
    """The files of cameras; none where there are none."""
    return sorted(path for path in folder.glob("*.xml") if path.is_file() and _is_export(path))


def _is_export(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(HEAD)
    except OSError:  # told by those who need it
        return False
    return re.search(rb"<document\b[^>]*>\s*<chunk\b", head) is not None


def frames(folder: Path) -> list[Frame]:
    """The aligned and enabled cameras, in the order of the file. Raises ValueError, with the file.

    Warns of cameras without a pose, with a count, and of a world that is too far away.
    """
    path, *more = files(folder)
    if more:
        raise ValueError(
            f"{folder}: has several exports of cameras, {some_of(f.name for f in (path, *more))}; keep one"
        )
    chunks = list(read_tree(path).all("chunk"))
    if len(chunks) != 1:
        raise ValueError(f"{path}: has {len(chunks)} chunks; export the cameras of one")
    (chunk,) = chunks
    cameras = _cameras(path, chunk)
    world = _world(path, chunk, cameras)
    lenses = _lenses(path, chunk, {camera.sensor for camera in cameras})
    place = folder / "images" if (folder / "images").is_dir() else folder
    names = _names(path, place, cameras)

    def frame(camera: Camera) -> Frame:
        source = _where(path, camera.label)
        pose = pose_of(
            (world.rotation @ camera.rotation).T,
            world.scale * world.rotation @ camera.position + world.translation,
            source,
        )
        picture = find_picture(place, names[camera.label], path)
        return Frame(picture, find_mask(folder, picture, picture.name), pose, source, lenses[camera.sensor])

    return all_there(cameras, frame, path)


def _where(path: Path, label: str) -> str:
    return f"{path}: camera {shortened(label)}"


def _cameras(path: Path, chunk: Node) -> list[Camera]:
    """The cameras with a pose. Raises ValueError if there are none."""
    found, unaligned = [], []
    for node in _entries(chunk.first("cameras")):
        if node.attributes.get("enabled", "1").lower() in OFF:
            continue
        label, sensor = (node.attributes.get(name) for name in ("label", "sensor_id"))
        if label is None or sensor is None:
            raise ValueError(f"{path}: camera {len(found)} has no label or no sensor_id; {ANEW}")
        transform = node.first("transform")
        if transform is None:
            unaligned.append(label)
            continue
        where = _where(path, label)
        matrix = np.array(numbers_in(transform.text, 16, where)).reshape(4, 4)
        if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
            raise ValueError(f"{where}: the last row of its transform must be 0 0 0 1; {ANEW}")
        found.append(Camera(label, matrix[:3, :3], matrix[:3, 3], sensor, node.attributes.get("component_id")))
    if not found:
        raise ValueError(f"{path}: has no camera with a pose; align the photographs and export the cameras")
    if unaligned:
        count = len(unaligned) + len(found)
        warn(f"{path}: {len(unaligned)} of {count} cameras have no pose and are left out: {some_of(unaligned)}")
    return found


def _entries(group: Node | None) -> Iterator[Node]:
    """Cameras, also those in groups."""
    for node in group.children if group is not None else ():
        if node.tag == "camera":
            yield node
        elif node.tag == "group":
            yield from _entries(node)


def _lenses(path: Path, chunk: Node, used: set[str]) -> dict[str, Lens]:
    sensors = chunk.first("sensors")
    there = {sensor.attributes.get("id"): sensor for sensor in (sensors.all("sensor") if sensors is not None else ())}
    missing = sorted(used - set(there))
    if missing:
        raise ValueError(f"{path}: cameras have the sensor {shortened(missing[0])}, which is not there; {ANEW}")
    return {name: lens_of(there[name], f"{path}: sensor {shortened(name)}") for name in sorted(used)}


def _world(path: Path, chunk: Node, cameras: list[Camera]) -> World:
    """How the chunk lies in the world; as it is if nothing says so, or if the world is too far away."""
    used = {camera.component for camera in cameras}
    if len(used) > 1:
        raise ValueError(
            f"{path}: the cameras are in {len(used)} components, which may lie anywhere to each other; merge them, or "
            "disable all but one"
        )
    components = chunk.first("components")
    own = [node for node in (components.all("component") if components else ()) if node.attributes.get("id") in used]
    transform = next((found for node in (*own, chunk) if (found := node.first("transform")) is not None), None)
    still = World(np.eye(3), np.zeros(3), 1.0)
    if transform is None:
        return still
    world = _world_of(transform, f"{path}: the transform of its chunk")
    positions = np.stack([camera.position for camera in cameras]) @ (world.scale * world.rotation.T) + world.translation
    extent = np.linalg.norm(positions - positions.mean(0), axis=1).max()
    if extent and np.linalg.norm(positions, axis=1).max() > FAR * extent:
        warn(
            f"{path}: cameras are more than {FAR} times their extent away from the origin, as in geographic "
            "coordinates; they are read in the frame and the units of the chunk"
        )
        return still
    return world


def _world_of(transform: Node, where: str) -> World:
    """Rotation, translation and scale, which older versions write as one matrix."""
    if not transform.children:
        matrix = np.array(numbers_in(transform.text, 16, where)).reshape(4, 4)
        scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        rotation, translation = matrix[:3, :3], matrix[:3, 3]
        rotation = rotation / scale if scale else rotation
    else:
        parts = {name: transform.first(name) for name in ("rotation", "translation", "scale")}
        sizes, default = (9, 3, 1), ("1 0 0 0 1 0 0 0 1", "0 0 0", "1")
        values = [
            np.array(numbers_in(text if node is None else node.text, size, f"{where}: {name}"))
            for (name, node), size, text in zip(parts.items(), sizes, default, strict=True)
        ]
        rotation, translation, scale = values[0].reshape(3, 3), values[1], float(values[2][0])
    if not (scale > 0 and np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0):
        raise ValueError(f"{where}: must be a rotation, a translation and a scale above zero; {ANEW}")
    return World(rotation, translation, scale)


def _names(path: Path, place: Path, cameras: list[Camera]) -> dict[str, str]:
    """Names of pictures by the labels of cameras: these may lack a suffix, or have folders before.

    A label without a picture is its name. Raises ValueError for a picture of two cameras.
    """
    order = list(READERS)
    pictures = sorted(pictures_in(place), key=lambda path: order.index(path.suffix.lower()), reverse=True)
    # Cameras write .JPG: what a label without suffix means is looked up, not guessed.
    there = {picture.stem: picture.name for picture in pictures} | {picture.name: picture.name for picture in pictures}
    names = [there.get(camera.label) or there.get(re.split(r"[/\\]", camera.label)[-1]) for camera in cameras]
    names = [name or camera.label for name, camera in zip(names, cameras, strict=True)]
    ((name, count),) = Counter(names).most_common(1)
    if count > 1:
        raise ValueError(f"{path}: {count} cameras have the picture {shortened(name)}; rename pictures and cameras")
    return {camera.label: name for name, camera in zip(names, cameras, strict=True)}
