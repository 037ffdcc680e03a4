"""Shapes of mesh files that have colours: of vertices or faces of PLY and OBJ files, of MTL files."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxdr.argument_kinds import checked
from jaxdr.callers_line import warn
from jaxdr.geometry.formats.obj import material_files, read_text
from jaxdr.geometry.load import Triangles, joined_arrays, read_parts
from jaxdr.geometry.mesh import Mesh, has_area
from jaxdr.images import from_srgb
from jaxdr.scene.bsdf import Diffuse
from jaxdr.scene.formats.attributes import mesh_attributes
from jaxdr.scene.formats.mtl import Surface, read_mtl
from jaxdr.scene.scene import Shape
from jaxdr.scene.textures import Bitmap, FaceColors, VertexColors

EXTENSIONS = (".ply", ".obj")
GREY = 0.5  # of faces without material, as of `Diffuse`


@checked
def load_shape(path: str | os.PathLike, shading: str = "flat", *, raw: bool = False) -> Shape:
    """The mesh of a PLY or OBJ file, as `load_mesh` reads it, with the colours of the file as a `Diffuse` BSDF.

    - PLY: r, g and b of the vertices or of the faces become `VertexColors` or `FaceColors`.
    - OBJ: colours after the positions become `VertexColors`. With an MTL file the diffuse colours `Kd` are those of the
      faces, as `FaceColors`. If there is one material, its colour is a constant, or `Kd` times its image `map_Kd`.
    - Colours are linear RGB. Those of vertices and faces are stored as sRGB, if not `raw`. `Kd` is linear.

    A file without colours gives the BSDF that `Shape` has. Warns of what else an MTL file says that changes the look.
    Raises ValueError as `load_mesh` does, for other formats (`load_gltf` reads GLB files with their materials), for
    vertices at one position with different colours, for several materials of which one has an image, and for a missing
    or damaged MTL file.
    """
    path = Path(path)
    if path.suffix.lower() not in EXTENSIONS:
        raise ValueError(
            f"load_shape: {path} has an unknown extension; known are {', '.join(EXTENSIONS)}; load_gltf reads .glb and "
            ".gltf files with their materials"
        )
    parts = read_parts(path, "load_shape")
    arrays, rows = joined_arrays(parts, shading, "load_shape")
    try:
        mesh = Mesh(*arrays)
    except ValueError as error:
        raise ValueError(f"load_shape: {path}: {error}") from error
    mesh = mesh.smooth() if shading == "smooth" else mesh
    kept = np.ones(len(arrays.faces), bool)
    if len(mesh.faces) < len(kept):  # `Mesh` drops faces without area
        kept = has_area(np.asarray(mesh.vertices), arrays.faces)
    color = _of_materials(path, parts, kept) if path.suffix.lower() == ".obj" else None
    if color is None:
        color = _stored(path, parts, rows, kept, raw)
    return Shape(mesh) if color is None else Shape(mesh, Diffuse(color))


def _stored(path: Path, parts: list[Triangles], rows: Int[np.ndarray, " n"], kept: np.ndarray, raw: bool) -> Any:
    """Colours of vertices or faces as a texture; None if there are none."""
    attributes = mesh_attributes(parts, rows)
    for name, texture in (("vertex_color", VertexColors), ("face_color", FaceColors)):
        if name not in attributes:
            continue
        values = attributes[name]
        if values is None:
            raise ValueError(
                f"load_shape: {path}: vertices at the same position have different colours, and are one vertex here; "
                "store the colours at the faces"
            )
        element = name.partition("_")[0]
        red = [part.stored[element].get("red", part.stored[element].get("r")) for part in parts]
        scales = {np.iinfo(column.dtype).max if column.dtype.kind in "iu" else 1 for column in red}
        linear = _linear(path, values / max(scales), raw)
        return texture(linear[kept] if texture is FaceColors else linear)
    if any(part.colored in ("vertices", "faces") for part in parts):
        raise ValueError(
            f"load_shape: {path}: its colours can't be told apart from its polygons or texture coordinates; write it "
            "with triangles only, and texture coordinates at vertices"
        )
    return None


def _linear(path: Path, values: Float[np.ndarray, "n 3"], raw: bool) -> np.ndarray:
    """Colours in [0, 1], linear, from those of a file, which are bytes divided by 255, or floats."""
    if not (np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1):
        raise ValueError(
            f"load_shape: {path}: its colours go from {values.min():g} to {values.max():g}; give bytes, or floats in "
            "[0, 1]"
        )
    return values.astype(np.float32) if raw else from_srgb(values.astype(np.float32))


def _of_materials(path: Path, parts: list[Triangles], kept: np.ndarray) -> Any:
    """The colour of the materials of an OBJ file: a constant, an image, or colours of faces. None without materials."""
    found: dict[str, Surface] = {}
    for file in material_files(path, read_text(path)):
        if not os.path.isfile(file):  # unlike Path.is_file, this takes any name
            raise ValueError(f"load_shape: {path} names the MTL file {file}, which is missing; put it there")
        found |= read_mtl(file)
    used = list(dict.fromkeys(part.material for part in parts))
    if not found or used == [None]:
        return None
    missing = [name for name in used if name is not None and name not in found]
    if missing:
        raise ValueError(f"load_shape: {path}: no MTL file has the material {missing[0]!r}; it has: {', '.join(found)}")
    surfaces = [Surface(np.full(3, GREY)) if name is None else found[name] for name in used]
    unread = sorted({word for surface in surfaces for word in surface.unread})
    if unread:
        warn(f"load_shape: {path}: only the diffuse colours of its materials are read; left out: {', '.join(unread)}")
    if len(surfaces) == 1:
        (surface,) = surfaces
        return surface.color if surface.image is None else Bitmap.from_file(surface.image).times(surface.color)
    if any(surface.image is not None for surface in surfaces):
        raise ValueError(
            f"load_shape: {path} has several materials, and one of them has an image; convert it to GLB, and take "
            "load_gltf, which makes a shape of each"
        )
    number = {name: surface.color for name, surface in zip(used, surfaces, strict=True)}
    colors = np.concatenate([np.tile(number[part.material], (len(part.faces), 1)) for part in parts])
    return FaceColors(colors[kept])
