"""Mesh files: OBJ, PLY, GLB and STL, through trimesh."""

import io
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.mesh import Mesh, weld

EXTENSIONS = (".obj", ".ply", ".glb", ".stl")
SHADINGS = ("flat", "smooth", "file", "vertex")


def load_mesh(path: str | PathLike, shading: str = "flat") -> Mesh:
    """Read all triangles of a file as one mesh, in the file's units.

    Vertices at the same position are welded; UVs keep their own indices, so a seam does not split a vertex. The meshes
    of a GLB are joined, each at its node's place in the scene; where only some have UVs, the others get (0, 0).
    Materials are not read.

    `shading`: "flat"; "smooth", one normal per vertex; "file", where corners with the same position and the same
    stored normal share one normal, which is then computed from the triangles (flat where nothing is stored); or
    "vertex", the same, but where nothing is stored one normal per vertex of the file, so that edges at which the file
    splits its vertices (UV seams of an OBJ) stay hard, as in Mitsuba.

    Raises `ValueError` for an unknown extension or shading, a missing or unreadable file, one without triangles, and
    for whatever `Mesh` rejects.
    """
    if shading not in SHADINGS:
        raise ValueError(f"load_mesh: shading must be one of {', '.join(SHADINGS)}; got {shading!r}")
    parts = read_parts(path)
    try:
        return joined(parts, shading)
    except ValueError as error:
        raise ValueError(f"load_mesh: {path}: {error}") from error


def read_parts(path: str | PathLike) -> list["Part"]:
    """The triangle meshes of a file, each at its place. Raises `ValueError` as `load_mesh` does."""
    path = Path(path)
    _check_extension("load_mesh", path)
    if not path.is_file():
        raise ValueError(f"load_mesh: there is no file {path}")
    import trimesh  # on use: importing it takes longer than reading most files

    try:
        scene = trimesh.load_scene(path, process=False, **_parser_options(path))
    except Exception as error:  # trimesh's parsers let through whatever a broken file makes them raise
        raise ValueError(f"load_mesh: {path} is not a readable {path.suffix} file ({error})") from error
    nodes = [(scene.geometry[name], to_world) for to_world, name in map(scene.graph.get, scene.graph.nodes_geometry)]
    parts = [Part(geometry, to_world) for geometry, to_world in nodes if is_triangles(geometry)]
    if not parts:
        raise ValueError(f"load_mesh: {path} has no triangles")
    return parts


def joined(parts: Sequence["Part"], shading: str) -> Mesh:
    """One mesh of several parts; the shadings are those of `load_mesh`. Raises `ValueError` as `Mesh` does."""
    ends = np.cumsum([len(part.vertices) for part in parts])
    soup = np.concatenate([part.faces + end - len(part.vertices) for part, end in zip(parts, ends, strict=True)])
    vertices, faces = weld(np.concatenate([part.vertices for part in parts]), soup)
    uvs = uv_faces = normal_faces = None
    if any(part.uvs is not None for part in parts):
        filled = [np.zeros((len(part.vertices), 2)) if part.uvs is None else part.uvs for part in parts]
        uvs, uv_faces = weld(np.concatenate(filled), soup)
    has_normals = np.repeat([part.normals is not None for part in parts], [len(part.faces) for part in parts])
    if shading in ("file", "vertex") and has_normals.any():
        normal_faces = _smoothing_groups(faces, np.concatenate([part.corner_normals() for part in parts]))
    if shading == "vertex" and not has_normals.all():
        first_free = 0 if normal_faces is None else normal_faces.max() + 1
        by_vertex = first_free + np.unique(soup, return_inverse=True)[1].reshape(-1, 3)
        normal_faces = by_vertex if normal_faces is None else np.where(has_normals[:, None], normal_faces, by_vertex)
    mesh = Mesh(vertices, faces, uvs, uv_faces, normal_faces)
    return mesh.smooth() if shading == "smooth" else mesh


def save_mesh(path: str | PathLike, mesh: Mesh) -> None:
    """Write a mesh as OBJ, PLY, GLB or STL, by the extension; an existing file is replaced.

    OBJ keeps everything. GLB splits vertices where UVs or normals differ, PLY drops UVs, STL has positions only; all
    three store float32. `load_mesh` welds again, and with shading "file" finds the smoothing groups again. Raises
    `ValueError` for an unknown extension or a missing folder.
    """
    path = Path(path)
    _check_extension("save_mesh", path)
    if not path.parent.is_dir():
        raise ValueError(f"save_mesh: there is no folder {path.parent}")
    extension = path.suffix.lower()
    if extension == ".obj":
        path.write_text(_obj_text(mesh))
    else:
        _trimesh(mesh).export(path, file_type=extension[1:])


def _check_extension(caller: str, path: Path) -> None:
    if path.suffix.lower() not in EXTENSIONS:
        raise ValueError(f"{caller}: {path} has an unknown extension; known are {', '.join(EXTENSIONS)}")


