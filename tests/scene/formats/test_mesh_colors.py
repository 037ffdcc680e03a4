"""Colours of mesh files: `load_mesh` says that it leaves them out, `load_shape` keeps them."""

import warnings

import numpy as np
import pytest
from PIL import Image

import jaxdr as jd
from jaxdr.images import from_srgb
from tests.scene.conftest import OBJ

SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))
BYTES = np.array([[255, 0, 0], [0, 128, 0], [0, 0, 64], [255, 255, 255]])
FACES = np.array([[255, 0, 0], [10, 20, 30]])
MTL = "newmtl red\nKd 0.8 0.1 0.1\nKs 0 0 0\nillum 2\nnewmtl glow\nKd 0.2 0.3 0.4\nKe 1 1 1\nd 1\n"
COLORED = "".join(
    f"v {x} {y} 0 {r / 255} {g / 255} {b / 255}\n" for (x, y), (r, g, b) in zip(SQUARE, BYTES, strict=True)
)
TWO = "mtllib a.mtl\n" + OBJ.replace("f 1 2 3", "usemtl red\nf 1 2 3").replace("f 1 3 4", "usemtl glow\nf 1 3 4")


def ply(vertices=None, faces=None, kind="uchar", seams=False):
    """A square of two triangles with colours of vertices or faces."""
    names = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    rows = [
        f"{x} {y} 0 " + " ".join(map(str, [] if vertices is None else vertices[i])) for i, (x, y) in enumerate(SQUARE)
    ]
    polygons = [
        f"3 {corners}"
        + (f" 6 0.{i} 0 1 0 1 1" if seams else "")
        + " "
        + " ".join(map(str, [] if faces is None else faces[i]))
        for i, corners in enumerate(("0 1 2", "0 2 3"))
    ]
    return "\n".join(
        [
            *("ply", "format ascii 1.0", "element vertex 4", "property float x", "property float y"),
            "property float z\n" + (names if vertices is not None else "") + "element face 2",
            "property list uchar int vertex_indices",
            ("property list uchar float texcoord\n" if seams else "")
            + (names if faces is not None else "")
            + "end_header",
            *rows,
            *polygons,
            "",
        ]
    )


