"""Shape plugins of Mitsuba 3 scene files, as meshes.

Curved shapes become inscribed meshes: a sphere has 5120 triangles, a circle 128 sides. Their normals are interpolated.
Normals are always computed from the vertices, so that they move with them (`Mesh.vertex_normals`). Normals stored in a
file only tell which corners share a normal. In a file without normals, corners that share a vertex share a normal.

A plugin makes a `Plan`, which finds a mesh file but does not read it. It is read when nothing else in the scene is
wrong.
"""

import functools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.load import Triangles, joined_arrays, normals_apart, read_parts
from jaxdr.geometry.mesh import MeshArrays, weld
from jaxdr.geometry.shapes import sphere
from jaxdr.scene.formats.attributes import Attributes, mesh_attributes
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.serialized import read_serialized
from jaxdr.scene.formats.mitsuba.values import tangent
from jaxdr.scene.formats.mitsuba.xml import NUMBER, Properties

SPHERE_SUBDIVISIONS = 4  # 5120 triangles, within 0.1 % of the radius
BENT = 2.0  # warn if stored normals and those of the triangles differ by more than this on average, in degrees
CIRCLE_SEGMENTS = 128  # within 0.03 % of the radius
# For every side of the cube the corners where UVs are (0, 0), (1, 0), (1, 1) and (0, 1). The number of a corner is
# 4 x + 2 y + z, with x, y and z 0 or 1.
CUBE_SIDES = np.array([[4, 5, 1, 0], [6, 2, 3, 7], [4, 6, 7, 5], [5, 7, 3, 1], [1, 3, 2, 0], [6, 4, 0, 2]])


class Source(NamedTuple):
    """Triangles in object space. `keeps_side`: in Mitsuba a mirroring transform leaves their outside outside."""

    arrays: MeshArrays
    keeps_side: bool
    attributes: Attributes


class Plan(NamedTuple):
    """A `<shape>` whose mesh is still to be made by `make`, with its transforms, BSDF and emitter.

    `flips`: whether it is turned inside out. `instance`: the transform of the instance, or None.
    """

    element: Element
    make: Callable[[], Source]
    to_world: Float[np.ndarray, "4 4"]
    flips: bool
    bsdf: Element | None
    emitter: Element | None
    instance: Float[np.ndarray, "4 4"] | None = None


def _planned(properties: Properties, source: MeshArrays | Callable[[], Source], keeps_side: bool = True) -> Plan:
    """The plan of a shape, from its triangles or a function that makes them."""
    to_world = properties.value("to_world", "transform", np.eye(4))
    if not np.linalg.det(to_world[:3, :3]):
        raise ValueError(f"to_world has no inverse: {to_world.tolist()}")
    flips = properties.value("flip_normals", "boolean", False)
    bsdf, emitter = properties.at_most_one("bsdf"), properties.at_most_one("emitter")
    if isinstance(source, MeshArrays):
        made = Source(source, keeps_side, {})
        return Plan(properties.element, lambda: made, to_world, flips, bsdf, emitter)
    return Plan(properties.element, source, to_world, flips, bsdf, emitter)


def _mesh_file(element: Element) -> Plan:
    """An OBJ or PLY file. UVs have (0, 0) at the lower left, as in OBJ files. Mitsuba turns v of a PLY file over."""
    properties = Properties(element)
    path = _path(properties)
    if path.suffix.lower() != f".{element.type}":
        raise ValueError(f"{path.name} is not a .{element.type} file")
    face_normals = properties.value("face_normals", "boolean", False)
    is_upright = properties.value("flip_tex_coords", "boolean", element.type == "obj")

    def make() -> Source:
        return _source(element, read_parts(path), face_normals, is_upright)

    return _planned(properties, make)


def _serialized(element: Element) -> Plan:
    """One mesh of a `serialized` file."""
    properties = Properties(element)
    path = _path(properties)
    face_normals = properties.value("face_normals", "boolean", False)
    index = properties.value("shape_index", "integer", 0)
    if index < 0:
        raise ValueError(f"shape_index must not be negative, got {index}")

    def make() -> Source:
        mesh = read_serialized(path, index)
        if mesh.face_normals and not face_normals:
            element.harmless(
                "the file asks for flat shading, which Mitsuba 3 does not read: the shape is smooth, as there; give "
                "face_normals to make it flat"
            )
        return _source(element, [mesh.triangles], face_normals, is_upright=False)

    return _planned(properties, make)


def _path(properties: Properties) -> Path:
    filename = properties.value("filename", "string")
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    return properties.element.find_file(filename)


def _source(element: Element, parts: Sequence[Triangles], face_normals: bool, is_upright: bool) -> Source:
    for part in parts:
        if part.uvs is not None and not is_upright:
            part.uvs = part.uvs * (1, -1) + (0, 1)
    arrays, rows = joined_arrays(parts, "flat" if face_normals else "vertex")
    stored = [part for part in parts if part.normals is not None]
    if arrays.normal_faces is not None and len(stored) == len(parts):
        apart = normals_apart(arrays, np.concatenate([part.corner_normals() for part in parts]))
        if apart > BENT:
            element.harmless(
                f"the stored normals are {apart:.1f} degrees from those of the triangles, on average; the shading "
                "follows the triangles, so that it moves with them"
            )
    # Stored normals keep their side when the shape is mirrored.
    return Source(arrays, bool(stored), mesh_attributes(parts, rows))


