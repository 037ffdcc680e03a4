"""Shape plugins of Mitsuba 3 scene files, as meshes.

Curved shapes are inscribed: a sphere has 5120 triangles, a circle 128 sides; their normals are interpolated. Where a
mesh file stores no normals, corners that share a vertex of the file share one. Those stored only tell which corners
share one: normals are always computed from the vertices, so that they follow them (`Mesh.vertex_normals`).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.load import Part, joined, read_parts
from jaxdr.geometry.mesh import Mesh, weld
from jaxdr.geometry.shapes import rectangle, sphere, transformed
from jaxdr.scene.bsdf import Diffuse
from jaxdr.scene.mitsuba_bsdfs import read_bsdf
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_emitters import read_shape_emitter
from jaxdr.scene.mitsuba_names import object_names, parameter_name
from jaxdr.scene.mitsuba_textures import VERTEX_COLOR
from jaxdr.scene.mitsuba_values import tangent
from jaxdr.scene.mitsuba_xml import NUMBER, Properties, read_plugin
from jaxdr.scene.scene import Shape

SPHERE_SUBDIVISIONS = 4  # 5120 triangles, within 0.1 % of the radius
CIRCLE_SEGMENTS = 128  # within 0.03 % of the radius
# Corners 4 x + 2 y + z of the cube, x, y and z 0 or 1: where UVs are (0, 0), (1, 0), (1, 1) and (0, 1) on every side.
CUBE_SIDES = np.array([[4, 5, 1, 0], [6, 2, 3, 7], [4, 6, 7, 5], [5, 7, 3, 1], [1, 3, 2, 0], [6, 4, 0, 2]])


def _mesh_file(element: Element) -> Shape:
    """An OBJ or PLY file. UVs are as in an OBJ, (0, 0) at the lower left; Mitsuba takes those of a PLY upside down."""
    properties = Properties(element)
    filename = properties.value("filename", "string")
    face_normals = properties.value("face_normals", "boolean", False)
    is_upright = properties.value("flip_tex_coords", "boolean", element.type == "obj")
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    if not filename.lower().endswith(f".{element.type}"):
        raise ValueError(f"{filename} is not a .{element.type} file")
    path = element.find_file(filename)
    parts = read_parts(path)
    for part in parts:
        if part.uvs is not None and not is_upright:
            part.uvs = part.uvs * (1, -1) + (0, 1)
    try:
        mesh = joined(parts, "flat" if face_normals else "vertex")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    # Stored normals keep their side when the shape is mirrored.
    return _placed(properties, mesh, any(part.normals is not None for part in parts), _vertex_data(parts))


def _vertex_data(parts: list[Part]) -> dict[str, Float[np.ndarray, "V 3"] | None]:
    """Colours of the mesh's vertices, which are those of the file joined by position; None where these differ."""
    colors = [part.colors for part in parts if part.colors is not None]
    if len(colors) < len(parts):
        return {}
    stored = np.concatenate(colors)
    vertices, row = weld(np.concatenate([part.vertices for part in parts]), np.tile(np.arange(len(stored))[:, None], 3))
    joined_colors = np.zeros((len(vertices), 3))
    joined_colors[row[:, 0]] = stored
    return {VERTEX_COLOR: joined_colors if np.array_equal(joined_colors[row[:, 0]], stored) else None}


def _rectangle(element: Element) -> Shape:
    """The square [-1, 1]² in the plane z = 0, facing +z."""
    properties = Properties(element)
    properties.ignore("face_normals")  # flat anyway
    mesh = rectangle(2.0, 2.0)
    upside_down = Mesh(mesh.vertices, mesh.faces, np.asarray(mesh.uvs) * (1, -1) + (0, 1), mesh.uv_faces)
    return _placed(properties, upside_down, keeps_side=True)


def _cube(element: Element) -> Shape:
    """The cube [-1, 1]³."""
    properties = Properties(element)
    properties.ignore("face_normals")  # flat anyway
    points = 2.0 * np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1) - 1
    corners = np.array([0, 1, 2, 0, 2, 3])
    uvs, uv_faces = [[0, 0], [1, 0], [1, 1], [0, 1]], np.tile(corners, 6).reshape(-1, 3)
    return _placed(properties, Mesh(points, CUBE_SIDES[:, corners].reshape(-1, 3), uvs, uv_faces), keeps_side=True)


def _sphere(element: Element) -> Shape:
    properties = Properties(element)
    radius = properties.value("radius", NUMBER, 1.0)
    center = properties.value("center", "point vector", np.zeros(3))
    ball = sphere(SPHERE_SUBDIVISIONS)
    points, faces = np.asarray(ball.vertices, float), np.asarray(ball.faces)
    uvs = _around(points[faces])
    uvs[..., 1] = 1 - np.arccos(np.clip(points[faces][..., 2], -1, 1)) / np.pi
    if not radius > 0:
        raise ValueError(f"radius must be positive, got {radius}")
    return _placed(properties, _smooth(radius * points + center, faces, uvs), keeps_side=False)


def _disk(element: Element) -> Shape:
    """The unit disk in the plane z = 0, facing +z; u is the distance from the centre, v goes around."""
    properties = Properties(element)
    rim, following = _circle()
    points = np.vstack([rim, np.zeros(3)])
    faces = np.stack([np.full(CIRCLE_SEGMENTS, CIRCLE_SEGMENTS), np.arange(CIRCLE_SEGMENTS), following], axis=1)
    uvs = np.stack([np.linalg.norm(points[faces], axis=-1), 1 - _around(points[faces])[..., 0]], axis=-1)
    uvs, uv_faces = weld(uvs.reshape(-1, 2), np.arange(faces.size).reshape(-1, 3))
    return _placed(properties, Mesh(points, faces, uvs, uv_faces), keeps_side=True)


