"""PLY files: their vertices and faces as triangles. See `ply_elements` for what is in the bytes."""

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.formats.ply_elements import Columns, read_elements
from jaxdr.geometry.formats.triangles import Triangles, check_corners, check_numbers, fans, split_vertices, unit

INDICES = ("vertex_indices", "vertex_index")
UVS = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))  # names that programs give them
COLORS = {"red", "r"}


def read_ply(content: bytes) -> list[Triangles]:
    """The polygons of a file as triangles, see `fans`. UVs at the corners of faces split vertices.

    Raises ValueError for a damaged file, and for indices out of range.
    """
    elements = read_elements(content)
    vertex, face = (elements.get(name, Columns(0, {}, {})) for name in ("vertex", "face"))
    if not face.count:
        return []
    vertices = _vectors(vertex, ("x", "y", "z"))
    if vertices is None:
        raise ValueError("the vertices need x, y and z")
    check_numbers("vertices", vertices)
    normals = _vectors(vertex, ("nx", "ny", "nz"))
    uvs = next((found for names in UVS if (found := _vectors(vertex, names)) is not None), None)
    for name, values in (("normals", normals), ("uvs", uvs)):
        if values is not None:
            check_numbers(name, values)
    counts, corners = _polygons(face, len(vertices))
    places, _ = fans(counts)
    faces = corners[places]
    stored = {"vertex": vertex.scalars, "face": face.scalars if (counts == 3).all() else {}}
    at_corners = _corner_uvs(face, counts)
    if at_corners is not None:
        uvs, rows = np.unique(at_corners, axis=0, return_inverse=True)
        faces, (kept, uv_rows) = split_vertices([faces, rows.reshape(-1)[places]])
        vertices, uvs = vertices[kept], uvs[uv_rows]
        normals = None if normals is None else normals[kept]
        stored["vertex"] = {}
    colored = "vertices" if COLORS & {*vertex.scalars} else "faces" if COLORS & {*face.scalars} else None
    return [Triangles(vertices, faces, uvs, None if normals is None else unit(normals), stored, colored)]


def _vectors(columns: Columns, names: tuple[str, ...]) -> Float[np.ndarray, "n _"] | None:
    if not all(name in columns.scalars for name in names):
        return None
    return np.stack([columns.scalars[name] for name in names], axis=1).astype(float)


def _polygons(face: Columns, count: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " c"]]:
    """(numbers of the corners of the faces, vertices of all corners in turn)."""
    name = next((name for name in INDICES if name in face.lists), None)
    if name is None and len(face.lists) == 1:
        (name,) = face.lists
    if name is None:
        raise ValueError(f"the faces have no list {' or '.join(INDICES)}")
    counts, corners = face.lists[name]
    if corners.dtype.kind not in "iu":
        raise ValueError(f"the numbers in {name} must be whole, not {corners.dtype}")
    if counts.min() < 3:
        row = int(np.argmin(counts))
        raise ValueError(f"face {row} needs at least three corners, got {counts[row]}")
    check_corners(corners, counts, count)
    return counts, corners.astype(np.int64)


def _corner_uvs(face: Columns, counts: Int[np.ndarray, " n"]) -> Float[np.ndarray, "c 2"] | None:
    """Texture coordinates of all corners in turn, if faces have them."""
    if "texcoord" not in face.lists:
        return None
    lengths, values = face.lists["texcoord"]
    if not (lengths == 2 * counts).all():
        row = int(np.argmax(lengths != 2 * counts))
        raise ValueError(f"face {row} has {lengths[row]} texture coordinates for {counts[row]} corners; give two each")
    uvs = values.reshape(-1, 2).astype(float)
    check_numbers("uvs", uvs)
    return uvs
