"""Mesh files: OBJ, PLY, GLB and STL."""

import io
import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxdr.argument_kinds import checked
from jaxdr.atomic_file import atomic_path
from jaxdr.callers_line import warn
from jaxdr.geometry.formats.obj import ObjFile, material_files, read_obj, read_text
from jaxdr.geometry.formats.ply import read_ply
from jaxdr.geometry.formats.stl import read_stl
from jaxdr.geometry.formats.triangles import Triangles, unit
from jaxdr.geometry.gltf.document import GltfError
from jaxdr.geometry.gltf.parts import read_stored_parts
from jaxdr.geometry.mesh import EmptyMesh, Mesh, MeshArrays, weld
from jaxdr.untrusted import damage, shortened

EXTENSIONS = (".obj", ".ply", ".glb", ".stl")
READERS = {".ply": read_ply, ".stl": read_stl}
SHADINGS = ("flat", "smooth", "file", "vertex")


@checked
def load_mesh(path: str | PathLike, shading: str = "flat") -> Mesh:
    """All triangles of a file as one mesh, in the units of the file.

    Polygons become fans of triangles around their first corners. Vertices at the same position are welded. UVs keep
    their own indices, so a seam does not split a vertex. The meshes of a GLB are joined, each at the place of its node
    in the scene, in the default pose of the file. If only some of the meshes have UVs, the others get (0, 0). A mesh
    has no colours: a warning says if the file has some, and which function keeps them (`load_shape`, `load_gltf`).

    `shading` is one of these:

    - "flat": the normal of the face.
    - "smooth": one normal per vertex.
    - "file": corners with the same position and the same stored normal share one normal, computed from the triangles.
      Meshes without stored normals are flat.
    - "vertex": like "file", but meshes without stored normals have one normal per vertex of the file. So edges at which
      the file splits its vertices (UV seams of an OBJ) stay hard, as in Mitsuba.

    Raises ValueError, with the place in the file, for an unknown extension or shading, a missing or damaged file, one
    that has fewer faces or vertices than it says, indices out of range, a file without triangles, and everything that
    `Mesh` rejects.
    """
    if shading not in SHADINGS:
        raise ValueError(f"load_mesh: shading must be one of {', '.join(SHADINGS)}; got {shading!r}")
    parts = read_parts(path)
    try:
        mesh = joined(parts, shading)
    except ValueError as error:
        raise ValueError(f"load_mesh: {path}: {error}") from error
    _warn_of_colors(Path(path), parts)
    return mesh


def _warn_of_colors(path: Path, parts: Sequence[Triangles]) -> None:
    found = list(dict.fromkeys(part.colored for part in parts if part.colored is not None))
    if found:
        keeps = {".glb": "jd.load_gltf", ".stl": "no function"}.get(path.suffix.lower(), "jd.load_shape")
        warn(f"load_mesh: {path}: the colours of its {' and '.join(found)} are left out; {keeps} keeps them")


def read_parts(path: str | PathLike, caller: str = "load_mesh") -> list[Triangles]:
    """The triangle meshes of a file, each at its place. Raises ValueError like `load_mesh`."""
    path = Path(path)
    _check_extension(caller, path)
    if not path.is_file():
        raise ValueError(f"{caller}: there is no file {path}")
    if path.suffix.lower() == ".glb":
        try:
            parts = [
                Triangles(
                    *(part.vertices, part.faces, part.uvs),
                    None if part.normals is None else unit(part.normals),
                    colored="materials" if part.colored else None,
                )
                for part in read_stored_parts(path)
            ]
        except GltfError as error:
            raise ValueError(f"{caller}: {error}") from error
        return _not_empty(parts, path, caller)
    unread: list[str] = []
    with damage(f"{caller}: {path} is not a readable {path.suffix} file"):
        if path.suffix.lower() == ".obj":
            parts, unread = _read_obj(path)
        else:
            parts = READERS[path.suffix.lower()](path.read_bytes())
    if unread:
        warn(f"{caller}: {path}: what these lines say is left out: {shortened(', '.join(unread))}")
    return _not_empty(parts, path, caller)


def _read_obj(path: Path) -> ObjFile:
    text = read_text(path)
    found = read_obj(text)
    if any(part.material is not None for part in found.parts) and any(map(os.path.isfile, material_files(path, text))):
        for part in found.parts:
            part.colored = "materials"
    return found


def _not_empty(parts: Sequence[Triangles], path: Path, caller: str) -> list[Triangles]:
    if not parts:
        raise EmptyMesh(f"{caller}: {path} has no triangles")
    return list(parts)


def joined(parts: Sequence[Triangles], shading: str) -> Mesh:
    """One mesh of several parts; the shadings are those of `load_mesh`. Raises ValueError like `Mesh`."""
    arrays, _ = joined_arrays(parts, shading)
    mesh = Mesh(*arrays)
    return mesh.smooth() if shading == "smooth" else mesh