def _parser_options(path: Path) -> dict[str, Any]:
    extension = path.suffix.lower()
    if extension == ".obj":
        return {"skip_materials": True}
    if extension == ".ply":
        # Splits the vertices at UV seams, but forgets to split the normals: only for UVs stored at the faces' corners.
        header = path.read_bytes().partition(b"end_header")[0]
        return {"fix_texture": b"texcoord" in header}
    return {}


def is_triangles(geometry: Any) -> bool:
    """Whether trimesh read triangles here, rather than points or lines."""
    import trimesh

    return isinstance(geometry, trimesh.Trimesh) and len(geometry.faces) > 0


class Part:
    """One mesh of a file, in world space; `uvs`, `normals` and `colors` belong to the vertices, or are None.

    `colors` are the numbers that a PLY file stores as r, g, b or red, green, blue.
    """

    def __init__(self, geometry: Any, to_world: Float[np.ndarray, "4 4"]):
        linear = to_world[:3, :3]
        self.vertices = geometry.vertices @ linear.T + to_world[:3, 3]
        self.faces = geometry.faces[:, ::-1] if np.linalg.det(linear) < 0 else geometry.faces
        uvs = getattr(geometry.visual, "uv", None)
        self.uvs = None if uvs is None else np.asarray(uvs)[:, :2]
        # trimesh computes the normals a file does not store; only its cache can tell the two apart.
        stored = "vertex_normals" in geometry._cache
        self.normals = _unit(geometry.vertex_normals @ np.linalg.pinv(linear)) if stored else None
        self.colors = _ply_colors(geometry)

    def corner_normals(self) -> Float[np.ndarray, "f 3 3"]:
        """The stored normal at each corner; where nothing is stored, the face's own, which makes it flat."""
        if self.normals is not None:
            return self.normals[self.faces]
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return np.repeat(_unit(np.cross(b - a, c - a))[:, None], 3, axis=1)


def _ply_colors(geometry: Any) -> Float[np.ndarray, "v 3"] | None:
    """Vertex colours in the precision of the file: those that trimesh makes of them have eight bits."""
    data = geometry.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
    names = data.keys() if isinstance(data, dict) else data.dtype.names or ()
    for channels in (("r", "g", "b"), ("red", "green", "blue")):
        if set(channels) <= set(names):
            colors = np.stack([np.asarray(data[name], float).reshape(-1) for name in channels], 1)
            return colors if len(colors) == len(geometry.vertices) else None  # vertices split at UV seams
    return None


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def _smoothing_groups(
    faces: Int[np.ndarray, "F 3"], corner_normals: Float[np.ndarray, "F 3 3"]
) -> Int[np.ndarray, "F 3"]:
    """Corner -> group of the corners with the same vertex and the same normal."""
    normals, normal_rows = weld(corner_normals.reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    _, groups = np.unique(faces * len(normals) + normal_rows, return_inverse=True)
    return groups.reshape(-1, 3)


def _split(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Corner triples (vertex, uv, normal group) that occur [n, 3], and the faces that index them."""
    columns = [mesh.faces, mesh.uv_faces, mesh.normal_faces]
    corners = np.stack([np.zeros(mesh.faces.size, int) if c is None else np.asarray(c).ravel() for c in columns], 1)
    triples, rows = np.unique(corners, axis=0, return_inverse=True)
    return triples, rows.reshape(-1, 3)


def _trimesh(mesh: Mesh) -> Any:
    """trimesh's Trimesh with one index for everything, as GLB and PLY want it."""
    import trimesh
    from trimesh.visual import TextureVisuals

    if mesh.uvs is None and mesh.normal_faces is None:  # nothing to split: keep the vertices in their order
        return trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)
    triples, faces = _split(mesh)
    return trimesh.Trimesh(
        np.asarray(mesh.vertices)[triples[:, 0]],
        faces,
        process=False,
        vertex_normals=None if mesh.normal_faces is None else np.asarray(mesh.vertex_normals())[triples[:, 2]],
        visual=None if mesh.uvs is None else TextureVisuals(uv=np.asarray(mesh.uvs)[triples[:, 1]]),
    )


def _obj_text(mesh: Mesh) -> str:
    """OBJ indexes positions, UVs and normals separately, as Mesh does, and can hold every digit."""
    text = io.StringIO()
    normals = None if mesh.normal_faces is None else mesh.vertex_normals()
    for keyword, values in (("v", mesh.vertices), ("vt", mesh.uvs), ("vn", normals)):
        if values is not None:
            number = f" %.{np.finfo(values.dtype).precision + 3}g"  # enough digits to read back the same number
            np.savetxt(text, np.asarray(values), fmt=keyword + number * values.shape[1])
    indices = [rows for rows in (mesh.faces, mesh.uv_faces, mesh.normal_faces) if rows is not None]
    corner = " %d" + ("/" if mesh.uvs is None and normals is not None else "") + "/%d" * (len(indices) - 1)
    np.savetxt(text, np.stack(indices, axis=-1).reshape(len(mesh.faces), -1) + 1, fmt="f" + corner * 3)
    return text.getvalue()
