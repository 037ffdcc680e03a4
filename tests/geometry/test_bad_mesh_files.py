"""Mesh files that are damaged, hostile or unusual: read as their format says, or refused with file and place."""

import struct
import time
import tracemalloc
import zlib

import numpy as np
import pytest

from experiments.real_scenes.mitsuba_meshes import hill, serialized
from jaxdr.atomic_file import CannotWrite
from jaxdr.geometry.load import load_mesh, read_parts, save_mesh
from jaxdr.geometry.shapes import box
from jaxdr.scene.formats.gltf.save import save_gltf
from jaxdr.scene.formats.mesh_files import load_shape
from jaxdr.scene.formats.mitsuba.serialized import MAGIC, read_serialized
from jaxdr.scene.formats.mtl import read_mtl
from jaxdr.scene.scene import Shape
from tests.fuzz.meshes import POLYGONS, ROWS, STL, binary_ply, text_ply

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\n"
FIRST = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def triangles(path):
    """The corners of all triangles of a file."""
    return np.concatenate([part.vertices[part.faces] for part in read_parts(path)]).tolist()


# OBJ

SQUARE = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]]
RIGHT = {
    "relative": (CORNERS + "f -4 -3 -2\n", [FIRST]),
    "relative in the middle": (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 9 9 9\nv 8 9 9\nv 9 9 8\nf -3 -2 -1\n",
        [FIRST, [[9, 9, 9], [8, 9, 9], [9, 9, 8]]],
    ),
    "relative and absolute": (
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 -2 3\nv 7 7 7\nf 1 2 -1\n",
        [FIRST, [*FIRST[:2], [7, 7, 7]]],
    ),
    "before its vertices": ("v 0 0 0\nf 1 2 3\nv 1 0 0\nv 0 1 0\n", [FIRST]),
    "goes on": (CORNERS + "f 1 \\\n2 3\n", [FIRST]),
    "goes on twice": (CORNERS + "f 1 \\\r\n2 \\\r\n3\r\n", [FIRST]),
    "a comment does not go on": (r"# C:\folder" + "\\\n" + CORNERS + "f 1 2 3\n", [FIRST]),
    "comments": ("v 0 0 0 # first\nv 1 0 0\nv 0 1 0\nf 1 2 3 # face\n", [FIRST]),
    "many blanks": (CORNERS + f"f 1 {' ' * 30} 2{' ' * 30}3 \n", [FIRST]),
    "tabs and blanks": ("v\t0 0 0\n  v 1\t0 0\nv 0 1 0  \n\tf\t1 2\t3\n", [FIRST]),
    "old line ends": ("v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\r", [FIRST]),
    "byte order mark": ("\ufeff" + CORNERS + "f 1 2 3\n", [FIRST]),
    "keyword in a name": (CORNERS + "g usemtl mtllib\nf 1 2 3\no v f\nf 1 2 3\n", [FIRST, FIRST]),
    "fan": (CORNERS + "f 1 2 3 4\n", [[SQUARE[0], SQUARE[k], SQUARE[k + 1]] for k in (1, 2)]),
    "forms of faces": (
        CORNERS + "vt 0 0\nvn 0 0 1\nf 1 2 3\nf 1/1 2/1 3/1\nf 1//1 2//1 3//1\nf 1/1/1 2/1/1 3/1/1\n",
        4 * [FIRST],
    ),
    "hexagon beside a triangle of six numbers": (
        CORNERS + "v 6 6 6\nv 7 7 7\nvt 0 0\nvt 1 1\nf 1 2 3 4 5 6\nf 1/1 2/2 3/2\n",
        [FIRST, [[0] * 3, [0, 1, 0], [5] * 3], [[0] * 3, [5] * 3, [6] * 3], [[0] * 3, [6] * 3, [7] * 3], FIRST],
    ),
    "colours of some": ("v 0 0 0\nv 1 0 0 1 0 0\nv 0 1 0\nf 1 2 3\n", [FIRST]),
    "one-dimensional textures": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5\nvt 1 0.5 0\nf 1/1 2/2 3/1\n", [FIRST]),
}


@pytest.mark.parametrize("name", RIGHT)
def test_obj_as_the_format_says(tmp_path, name):
    text, expected = RIGHT[name]
    assert sorted(triangles(written(tmp_path, "a.obj", text))) == sorted(expected)