def joined_arrays(
    parts: Sequence[Triangles], shading: str, caller: str = "load_mesh"
) -> tuple[MeshArrays, Int[np.ndarray, " n"]]:
    """(arrays of the joined mesh, row in its vertices of every vertex of the parts in turn).

    The caller applies the shading "smooth". Raises ValueError for an unknown shading.
    """
    if shading not in SHADINGS:
        raise ValueError(f"{caller}: shading must be one of {', '.join(SHADINGS)}; got {shading!r}")
    counts = [len(part.vertices) for part in parts]
    starts = np.cumsum([0, *counts[:-1]])
    soup = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    vertices, rows = weld(np.concatenate([part.vertices for part in parts]), np.arange(sum(counts)))
    faces = rows[soup]
    uvs = uv_faces = normal_faces = None
    if any(part.uvs is not None for part in parts):
        filled = [np.zeros((len(part.vertices), 2)) if part.uvs is None else part.uvs for part in parts]
        uvs, uv_faces = weld(np.concatenate(filled), soup)
    has_normals = np.repeat([part.normals is not None for part in parts], [len(part.faces) for part in parts])
    if shading in ("file", "vertex") and has_normals.any():
        normal_faces = smoothing_groups(faces, np.concatenate([part.corner_normals() for part in parts]))
    if shading == "vertex" and not has_normals.all():
        first_free = 0 if normal_faces is None else normal_faces.max() + 1
        used = np.zeros(len(rows), bool)
        used[soup] = True
        by_vertex = first_free + (np.cumsum(used) - 1)[soup]
        normal_faces = by_vertex if normal_faces is None else np.where(has_normals[:, None], normal_faces, by_vertex)
    return MeshArrays(vertices, faces, uvs, uv_faces, normal_faces), rows


@checked
def save_mesh(path: str | PathLike, mesh: Mesh) -> None:
    """Write a mesh as OBJ, PLY, GLB or STL, by the extension; an existing file is replaced.

    OBJ keeps everything. GLB splits vertices where UVs or normals differ, PLY drops UVs, STL has positions only; all
    three store float32. `load_mesh` welds again, and with shading "file" finds the smoothing groups again. Raises
    `ValueError` for an unknown extension or a missing folder. The file appears complete or not at all.
    """
    path = Path(path)
    _check_extension("save_mesh", path)
    if not path.parent.is_dir():
        raise ValueError(f"save_mesh: there is no folder {path.parent}")
    extension = path.suffix.lower()
    with atomic_path(path) as temporary:
        if extension == ".obj":
            temporary.write_text(_obj_text(mesh))
        else:
            cut_mesh(mesh)[0].export(temporary, file_type=extension[1:])


def _check_extension(caller: str, path: Path) -> None:
    if path.suffix.lower() not in EXTENSIONS:
        raise ValueError(f"{caller}: {path} has an unknown extension; known are {', '.join(EXTENSIONS)}")


def is_triangles(geometry: Any) -> bool:
    """Whether trimesh has read triangles, rather than points or lines."""
    import trimesh

    return isinstance(geometry, trimesh.Trimesh) and len(geometry.faces) > 0


def smoothing_groups(
    faces: Int[np.ndarray, "F 3"], corner_normals: Float[np.ndarray, "F 3 3"]
) -> Int[np.ndarray, "F 3"]:
    """Corner -> group of the corners with the same vertex and the same normal."""
    normals, normal_rows = weld(corner_normals.reshape(-1, 3), np.arange(faces.size).reshape(-1, 3))
    _, groups = np.unique(faces * len(normals) + normal_rows, return_inverse=True)
    return groups.reshape(-1, 3)


def normals_apart(arrays: MeshArrays, corner_normals: Float[np.ndarray, "F 3 3"]) -> float:
    """Mean angle (degrees) between stored normals and the smoothing groups' normals, which are computed from faces.

    The mean is weighted by the corners' angles, as in `Mesh.vertex_normals`.
    """
    assert arrays.normal_faces is not None
    corners = np.asarray(arrays.vertices, float)[arrays.faces]
    to_next, to_previous = (np.roll(corners, shift, axis=1) - corners for shift in (-1, 1))
    crossed = np.cross(to_next, to_previous)
    angles = np.arctan2(np.linalg.norm(crossed, axis=2), np.sum(to_next * to_previous, axis=2))
    weighted = unit(crossed.reshape(-1, 3)) * angles.reshape(-1, 1)
    groups = arrays.normal_faces.reshape(-1)
    summed = np.stack([np.bincount(groups, column) for column in weighted.T], axis=1)
    cosine = np.sum(unit(summed)[groups] * corner_normals.reshape(-1, 3), axis=1)
    return float(np.degrees(np.average(np.arccos(np.clip(cosine, -1, 1)), weights=angles.reshape(-1) + 1e-300)))


def _split(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """(the distinct corner triples (vertex, uv, normal group) [n, 3], the faces that index them)."""
    columns = [mesh.faces, mesh.uv_faces, mesh.normal_faces]
    corners = np.stack([np.zeros(mesh.faces.size, int) if c is None else np.asarray(c).ravel() for c in columns], 1)
    triples, rows = np.unique(corners, axis=0, return_inverse=True)
    return triples, rows.reshape(-1, 3)


def cut_mesh(mesh: Mesh) -> tuple[Any, Int[np.ndarray, " n"]]:
    """(a trimesh.Trimesh with one index for all arrays, as GLB and PLY need it; the vertex of each of its rows)."""
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if mesh.uvs is None and mesh.normal_faces is None:  # nothing to split: keep the vertices in their order
        whole = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), process=False)
        return whole, np.arange(len(mesh.vertices))
    triples, faces = _split(mesh)
    cut = trimesh.Trimesh(
        np.asarray(mesh.vertices)[triples[:, 0]],
        faces,
        process=False,
        vertex_normals=None if mesh.normal_faces is None else np.asarray(mesh.vertex_normals())[triples[:, 2]],
        visual=None if mesh.uvs is None else TextureVisuals(np.asarray(mesh.uvs)[triples[:, 1]], PBRMaterial()),
    )
    return cut, triples[:, 0]


def _obj_text(mesh: Mesh) -> str:
    """The mesh as OBJ, which indexes positions, UVs and normals separately like `Mesh`, and keeps every digit."""
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