def _cylinder(element: Element) -> Shape:
    """The side of a cylinder from p0 to p1, facing outwards, without caps; u goes around, v along."""
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
    return _placed(properties, _smooth(points * (radius, radius, length) @ frame + p0, faces, uvs), keeps_side=True)


SHAPES: dict[str, Callable[[Element], Shape]] = {
    "obj": _mesh_file,
    "ply": _mesh_file,
    "rectangle": _rectangle,
    "cube": _cube,
    "sphere": _sphere,
    "disk": _disk,
    "cylinder": _cylinder,
}


def _placed(properties: Properties, mesh: Mesh, keeps_side: bool, vertex_data: dict | None = None) -> Shape:
    """The shape with its transform, sides, BSDF and emitter.

    `keeps_side`: a mirroring transform leaves its outside outside in Mitsuba. `vertex_data` for its textures, by name.
    """
    to_world = properties.value("to_world", "transform", np.eye(4))
    flips = properties.value("flip_normals", "boolean", False)
    properties.element.vertex_data = vertex_data or {}
    bsdf, emitter = properties.at_most_one("bsdf"), properties.at_most_one("emitter")
    if not np.array_equal(to_world, np.eye(4)):
        # `transformed` keeps the outside outside; in Mitsuba a mirrored file's triangles turn over instead.
        flips ^= bool(np.linalg.det(to_world) < 0) and not keeps_side
        mesh = transformed(mesh, to_world)
    default = Diffuse(0.5 if emitter is None else 0.0)  # Mitsuba's: a light reflects nothing
    material = default if bsdf is None else read_bsdf(bsdf)
    return Shape(_reversed(mesh) if flips else mesh, material, read_shape_emitter(emitter))


def _reversed(mesh: Mesh) -> Mesh:
    """The mesh inside out."""
    turned = {
        name: None if faces is None else np.asarray(faces)[:, ::-1]
        for name, faces in (("uv_faces", mesh.uv_faces), ("normal_faces", mesh.normal_faces))
    }
    return Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)[:, ::-1], mesh.uvs, **turned)


def _smooth(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], corner_uvs: Float[np.ndarray, "F 3 2"]
) -> Mesh:
    uvs, uv_faces = weld(corner_uvs.reshape(-1, 2), np.arange(faces.size).reshape(-1, 3))
    return Mesh(points, faces, uvs, uv_faces, normal_faces=faces)


def _circle() -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Points of the unit circle around z, and for each the number of the next one."""
    angle = 2 * np.pi * np.arange(CIRCLE_SEGMENTS) / CIRCLE_SEGMENTS
    points = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return points, np.roll(np.arange(CIRCLE_SEGMENTS), -1)


def _around(corners: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F 3 2"]:
    """UVs (angle around z / 2π, 0) of triangles' corners: a triangle across the seam goes beyond 1 instead of back.

    On the axis, where the angle is anything, it is the mean of the triangle's other two.
    """
    u = np.arctan2(corners[..., 1], corners[..., 0]) / (2 * np.pi) % 1
    on_axis = np.hypot(corners[..., 0], corners[..., 1]) < 1e-6
    off_axis = np.ma.masked_array(u, on_axis)
    u = np.where((np.ptp(off_axis, axis=1).filled(0) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    mean = np.ma.masked_array(u, on_axis).mean(axis=1).filled(0)
    u = np.where(on_axis, mean[:, None], u)
    return np.stack([u, np.zeros_like(u)], axis=-1)


# Groups: several shapes in one, flattened.


def _shape_group(element: Element) -> list[tuple[str, Shape]]:
    """The shapes inside with their names; they are seen only through instances."""
    inside = Properties(element).objects("shape")
    shapes = [(name, read_shape(child)) for name, child in zip(object_names(inside), inside, strict=True)]
    return [(name, shape) for name, shape in shapes if shape is not None]


def _instance(element: Element) -> list[tuple[str, Shape]]:
    """The shapes of a group in another place, as meshes of their own."""
    properties = Properties(element)
    to_world = properties.value("to_world", "transform", np.eye(4))
    group = properties.at_most_one("shape")
    if group is None or group.type != "shapegroup":
        raise ValueError("needs a shapegroup inside")
    shapes = read_plugin(group, GROUPS, "it is left out") or []
    return [(name, Shape(transformed(s.mesh, to_world), s.bsdf, s.emitter)) for name, s in shapes]


GROUPS: dict[str, Callable[[Element], list[tuple[str, Shape]]]] = {"shapegroup": _shape_group, "instance": _instance}


def read_shape(element: Element) -> Shape | None:
    """A `<shape>` in world space; None where it can't be read, which is noted as a problem."""
    return read_plugin(element, SHAPES, "it is left out")


def read_shapes(elements: list[Element]) -> dict[str, Shape]:
    """What the `<shape>`s of a scene show, by name: one each, none for a group as such, what is inside for an instance.

    Shapes of an instance of several are named by its name, `_` and theirs. A name that can't be is noted.
    """
    found: dict[str, Shape] = {}
    for name, element in zip(object_names(elements), elements, strict=True):
        if element.type in GROUPS:
            inside = read_plugin(element, GROUPS, "it is left out") or []
            shapes = [(f"{name}_{inner}" if len(inside) > 1 else name, shape) for inner, shape in inside]
        else:
            shapes = [(name, read_shape(element))]
        for wanted, shape in shapes:
            whole = parameter_name(element, wanted)
            if whole in found:
                element.problems.add(element, element.place(f"a second shape {whole!r}; give one of them another id"))
            elif shape is not None and element.type != "shapegroup":
                found[whole] = shape
    return found