def test_relative_texture_coordinates_and_normals(tmp_path):
    first = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0\nvn 0 0 1\nf -3/-1/-1 -2/-1/-1 -1/-1/-1\n"
    second = "v 0 0 1\nv 1 0 1\nv 0 1 1\nvt 0.5 0\nvn 1 0 0\nf -3/-1/-1 -2/-1/-1 -1/-1/-1\n"
    (part,) = read_parts(written(tmp_path, "a.obj", first + second))
    assert part.uvs[part.faces][:, :, 0].tolist() == [[0.25] * 3, [0.5] * 3]
    assert part.normals[part.faces][:, 0].tolist() == [[0, 0, 1], [1, 0, 0]]


def test_uvs_of_some_faces_stay(tmp_path):
    text = CORNERS + "vt 0.5 0.5\nf 1/1 2/1 3/1\nf 1 2 4\n"
    mesh = load_mesh(written(tmp_path, "a.obj", text))
    assert sorted(np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)][:, 0].tolist()) == [[0, 0], [0.5, 0.5]]


def test_statements_that_obj_does_not_have_are_said(tmp_path):
    path = written(tmp_path, "a.obj", CORNERS + "f 1 2 3\ng 1\nb 1 2 4\nsurf 0 1 0 1 1 2 3\n")
    with pytest.warns(UserWarning, match=r"load_mesh: .*a\.obj: what these lines say is left out: 'b, surf'$"):
        load_mesh(path)