def write(folder, name, text, mtl=MTL):
    (folder / "a.mtl").write_text(mtl)
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(
    ("name", "text", "colors"),
    [
        ("a.ply", ply(BYTES), BYTES / 255),
        ("a.ply", ply(BYTES / 255, kind="float"), BYTES / 255),
        ("a.obj", COLORED + "f 1 2 3\nf 1 3 4\n", BYTES / 255),
        ("a.obj", COLORED + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1/1/1 3/1/1 4/1/1\n", BYTES / 255),
    ],
    ids=["PLY bytes", "PLY floats", "OBJ", "OBJ with UVs and normals"],
)
def test_colours_of_vertices(tmp_path, name, text, colors):
    path = write(tmp_path, name, text)
    with pytest.warns(UserWarning, match="the colours of its vertices are left out; jd.load_shape keeps them"):
        mesh = jd.load_mesh(path)
    shape = jd.load_shape(path)
    np.testing.assert_array_equal(shape.mesh.vertices, mesh.vertices)
    assert isinstance(shape.bsdf.reflectance, jd.VertexColors)
    order = [SQUARE.index(tuple(vertex[:2])) for vertex in np.asarray(mesh.vertices).tolist()]
    np.testing.assert_allclose(shape.bsdf.reflectance.colors, from_srgb(colors[order].astype(np.float32)), atol=1e-6)
    raw = jd.load_shape(path, raw=True).bsdf.reflectance.colors
    np.testing.assert_allclose(raw, colors[order], atol=1e-6)


def test_colours_of_faces(tmp_path):
    path = write(tmp_path, "a.ply", ply(faces=FACES))
    with pytest.warns(UserWarning, match="the colours of its faces are left out"):
        jd.load_mesh(path)
    shape = jd.load_shape(path, raw=True)
    assert isinstance(shape.bsdf.reflectance, jd.FaceColors)
    np.testing.assert_allclose(shape.bsdf.reflectance.colors, FACES / 255, atol=1e-6)


def test_a_face_without_area_takes_its_colour_along(tmp_path):
    text = ply(faces=FACES).replace("3 0 1 2", "3 0 1 1")
    with pytest.warns(UserWarning, match="no area"):
        shape = jd.load_shape(write(tmp_path, "a.ply", text), raw=True)
    np.testing.assert_allclose(shape.bsdf.reflectance.colors, FACES[1:] / 255, atol=1e-6)


def test_materials_of_an_obj_file(tmp_path):
    """Each face has the diffuse colour of its material. What else changes the look is said."""
    path = write(tmp_path, "a.obj", TWO)
    with pytest.warns(UserWarning, match="the colours of its materials are left out; jd.load_shape keeps them"):
        jd.load_mesh(path)
    with pytest.warns(UserWarning, match="only the diffuse colours of its materials are read; left out: ke$"):
        shape = jd.load_shape(path)
    colors = np.asarray(shape.bsdf.reflectance.colors)
    third = np.asarray(shape.mesh.vertices)[np.asarray(shape.mesh.faces)].sum(
        1
    )  # of the corners: tells the faces apart
    for color, corner in zip(colors, third, strict=True):
        np.testing.assert_allclose(color, [0.8, 0.1, 0.1] if corner[0] > 0 else [0.2, 0.3, 0.4], rtol=1e-6)


def test_one_material_is_a_constant_or_an_image(tmp_path):
    text = "mtllib a.mtl\nusemtl red\n" + OBJ.replace(
        "f 1 2 3\nf 1 3 4", "vt 0 0\nvt 1 1\nf 1/1 2/2 3/1\nf 1/1 3/2 4/1"
    )
    path = write(tmp_path, "a.obj", text)
    np.testing.assert_allclose(jd.load_shape(path).bsdf.reflectance, [0.8, 0.1, 0.1], rtol=1e-6)
    Image.fromarray(np.full((2, 3, 3), 255, np.uint8)).save(tmp_path / "white.png")
    shape = jd.load_shape(write(tmp_path, "a.obj", text, MTL.replace("Kd 0.8", "map_Kd white.png\nKd 0.8")))
    assert isinstance(shape.bsdf.reflectance, jd.Bitmap)
    np.testing.assert_allclose(shape.bsdf.reflectance.pixels[0, 0], [0.8, 0.1, 0.1], rtol=1e-6)


@pytest.mark.parametrize("name", ["a.obj", "a.ply"])
def test_without_colours_nothing_is_said(tmp_path, name):
    path = write(tmp_path, name, OBJ if name == "a.obj" else ply())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jd.load_mesh(path)
        assert np.asarray(jd.load_shape(path).bsdf.reflectance).tolist() == [0.5] * 3


def test_glb_files_have_another_function(tmp_path):
    jd.save_mesh(tmp_path / "plain.glb", jd.shapes.rectangle())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jd.load_mesh(tmp_path / "plain.glb")
    with pytest.raises(ValueError, match=r"load_gltf reads \.glb"):
        jd.load_shape(tmp_path / "plain.glb")


@pytest.mark.parametrize(
    ("name", "text", "mtl", "message"),
    [
        ("a.stl", "", MTL, "has an unknown extension; known are .ply, .obj"),
        ("none.ply", None, MTL, "load_shape: there is no file"),
        ("a.ply", ply(1.5 * BYTES / 255, kind="float"), MTL, "its colours go from 0 to 1.5; give bytes, or floats in"),
        ("a.ply", ply(BYTES, seams=True), MTL, "can't be told apart from its polygons"),
        (
            "a.obj",
            COLORED + "v 0 0 0 1 1 1\nf 1 2 3\nf 5 3 4\n",
            MTL,
            "can't be told apart|vertices at the same position have different colours",
        ),
        ("a.obj", TWO.replace("a.mtl", "b.mtl"), MTL, r"names the MTL file .*b\.mtl, which is missing; put it there"),
        ("a.obj", TWO, "newmtl red\nKd 1 0 0\n", "no MTL file has the material 'glow'; it has: red"),
        (
            "a.obj",
            TWO,
            MTL.replace("0.8", "2"),
            r"a\.mtl, line 2: Kd must be three numbers in \[0, 1\], got '2 0.1 0.1'",
        ),
        ("a.obj", TWO, MTL + "map_Kd none.png\n", r"a\.mtl, line 9: there is no image .*none\.png; put it there"),
        ("a.obj", TWO, MTL + "map_Kd -s 1 1 1 a.png\n", "options of map_Kd are not supported, got '-s 1 1 1 a.png'"),
        ("a.obj", TWO, MTL + "map_Kd a.obj\n", "has several materials, and one of them has an image"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*only the diffuse")
def test_what_is_refused(tmp_path, name, text, mtl, message):
    path = tmp_path / name if text is None else write(tmp_path, name, text, mtl)
    with pytest.raises(ValueError, match=message):
        jd.load_shape(path)
