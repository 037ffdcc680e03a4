"""Meshes of glTF primitives. A primitive is welded once, and placed wherever nodes and their instances have it."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.gltf.primitives import Primitive
from jaxdr.geometry.load import smoothing_groups
from jaxdr.geometry.mesh import Mesh, weld
from jaxdr.untrusted import LARGEST


@dataclasses.dataclass
class Geometry:
    """The triangles of a primitive in its own space, as arguments of `Mesh`, and the colours of the vertices if any."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "T 2"] | None
    uv_faces: Int[np.ndarray, "F 3"] | None
    normal_faces: Int[np.ndarray, "F 3"] | None
    colors: Float[np.ndarray, "V C"] | None


def welded(primitive: Primitive, positions: Float[np.ndarray, "V 3"], uv_set: int | None, channels: int) -> Geometry:
    """The geometry of a primitive at these positions. Vertices at the same position become one, if their colours agree.

    `uv_set` is the number of the texture coordinates to take, and `channels` the number of channels of COLOR_0. v goes
    up here, and down in glTF.
    """
    soup, attributes = primitive.faces, primitive.attributes
    colors = attributes["COLOR_0"][:, :channels].astype(np.float32) if channels else None
    rows = positions if colors is None else np.concatenate([positions, colors], 1)
    used, soup_of_used = np.unique(soup, return_inverse=True)
    rows, faces = weld(rows[used], soup_of_used.reshape(-1, 3))
    uvs = uv_faces = normal_faces = None
    if uv_set is not None:
        stored = attributes[f"TEXCOORD_{uv_set}"].astype(float)[used]
        uvs, uv_faces = weld(stored * (1, -1) + (0, 1), soup_of_used.reshape(-1, 3))
    if "NORMAL" in attributes:
        normal_faces = smoothing_groups(faces, attributes["NORMAL"].astype(float)[soup])
    return Geometry(rows[:, :3], faces, uvs, uv_faces, normal_faces, None if colors is None else rows[:, 3:])


class Placer:
    """Makes meshes from geometries. A second mesh of the same geometry shares the topology of the first."""

    def __init__(self) -> None:
        self._meshes: dict[tuple[int, bool], Mesh] = {}

    def mesh(self, geometry: Geometry, places: Float[np.ndarray, "n 4 4"]) -> Mesh:
        """One mesh that holds the geometry at each of these places. A mirroring place turns the triangles over."""
        linear, moved = places[:, :3, :3], places[:, None, :3, 3]
        vertices = np.einsum("nkl,vl->nvk", linear, geometry.vertices) + moved
        if not (np.abs(vertices) <= LARGEST).all():
            raise ValueError(f"its vertices go beyond {LARGEST:g} where its node puts them")
        determinants = np.linalg.det(linear)
        flips = determinants < 0
        if len(places) > 1 or determinants[0] == 0:
            return _joined(geometry, vertices, flips)
        key = (id(geometry), bool(flips[0]))
        if key not in self._meshes:
            self._meshes[key] = _joined(geometry, vertices, flips)
            return self._meshes[key]
        known = self._meshes[key]
        if len(known.faces) < len(geometry.faces):  # the known mesh dropped faces without area
            return _joined(geometry, vertices, flips)
        return known.with_vertices(vertices[0])


def _joined(geometry: Geometry, vertices: Float[np.ndarray, "n V 3"], flips: np.ndarray) -> Mesh:
    """One mesh of copies of a geometry with these vertices. The copies share the UVs."""
    n, count = vertices.shape[:2]

    def copies(faces: Int[np.ndarray, "F 3"], offset: int) -> Int[np.ndarray, "copied 3"]:
        turned = np.where(flips[:, None, None], faces[None, :, ::-1], faces[None])
        return (turned + offset * np.arange(n)[:, None, None]).reshape(-1, 3)

    uv_faces, normal_faces = geometry.uv_faces, geometry.normal_faces
    return Mesh(
        vertices.reshape(-1, 3),
        copies(geometry.faces, count),
        geometry.uvs,
        None if uv_faces is None else copies(uv_faces, 0),
        None if normal_faces is None else copies(normal_faces, int(normal_faces.max()) + 1),
    )


def mirrored_uvs(mesh: Mesh) -> float:
    """The share of faces on which a texture is mirrored, seen from outside."""
    if mesh.uvs is None:
        return 0.0
    (a, b, c) = np.moveaxis(np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)].astype(float), 1, 0)
    (ab, ac) = b - a, c - a
    return float(np.mean(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0] < 0))
