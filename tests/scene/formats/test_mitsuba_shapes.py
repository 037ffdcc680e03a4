"""Shapes of scene files as meshes: sizes, orientation, normals, UVs, names, instances."""

import numpy as np
import pytest

from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.formats.mitsuba.shapes import CIRCLE_SEGMENTS, SHAPES

from ..conftest import SENSOR


def corners(mesh):
    return np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]


def corner_uvs(mesh):
    return np.asarray(mesh.uvs, float)[np.asarray(mesh.uv_faces)]


def corner_normals(mesh):
    return np.asarray(mesh.vertex_normals(), float)[np.asarray(mesh.normal_faces)]


def face_normals(mesh):
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return np.cross(b - a, c - a)  # as long as twice the area


def test_names_are_ids_or_types(load):
    shapes = '<shape type="cube"/><shape type="cube"/><shape type="cube" id="cube_1"/><shape type="cube" id="spot"/>'
    assert set(load(SENSOR + shapes).shapes) == {"cube", "cube_1", "cube_2", "spot"}


def test_rectangle_cube_and_sphere(load_shape):
    corners = np.asarray(load_shape('<shape type="rectangle"/>').mesh.vertices)
    assert sorted(map(tuple, corners)) == [(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)]
    cube = load_shape('<shape type="cube"/>').mesh
    assert cube.closed and cube.vertices.shape == (8, 3) and np.all(np.abs(cube.vertices) == 1)
    ball = '<shape type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="2"/></shape>'
    mesh = load_shape(ball).mesh
    assert np.allclose(np.linalg.norm(mesh.vertices - np.array([1, 2, 3]), axis=1), 2, rtol=1e-5)
    assert mesh.normal_group_count == len(mesh.vertices)  # smooth


def test_to_world_moves_vertices(load_shape):
    transform = '<transform name="to_world"><scale value="2"/><translate x="1"/></transform>'
    corners = np.asarray(load_shape(f'<shape type="rectangle">{transform}</shape>').mesh.vertices)
    assert sorted(map(tuple, corners)) == [(-1, -2, 0), (-1, 2, 0), (3, -2, 0), (3, 2, 0)]


@pytest.mark.parametrize("filename, groups", [("a.obj", 4), ("a.ply", 4), ("normals.obj", 6), ("seam.obj", 6)])
def test_normals_of_mesh_files(load_shape, filename, groups):
    kind = filename[-3:]
    text = f'<shape type="{kind}"><string name="filename" value="{filename}"/>%s</shape>'
    mesh = load_shape(text % "").mesh
    assert len(mesh.vertices) == 4 and len(np.unique(mesh.normal_faces)) == groups
    assert load_shape(text % '<boolean name="face_normals" value="true"/>').mesh.normal_faces is None


def test_a_uv_seam_of_a_file_is_a_hard_edge(load_shape):
    """As in Mitsuba, which computes one normal per vertex of the file; but the vertices themselves are one."""
    mesh = load_shape('<shape type="obj"><string name="filename" value="seam.obj"/></shape>').mesh
    assert len(mesh.vertices) == 4 and len(mesh.edges.vertices) == 5
    normals = face_normals(mesh) / np.linalg.norm(face_normals(mesh), axis=1, keepdims=True)
    np.testing.assert_allclose(corner_normals(mesh), np.repeat(normals[:, None], 3, axis=1), atol=1e-6)


@pytest.mark.parametrize("kind, flips", [("obj", True), ("ply", False)])
def test_uvs_of_mesh_files_have_their_origin_at_the_lower_left(load_shape, tmp_path, kind, flips):
    columns = "".join(f"property float {name}\n" for name in "xyzst")
    header = (
        f"ply\nformat ascii 1.0\nelement vertex 3\n{columns}element face 1\nproperty list uchar int vertex_indices\n"
    )
    (tmp_path / "uv.ply").write_text(f"{header}end_header\n0 0 0 0 0.25\n1 0 0 1 0.25\n0 1 0 0 0.75\n3 0 1 2\n")
    (tmp_path / "uv.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0.25\nvt 1 0.25\nvt 0 0.75\nf 1/1 2/2 3/3\n")
    for given in (None, True, False):
        setting = "" if given is None else f'<boolean name="flip_tex_coords" value="{given}"/>'
        mesh = load_shape(f'<shape type="{kind}"><string name="filename" value="uv.{kind}"/>{setting}</shape>').mesh
        upright = flips if given is None else given
        expected = [0.25, 0.25, 0.75] if upright else [0.75, 0.75, 0.25]
        np.testing.assert_allclose(corner_uvs(mesh)[0, :, 1], expected)


@pytest.mark.parametrize("flip", [False, True])
def test_disk(load_shape, flip):
    setting = f'<boolean name="flip_normals" value="{flip}"/>'
    transform = '<transform name="to_world"><scale value="2"/><translate z="1"/></transform>'
    mesh = load_shape(f'<shape type="disk">{setting}{transform}</shape>').mesh
    radius = np.linalg.norm(np.asarray(mesh.vertices)[:, :2], axis=1)
    np.testing.assert_allclose(radius, [*[2] * CIRCLE_SEGMENTS, 0], atol=1e-6)
    assert np.all(np.asarray(mesh.vertices)[:, 2] == 1) and mesh.normal_faces is None
    total = face_normals(mesh).sum(0) / 2
    np.testing.assert_allclose(total, [0, 0, -4 * np.pi if flip else 4 * np.pi], rtol=1e-3, atol=1e-5)
    u, v = np.moveaxis(corner_uvs(mesh), -1, 0)
    np.testing.assert_allclose(u, np.linalg.norm(corners(mesh)[..., :2], axis=-1) / 2, atol=1e-6)
    assert np.ptp(v, axis=1).max() < 1.001 / CIRCLE_SEGMENTS  # no face runs back across the seam