def _rectangle(element: Element) -> Plan:
    """The square [-1, 1]² in the plane z = 0, facing +z."""
    properties = Properties(element)
    properties.ignore("face_normals")  # flat anyway
    points = np.array([[-1.0, -1, 0], [1, -1, 0], [-1, 1, 0], [1, 1, 0]])
    uvs = np.array([[0.0, 1], [1, 1], [0, 0], [1, 0]])  # Mitsuba's with v turned over
    faces = np.array([[0, 1, 3], [0, 3, 2]])
    return _planned(properties, MeshArrays(points, faces, uvs, faces), keeps_side=True)


def _cube(element: Element) -> Plan:
    """The cube [-1, 1]³."""
    properties = Properties(element)
    properties.ignore("face_normals")  # flat anyway
    points = 2.0 * np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1) - 1
    corners = np.array([0, 1, 2, 0, 2, 3])
    uvs, uv_faces = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.tile(corners, 6).reshape(-1, 3)
    arrays = MeshArrays(points, CUBE_SIDES[:, corners].reshape(-1, 3), uvs, uv_faces)
    return _planned(properties, arrays, keeps_side=True)


def _sphere(element: Element) -> Plan:
    properties = Properties(element)
    radius = properties.value("radius", NUMBER, 1.0)
    center = properties.value("center", "point vector", np.zeros(3))
    if not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    ball = _unit_sphere()
    return _planned(properties, ball._replace(vertices=radius * ball.vertices + center), keeps_side=False)


@functools.cache
def _unit_sphere() -> MeshArrays:
    ball = sphere(SPHERE_SUBDIVISIONS)
    points, faces = np.asarray(ball.vertices, float), np.asarray(ball.faces)
    uvs = _around(points[faces])
    uvs[..., 1] = 1 - np.arccos(np.clip(points[faces][..., 2], -1, 1)) / np.pi
    return _smooth(points, faces, uvs)


def _disk(element: Element) -> Plan:
    """The unit disk in the plane z = 0, facing +z. u is the distance from the centre, and v goes around."""
    properties = Properties(element)
    rim, following = _circle()
    points = np.vstack([rim, np.zeros(3)])
    faces = np.stack([np.full(CIRCLE_SEGMENTS, CIRCLE_SEGMENTS), np.arange(CIRCLE_SEGMENTS), following], axis=1)
    uvs = np.stack([np.linalg.norm(points[faces], axis=-1), 1 - _around(points[faces])[..., 0]], axis=-1)
    uvs, uv_faces = weld(uvs.reshape(-1, 2), np.arange(faces.size).reshape(-1, 3))
    return _planned(properties, MeshArrays(points, faces, uvs, uv_faces), keeps_side=True)


def _cylinder(element: Element) -> Plan:
    """The side of a cylinder from p0 to p1, facing outwards, without caps. u goes around, and v along the axis."""
    properties = Properties(element)
    p0 = properties.value("p0", "point vector", np.zeros(3))
    p1 = properties.value("p1", "point vector", np.array([0.0, 0.0, 1.0]))
    radius = properties.value("radius", NUMBER, 1.0)
    length = np.linalg.norm(p1 - p0)
    if not (radius > 0 and length > 0):
        raise ValueError(f"radius and the distance of p0 and p1 must be positive, got {radius} and {length}")
    axis = (p1 - p0) / length
    frame = np.stack([tangent(axis), np.cross(axis, tangent(axis)), axis])
    rim, following = _circle()
    points = np.vstack([rim, rim + np.array([0, 0, 1])])
    first, n = np.arange(CIRCLE_SEGMENTS), CIRCLE_SEGMENTS
    faces = np.concatenate(
        [np.stack([first, following, following + n], 1), np.stack([first, following + n, first + n], 1)]
    )
    uvs = np.stack([_around(points[faces])[..., 0], 1 - points[faces][..., 2]], axis=-1)
    return _planned(properties, _smooth(points * (radius, radius, length) @ frame + p0, faces, uvs), keeps_side=True)


SHAPES: dict[str, Callable[[Element], Plan]] = {
    "obj": _mesh_file,
    "ply": _mesh_file,
    "serialized": _serialized,
    "rectangle": _rectangle,
    "cube": _cube,
    "sphere": _sphere,
    "disk": _disk,
    "cylinder": _cylinder,
}


def _smooth(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], corner_uvs: Float[np.ndarray, "F 3 2"]
) -> MeshArrays:
    uvs, uv_faces = weld(corner_uvs.reshape(-1, 2), np.arange(faces.size).reshape(-1, 3))
    return MeshArrays(points, faces, uvs, uv_faces, normal_faces=faces)


def _circle() -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """(points of the unit circle around z, index of the next point for each)."""
    angle = 2 * np.pi * np.arange(CIRCLE_SEGMENTS) / CIRCLE_SEGMENTS
    points = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return points, np.roll(np.arange(CIRCLE_SEGMENTS), -1)


def _around(corners: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F 3 2"]:
    """UVs (angle around z / 2π, 0) of the corners of triangles. In a triangle across the seam u goes beyond 1.

    A corner on the axis has no angle. It gets the mean of the other two.
    """
    u = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * np.pi) % 1
    on_axis = np.hypot(corners[..., 0], corners[..., 1]) < 1e-6
    off_axis = np.ma.masked_array(u, on_axis)
    u = np.where((np.ptp(off_axis, axis=1).filled(0) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    mean = np.ma.masked_array(u, on_axis).mean(axis=1).filled(0)
    u = np.where(on_axis, mean[:, None], u)
    return np.stack([u, np.zeros_like(u)], axis=-1)