REFUSED = {
    "zero": ("f 0 1 2", "line 5: indices start at 1, got '0 1 2'"),
    "zero texture": ("f 1/0 2/0 3/0", "line 5: indices start at 1"),
    "zero that counts back": ("f -0 1 2", "line 5: indices start at 1"),
    "out of range": ("f 1 2 9", "line 5: a face has the vertex 9, and there are 4"),
    "before the first": ("f -5 1 2", "line 5: a face has the vertex -5, and there are 4"),
    "texture": ("vt 0 0\nf 1/9 2/9 3/9", "line 6: a face has the texture coordinate 9, and there are 1"),
    "normal": ("vn 0 0 1\nf 1//1 2//2 3//1", "line 6: a face has the normal 2, and there are 1"),
    "float": ("f 1.0 2.0 3.0", "line 5: a corner of a face must be whole numbers"),
    "exponent": ("f 1e0 2 3", "line 5: a corner of a face must be whole numbers"),
    "two numbers in one": ("f 1-2 3 4", "line 5: a corner of a face must be whole numbers"),
    "other digits": ("f ١ 2 3", "line 5: a corner of a face must be whole numbers"),
    "huge": ("f 1 2 " + "9" * 400, "line 5: a corner of a face must have one to three indices"),
    "64 bits": ("f 1 2 18446744073709551617", "line 5: a corner of a face must have one to three indices"),
    "four fields": ("f 1/1/1/1 2 3", "line 5: a corner of a face must have one to three indices"),
    "no vertex": ("f /1 2 3", "line 5: a corner of a face must have one to three indices"),
    "two corners": ("f 1 2 3\nf 1 2", "line 6: a face needs at least three corners"),
    "no corners": ("f", "line 5: a face needs at least three corners"),
    "mixed": ("vt 0 0\nf 1/1 2 3/1", "line 6: all corners of a face must have"),
    "two in a line": ("f 1 2 3f 1 2 4", "line 5: a corner of a face must be whole numbers"),
    "short": ("v 0 0\nf 1 2 3", "line 5: v needs 3 to 8 finite numbers up to .*, got '0 0'"),
    "empty": ("v\nf 1 2 3", "line 5: v needs"),
    "only a comment": ("v # 0 0 0\nf 1 2 3", "line 5: v needs"),
    "two vertices in a line": ("v 0 0 0 v 1 1 1\nf 1 2 3", "line 5: v needs"),
    "nan": ("v nan 0 0\nf 1 2 3", "line 5: v needs"),
    "1e300": ("v 0 1e300 0\nf 1 2 3", "line 5: v needs"),
    "zero byte": ("v 0 0 0\0" + "1\nf 1 2 3", "line 5: v needs"),
    "comma": ("v 0,5 0 0\nf 1 2 3", "line 5: v needs"),
    "normal nan": ("vn 0 0 nan\nf 1 2 3", "line 5: vn needs 3 finite numbers"),
    "texture infinite": ("vt inf 0\nf 1 2 3", "line 5: vt needs 2 to 4 finite numbers"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_obj_that_is_refused(tmp_path, name):
    text, message = REFUSED[name]
    path = written(tmp_path, "a.obj", CORNERS + text + "\n")
    for load in (load_mesh, load_shape):
        with pytest.raises(ValueError, match=rf"{load.__name__}: .*a\.obj is not a readable \.obj file \({message}"):
            load(path)


def test_the_line_is_found_in_a_long_file(tmp_path):
    text = "".join(f"v {k} {k % 7} 0\n" for k in range(1000)) + "v 1 x 1\n" + "v 0 0 0\n" * 1000 + "f 1 2 3\n"
    with pytest.raises(ValueError, match=r"line 1001: v needs .*, got '1 x 1'"):
        load_mesh(written(tmp_path, "a.obj", text))


def test_lines_that_go_on_forever_take_no_time(tmp_path):
    start = time.process_time()
    with pytest.raises(ValueError, match="no triangles"):
        load_mesh(written(tmp_path, "a.obj", "\\\n" * 300_000))
    assert time.process_time() - start < 5


# PLY


def faces_of_ply(path):
    return [part.faces.tolist() for part in read_parts(path)]


def header(vertices=4, faces=1, encoding="ascii", indices="uchar int"):
    return (
        f"ply\nformat {encoding} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {faces}\nproperty list {indices} vertex_indices\nend_header\n"
    )


POINTS = "0 0 0\n1 0 0\n0 1 0\n5 5 5\n"


@pytest.mark.parametrize("content", [text_ply(), binary_ply("<"), binary_ply(">")], ids=["text", "little", "big"])
def test_polygons_of_ply_files(tmp_path, content):
    (part,) = read_parts(written(tmp_path, "a.ply", content))
    assert part.faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
    np.testing.assert_allclose(part.vertices, np.array(ROWS)[:, :3])
    np.testing.assert_allclose(part.uvs, np.array(ROWS)[:, 3:])
    assert len(POLYGONS) == 2 and part.colored == "faces"


@pytest.mark.parametrize("ending", ["\r\n", "\r"])
def test_line_ends_of_ply_files(tmp_path, ending):
    text = (header() + POINTS + "3 0 1 2\n").replace("\n", ending)
    assert faces_of_ply(written(tmp_path, "a.ply", text)) == [[[0, 1, 2]]]
    rows = np.array([[float(word) for word in row.split()] for row in POINTS.splitlines()], "<f4").tobytes()
    binary = header(encoding="binary_little_endian").replace("\n", ending).encode() + rows
    path = written(tmp_path, "b.ply", binary + b"\x03" + np.arange(3, dtype="<i4").tobytes())
    assert faces_of_ply(path) == [[[0, 1, 2]]]


PLY_TEXTS = {
    "minus one": (header() + POINTS + "3 0 1 -1\n", "face 0 has vertex -1, and there are 4"),
    "out of range": (header() + POINTS + "3 0 1 9\n", "face 0 has vertex 9, and there are 4"),
    "second face": (header(faces=2) + POINTS + "4 0 1 2 3\n3 0 1 4\n", "face 1 has vertex 4, and there are 4"),
    "fewer faces": (header(faces=3) + POINTS + "3 0 1 2\n", "its header says 7 rows, it has 5"),
    "fewer vertices": (header(9) + POINTS + "3 0 1 2\n", "its header says 10 rows, it has 5"),
    "more rows": (header() + POINTS + "3 0 1 2\n3 0 1 3\n", "its header says 5 rows, it has 6"),
    "huge count": (header(10**17) + POINTS, "its header says 1[0]+1 rows"),
    "count too large": (header() + POINTS + "4 0 1 2\n", "face 0: its numbers end before those of vertex_indices"),
    "count too small": (header() + POINTS + "3 0 1 2 3\n", "face 0: has more numbers than the header says"),
    "other counts": (header(faces=2) + POINTS + "3 0 1 2\n4 0 1 2\n", "face 1: its numbers end before those of"),
    "count of no number": (header() + POINTS + "nan 0 1 2\n", "face 0: needs whole numbers up to 255"),
    "negative count": (header(indices="char int") + POINTS + "-3 0 1 2\n", "face 0: has no vertex_indices of such"),
    "two corners": (header() + POINTS + "2 0 1\n", "face 0 needs at least three corners, got 2"),
    "fraction": (header() + POINTS + "3 0 1.5 2\n", "face 0: needs whole numbers up to 2147483647"),
    "short row": (header() + "0 0\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n", "vertex 0: its numbers end before those of z"),
    "long row": (header() + "0 0 0 0\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n", "vertex 0: has more numbers"),
    "word": (header() + "0 0 x\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n", "vertex 0: expected numbers, got '0 0 x'"),
    "zero byte": (header() + POINTS + "3 0 1 2\0" + "3\n", "face 0: expected numbers"),
    "two in one": (header() + "0 0 1-2\n1 0 0\n0 1 0\n5 5 5\n3 0 1 2\n", "vertex 0: expected numbers"),
    "nan": (header() + POINTS.replace("5 5 5", "5 nan 5") + "3 0 1 2\n", r"vertices\[3\] = .* is not finite"),
    "1e300": (header() + POINTS.replace("5 5 5", "5 1e300 5") + "3 0 1 2\n", r"vertices\[3\] = .* is not finite"),
    "no format": (header().replace("format ascii 1.0\n", ""), "line 3: expected a statement of a PLY header"),
    "other format": (header().replace("ascii", "utf-8"), "line 2: expected a statement of a PLY header"),
    "negative rows": (header(-4), "line 3: expected a statement of a PLY header"),
    "no end": (header().replace("end_header", "end"), "its header has no end_header"),
    "end in a comment": (header().replace("end_header", "comment end_header"), "its header has no end_header"),
    "two elements": (header().replace("face 1", "vertex 1"), "line 7: there are two elements 'vertex'"),
    "two properties": (header().replace("float y", "float x"), "there are two properties 'x'"),
    "float indices": (header(indices="uchar float") + POINTS + "3 0 1 2\n", "the numbers in vertex_indices must be"),
    "float lengths": (header(indices="float int"), "expected a statement of a PLY header"),
    "no positions": (header().replace("float z", "float w") + POINTS + "3 0 1 2\n", "the vertices need x, y and z"),
    "no indices": (header().replace("list uchar int", "int") + POINTS + "3\n", "the faces have no list"),
    "texture of other length": (
        header().replace("end_header", "property list uchar float texcoord\nend_header")
        + POINTS
        + "3 0 1 2 4 0 0 1 1\n",
        "face 0 has 4 texture coordinates for 3 corners",
    ),
}


@pytest.mark.parametrize("name", PLY_TEXTS)
def test_ply_that_is_refused(tmp_path, name):
    text, message = PLY_TEXTS[name]
    with pytest.raises(ValueError, match=rf"load_mesh: .*a\.ply is not a readable \.ply file \(.*({message})"):
        load_mesh(written(tmp_path, "a.ply", text))


def binary(faces, count=None, points=4, indices="uchar int"):
    head = header(points, len(faces) if count is None else count, "binary_little_endian", indices).encode()
    rows = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]], "<f4").tobytes()
    return head + rows + b"".join(bytes([len(face)]) + np.array(face, "<i4").tobytes() for face in faces)