@pytest.mark.parametrize("p1", [(0, 0, 2), (3, -1, 0.5), (0, 0, -1)])
def test_cylinder(load_shape, p1):
    p0 = np.array([0.5, 0, 0])
    mesh = load_shape(
        f'''<shape type="cylinder"><float name="radius" value="0.3"/>
        <point name="p0" value="0.5, 0, 0"/><point name="p1" value="{p1[0]}, {p1[1]}, {p1[2]}"/></shape>'''
    ).mesh
    axis = (p1 - p0) / np.linalg.norm(p1 - p0)
    relative = corners(mesh) - p0
    along = relative @ axis
    outward = relative - along[..., None] * axis
    np.testing.assert_allclose(np.linalg.norm(outward, axis=-1), 0.3, rtol=1e-4)
    np.testing.assert_allclose(corner_normals(mesh), outward / 0.3, atol=2e-3)
    assert (np.sum(face_normals(mesh) * outward.mean(1), axis=1) > 0).all()
    np.testing.assert_allclose(corner_uvs(mesh)[..., 1], 1 - along / np.linalg.norm(p1 - p0), atol=1e-5)
    assert np.ptp(corner_uvs(mesh)[..., 0], axis=1).max() < 1.001 / CIRCLE_SEGMENTS


def test_uvs_of_a_sphere(load_shape):
    mesh = load_shape('<shape type="sphere"/>').mesh
    assert mesh.closed and len(mesh.vertices) == 2562  # the seam does not cut the mesh
    points, uvs = corners(mesh), corner_uvs(mesh)
    np.testing.assert_allclose(uvs[..., 1], 1 - np.arccos(np.clip(points[..., 2], -1, 1)) / np.pi, atol=1e-4)
    off_axis = np.hypot(points[..., 0], points[..., 1]) > 1e-3
    turns = uvs[..., 0] - np.arctan2(points[..., 1], points[..., 0]) / (2 * np.pi)
    np.testing.assert_allclose((turns - np.round(turns))[off_axis], 0, atol=1e-5)
    away = np.abs(points[..., 2]).max(1) < 0.9
    assert np.ptp(uvs[away, :, 0], axis=1).max() < 0.05


def test_faces_of_a_cube_and_a_rectangle_carry_whole_images(load_shape):
    for kind in ("cube", "rectangle"):
        mesh = load_shape(f'<shape type="{kind}"/>').mesh
        for pair in np.split(corner_uvs(mesh), len(mesh.faces) // 2):
            assert set(map(tuple, pair.reshape(-1, 2))) == {(0, 0), (1, 0), (1, 1), (0, 1)}


GROUP = """<shape type="shapegroup" id="group">
    <shape type="cube" id="box"><bsdf type="twosided"><bsdf type="diffuse"/></bsdf>
        <transform name="to_world"><translate x="5"/></transform></shape>
    <shape type="rectangle"/><shape type="rectangle"/>
</shape>
"""


def test_instances_become_meshes_of_their_own(load):
    scene = load(
        SENSOR
        + GROUP
        + """<shape type="instance" id="a"><ref id="group"/></shape>
        <shape type="instance" id="b"><ref id="group"/>
            <transform name="to_world"><scale value="-2"/><translate y="1"/></transform></shape>"""
    )
    names = [f"{i}_{name}" for i in "ab" for name in ("box", "rectangle", "rectangle_1")]
    assert list(scene.shapes) == names
    assert isinstance(scene.shapes["b_box"].bsdf, TwoSided) and isinstance(scene.shapes["b_rectangle"].bsdf, Diffuse)
    first, second = (np.asarray(scene.shapes[f"{i}_box"].mesh.vertices) for i in "ab")
    np.testing.assert_allclose(second, -2 * first + [0, 1, 0])
    assert (
        np.sum(
            face_normals(scene.shapes["b_box"].mesh) * (corners(scene.shapes["b_box"].mesh).mean(1) - [-10, 1, 0]), 1
        )
        > 0
    ).all()


def test_an_instance_of_one_shape_has_its_own_name(load):
    text = '<shape type="instance" id="i"><shape type="shapegroup"><shape type="cube" id="c"/></shape></shape>'
    assert list(load(SENSOR + text).shapes) == ["i"]


ERRORS = {
    '<shape type="instance"/>': "2, <shape>: needs a shapegroup inside",
    '<shape type="instance"><shape type="cube"/></shape>': "2, <shape>: needs a shapegroup inside",
    '<shape type="shapegroup"><shape type="instance"/></shape>': "2, <shape>: unknown type 'instance'; known: obj",
    '<shape type="cylinder"><point name="p1" value="0"/></shape>': "2, <shape>: radius and the distance of p0 and p1",
    '<shape type="cylinder"><float name="radius" value="-1"/></shape>': "2, <shape>: radius and the distance",
    '<shape type="cube" id="i_a"/>\n<shape type="instance" id="i"><shape type="shapegroup">'
    '<shape type="cube" id="a"/><shape type="cube"/></shape></shape>': "3, <shape>: a second shape 'i_a'; give one",
    GROUP + '<shape type="instance" id="i"><ref id="group"/><bsdf type="diffuse"/></shape>': "7, <bsdf>: not supported",
}


@pytest.mark.parametrize("text, message", ERRORS.items())
def test_errors_name_their_place(load, text, message):
    with pytest.raises(ValueError, match="scene.xml, line " + message):
        load(SENSOR + text)


def test_every_shape_is_tested():
    assert set(SHAPES) == {"obj", "ply", "serialized", "rectangle", "cube", "sphere", "disk", "cylinder"}
