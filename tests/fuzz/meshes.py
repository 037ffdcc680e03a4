"""Mesh files: OBJ with materials, PLY in its three encodings, STL as text and binary, Mitsuba's serialized files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from experiments.real_scenes.mitsuba_meshes import hill, ply, serialized
from jaxdr.geometry.load import load_mesh, save_mesh
from jaxdr.geometry.shapes import box
from jaxdr.scene.formats.mesh_files import load_shape
from jaxdr.scene.formats.mitsuba.serialized import read_serialized
from tests.fuzz.kind import Kind

OBJ = """# a square, a pentagon and a triangle
mtllib a.mtl
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0.5 0 0 1
v 0 1 0 1 1 1
v 0.5 2 1e-1 0.5 0.25 0
vt 0 0
vt 1 0
vt 0.5 1
vn 0 0 1
vn 0 1 1
o first
usemtl red
f 1/1/1 2/2/1 3/3/2 4/1/2
s 1
f -5 -4 -3 -1 -2
usemtl blue
f 1//1 2//1 \\
3//2
"""
MTL = "newmtl red\nKd 0.8 0.1 0.1\nKs 0 0 0\nillum 2\nnewmtl blue\nKd 0.2 0.3 0.4\nmap_Ka x.png\nKe 0 0 0\nd 1\n"
PLY = """ply
format {} 1.0
comment a quad and a triangle
element face 2
property list uchar int vertex_indices
property uchar red
element vertex 5
property float x
property double y
property float z
property float s
property float t
end_header
"""
ROWS = [(0, 0, 0, 0, 0), (1, 0, 0, 1, 0), (1, 1, 0.5, 1, 1), (0, 1, 0, 0, 1), (0.5, 2, 0.5, 0.5, 0.5)]
POLYGONS = [((0, 1, 2, 3), 255), ((3, 2, 4), 7)]
STL = """solid a solid
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
facet normal 0 0 1
outer loop
vertex 1 0 0
vertex 1 1 1e-1
vertex 0 1 0
endloop
endfacet
endsolid a
"""


def binary_ply(order: str) -> bytes:
    """Two polygons of different lengths, and vertices."""
    faces = [
        bytes([len(corners)]) + np.array(corners, f"{order}i4").tobytes() + bytes([red]) for corners, red in POLYGONS
    ]
    kind = [("x", f"{order}f4"), ("y", f"{order}f8"), *((name, f"{order}f4") for name in "zst")]
    encoding = f"binary_{'little' if order == '<' else 'big'}_endian"
    return PLY.format(encoding).encode() + b"".join(faces) + np.array(ROWS, kind).tobytes()


def text_ply() -> bytes:
    """The same in text."""
    faces = [" ".join(map(str, (len(corners), *corners, red))) for corners, red in POLYGONS]
    return (PLY.format("ascii") + "\n".join([*faces, *(" ".join(map(str, row)) for row in ROWS), ""])).encode()


def of_file(name: str, content: bytes, read: Callable[[Path], object], kind: str, text: bool = False) -> Kind:
    """A kind of one file."""

    def write(folder: Path) -> None:
        (folder / name).write_bytes(content)

    return Kind(kind, write, lambda folder: read(folder / name), text=text)


def kinds() -> list[Kind]:
    """A kind for each format and encoding."""

    def write_obj(folder: Path) -> None:
        (folder / "a.obj").write_text(OBJ)
        (folder / "a.mtl").write_text(MTL)

    def write_stl(folder: Path) -> None:
        save_mesh(folder / "a.stl", box())

    grid = hill(3)
    colors = {name: ("uchar", np.arange(9)) for name in ("red", "green", "blue")}
    return [
        Kind("obj", write_obj, lambda folder: load_shape(folder / "a.obj", "vertex"), text=True),
        of_file("a.ply", text_ply(), lambda path: load_mesh(path, "file"), "ply_text", text=True),
        of_file(
            "a.ply", ply(grid["vertices"], grid["faces"], colors, {}).encode(), load_shape, "ply_colors", text=True
        ),
        of_file("a.ply", binary_ply("<"), load_mesh, "ply_little"),
        of_file("a.ply", binary_ply(">"), load_mesh, "ply_big"),
        of_file("a.stl", STL.encode(), load_mesh, "stl_text", text=True),
        Kind("stl", write_stl, lambda folder: load_mesh(folder / "a.stl")),
        of_file("a.serialized", serialized([grid, grid]), lambda path: read_serialized(path, 1), "serialized"),
    ]