BINARIES = {
    "minus one": (binary([[0, 1, 2], [0, 1, -1]]), "face 1 has vertex -1, and there are 4"),
    "out of range": (binary([[0, 1, 4]]), "face 0 has vertex 4, and there are 4"),
    "cut": (binary([[0, 1, 2]])[:-1], "face 0: vertex_indices ends behind the end of the file"),
    "fewer faces": (binary([[0, 1, 2]], 2), "face 1: vertex_indices ends behind the end of the file"),
    "more bytes": (binary([[0, 1, 2], [0, 1, 3]], 1), "it has 13 bytes more than its header says"),
    "huge count": (binary([[0, 1, 2]], 10**17), "its header says 10+ rows of face, which take at least"),
    "huge points": (binary([[0, 1, 2]], points=10**17), "its header says 10+ rows of vertex, which take at least"),
    "lengths of one sum": (binary([[0, 1, 2, 3], [0, 1]]), "face 1 needs at least three corners, got 2"),
    "huge list": (
        binary([], 1, indices="uint int") + b"\xff\xff\xff\xff" + bytes(12),
        "face 0: vertex_indices ends behind the end of the file",
    ),
    "negative list": (binary([], 1, indices="char int") + b"\xfd" + bytes(12), "face 0: vertex_indices ends behind"),
}


@pytest.mark.parametrize("name", BINARIES)
def test_binary_ply_that_is_refused(tmp_path, name):
    content, message = BINARIES[name]
    tracemalloc.start()
    with pytest.raises(ValueError, match=rf"load_mesh: .*a\.ply is not a readable \.ply file \(.*{message}"):
        load_mesh(written(tmp_path, "a.ply", content))
    assert tracemalloc.get_traced_memory()[1] < 1 << 24
    tracemalloc.stop()


# STL


def test_text_stl(tmp_path):
    assert len(triangles(written(tmp_path, "a.stl", STL))) == 2
    assert len(triangles(written(tmp_path, "b.stl", STL + STL.upper().replace("1E-1", "0.1")))) == 4
    assert len(triangles(written(tmp_path, "c.stl", STL.replace("solid a", "solid vertex endsolid")))) == 2
    assert len(triangles(written(tmp_path, "d.stl", STL.replace("\n", "\r\n  ")))) == 2


def binary_stl(folder):
    save_mesh(folder / "box.stl", box())
    return (folder / "box.stl").read_bytes()


STLS = {
    "cut": (STL[: STL.index("endsolid")], "its end: a solid is not whole"),
    "second solid cut": (STL + STL[:150], "its end: a solid is not whole"),
    "half a facet": (STL.replace("vertex 0 1 0\n", "", 1), "line 6: a solid is not whole"),
    "four corners": (STL.replace("endloop", "vertex 1 1 1\nendloop", 1), "line 7: a solid is not whole"),
    "nan": (STL.replace("1e-1", "nan"), "line 12: a vertex needs 3 finite numbers"),
    "two numbers": (STL.replace("vertex 1 0 0", "vertex 1 0", 1), "line 5: a vertex needs 3 finite numbers"),
    "four numbers": (STL.replace("vertex 1 0 0", "vertex 1 0 0 0", 1), "line 5: a vertex needs 3 finite numbers"),
}


@pytest.mark.parametrize("name", STLS)
def test_text_stl_that_is_refused(tmp_path, name):
    text, message = STLS[name]
    with pytest.raises(ValueError, match=rf"load_mesh: .*a\.stl is not a readable \.stl file \(.*{message}"):
        load_mesh(written(tmp_path, "a.stl", text))


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data + b"0", lambda data: data[:83]])
def test_binary_stl_of_another_length(tmp_path, change):
    with pytest.raises(ValueError, match=r"a\.stl is not a readable \.stl file \(its header says \d+ triangles"):
        load_mesh(written(tmp_path, "a.stl", change(binary_stl(tmp_path))))


def test_binary_stl_with_nan(tmp_path):
    data = binary_stl(tmp_path)
    with pytest.raises(ValueError, match=r"a\.stl is not a readable \.stl file \(corners\[0\] = .* is not finite"):
        load_mesh(written(tmp_path, "a.stl", data[:96] + b"\xff" * 4 + data[100:]))


# serialized


def stream(vertices, faces, data=b"", flags=0):
    content = struct.pack("<I", flags) + b"name\0" + struct.pack("<QQ", vertices, faces) + data
    return struct.pack("<HH", MAGIC, 4) + zlib.compress(content) + struct.pack("<QI", 0, 1)


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
CORNER_ROWS = np.arange(3, dtype="<u4").tobytes()
SERIALIZED = {
    "nothing": (stream(0, 0), "a mesh has no triangles"),
    "no triangles": (stream(3, 0, TRIANGLE), "a mesh has no triangles"),
    "no vertices": (stream(0, 1, CORNER_ROWS), "a mesh has no triangles"),
    "64 bits": (stream(2**64 - 1, 2**64 - 1), "take more bytes than the file can have"),
    "huge vertices": (stream(2**40, 1, TRIANGLE), "take more bytes than the file can have"),
    "shorter": (
        stream(4, 1, TRIANGLE + CORNER_ROWS),
        "a mesh is shorter than its numbers of vertices and triangles say",
    ),
    "longer": (stream(3, 1, TRIANGLE + CORNER_ROWS + b"\0"), "a mesh is longer than its numbers of vertices"),
    "bomb": (stream(3, 1, TRIANGLE + CORNER_ROWS + bytes(1 << 27)), "a mesh is longer than its numbers of vertices"),
    "out of range": (stream(3, 1, TRIANGLE + b"\3" + CORNER_ROWS[1:]), "face 0 has vertex 3, and there are 3"),
    "nan": (stream(3, 1, b"\xff" * 4 + TRIANGLE[4:] + CORNER_ROWS), r"vertices\[0\] = .* is not finite"),
    "no end of the name": (
        struct.pack("<HH", MAGIC, 4) + zlib.compress(bytes(4) + b"x" * 70_000),
        "the name of a mesh is longer than 65536 bytes",
    ),
    "checksum": (serialized([hill(3)])[:-17] + b"\0" * 17, "not a readable serialized mesh|ends inside of a mesh"),
}


@pytest.mark.parametrize("name", SERIALIZED)
def test_serialized_that_is_refused(tmp_path, name):
    content, message = SERIALIZED[name]
    path = written(tmp_path, "a.serialized", content)
    tracemalloc.start()
    with pytest.raises(ValueError, match=rf"a\.serialized: .*{message}|a\.serialized: ({message})"):
        read_serialized(path, 0)
    assert tracemalloc.get_traced_memory()[1] < 1 << 24
    tracemalloc.stop()


def test_serialized_triangle(tmp_path):
    found = read_serialized(written(tmp_path, "a.serialized", stream(3, 1, TRIANGLE + CORNER_ROWS)), 0).triangles
    assert found.vertices[found.faces].tolist() == [FIRST]


# MTL, and what is said of meshes


def test_mtl_with_tabs(tmp_path):
    found = read_mtl(written(tmp_path, "a.mtl", "\ufeffnewmtl\tred\r\n\tKd\t0.5 0.25\t0\r\n"))
    assert found["red"].color.tolist() == [0.5, 0.25, 0] and not found["red"].unread


@pytest.mark.parametrize("text", ["newmtl\nKd 1 0 0\n", "Kd 1 0 0\n", "map_Kd a.png\n", "newmtl # red\n"])
def test_mtl_without_a_name(tmp_path, text):
    with pytest.raises(ValueError, match=r"a\.mtl, line 1: needs the name of a material behind newmtl"):
        read_mtl(written(tmp_path, "a.mtl", text))


@pytest.mark.parametrize("name", ["x" * 3000, "a\0b"])
def test_names_that_no_file_can_have(tmp_path, name):
    with pytest.raises(ValueError, match=r"a\.mtl, line 2: there is no image"):
        read_mtl(written(tmp_path, "a.mtl", f"newmtl a\nmap_Kd {name}\n"))
    path = written(tmp_path, "a.obj", f"mtllib {name}\n{CORNERS}usemtl a\nf 1 2 3\n")
    assert len(load_mesh(path).faces) == 1
    with pytest.raises(ValueError, match=r"load_shape: .*a\.obj names the MTL file .* which is missing"):
        load_shape(path)


def test_a_mesh_without_area_names_its_file(tmp_path):
    path = written(tmp_path, "a.obj", CORNERS + "f 1 1 2\n")
    for load in (load_mesh, load_shape):
        with pytest.raises(ValueError, match=rf"{load.__name__}: .*a\.obj: Mesh: none of the 1 faces has an area"):
            load(path)


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.stl", "a.glb", "scene.glb"])
def test_a_full_disk_names_the_file_and_leaves_the_old_one(tmp_path, monkeypatch, name):
    def full(*_):
        raise OSError(28, "No space left on device")

    path = written(tmp_path, name, "old")
    monkeypatch.setattr("jaxdr.atomic_file._flush", full)
    with pytest.raises(CannotWrite, match=rf"{name}: can't be written \(No space left on device\)"):
        save_gltf(path, {"box": Shape(box())}) if name == "scene.glb" else save_mesh(path, box())
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(name, "old")]
