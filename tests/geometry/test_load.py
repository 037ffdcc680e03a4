"""Mesh files: round trips in every format, welding, smoothing groups, UV seams, node transforms, each error."""

import numpy as np
import pytest
import trimesh

from jaxdr.geometry.load import load_mesh, save_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import box, rectangle, sphere

FORMATS = ("obj", "ply", "glb", "stl")


def corners(mesh):
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]


def sorted_corners(mesh):
    return sorted(np.roll(c, -np.lexsort(c.T)[0], axis=0).ravel().tolist() for c in corners(mesh))


def write(path, text):
    path.write_text(text)
    return path


@pytest.mark.parametrize("extension", FORMATS)
def test_round_trip_keeps_triangles_and_closedness(tmp_path, extension):
    mesh = sphere(1, radius=1e-3, center=(1, 2, 3))
    path = tmp_path / f"mesh.{extension}"
    save_mesh(path, mesh)
    loaded = load_mesh(path)
    assert loaded.closed and loaded.normal_faces is None
    assert loaded.vertices.shape == mesh.vertices.shape
    assert sorted_corners(loaded) == sorted_corners(mesh)  # every bit of a float32


@pytest.mark.parametrize("extension", ["obj", "ply", "glb"])
def test_vertices_keep_their_order(tmp_path, extension):
    mesh = sphere(1)
    save_mesh(tmp_path / f"mesh.{extension}", mesh)
    loaded = load_mesh(str(tmp_path / f"mesh.{extension}"))
    np.testing.assert_array_equal(loaded.vertices, mesh.vertices)
    np.testing.assert_array_equal(loaded.faces, mesh.faces)


@pytest.mark.parametrize("extension", ["obj", "glb"])
def test_round_trip_keeps_uvs_without_splitting_vertices(tmp_path, extension):
    mesh = box((1, 2, 3))
    save_mesh(tmp_path / f"mesh.{extension}", mesh)
    loaded = load_mesh(tmp_path / f"mesh.{extension}")
    assert loaded.closed and len(loaded.vertices) == 8 and len(loaded.uvs) == 4

    # Where a corner is on the box and on its texture belong together.
    def pairs(m):
        rows = np.concatenate([corners(m), np.asarray(m.uvs)[np.asarray(m.uv_faces)]], axis=-1).reshape(-1, 5)
        return sorted(rows.tolist())

    np.testing.assert_allclose(pairs(loaded), pairs(mesh), atol=1e-7)


@pytest.mark.parametrize("extension", ["obj", "ply", "glb"])
def test_round_trip_keeps_smoothing_groups(tmp_path, extension):
    # A box whose four sides around x are one smooth surface, and whose two ends are flat.
    mesh = box()
    end = np.abs(np.ptp(corners(mesh)[:, :, 0], axis=1)) == 0
    faces = np.asarray(mesh.faces)
    groups = np.where(end[:, None], faces + 8, faces)
    mesh = Mesh(mesh.vertices, faces, normal_faces=groups)
    save_mesh(tmp_path / f"mesh.{extension}", mesh)

    loaded = load_mesh(tmp_path / f"mesh.{extension}", shading="file")
    assert loaded.normal_group_count == 16 and len(loaded.vertices) == 8
    normals = np.asarray(loaded.vertex_normals())[np.asarray(loaded.normal_faces)]
    end = np.ptp(corners(loaded)[:, :, 0], axis=1) == 0
    np.testing.assert_allclose(np.abs(normals[end]), np.broadcast_to([1, 0, 0], (4, 3, 3)), atol=1e-6)
    np.testing.assert_allclose(np.abs(normals[~end]), np.broadcast_to([0, 0.5**0.5, 0.5**0.5], (8, 3, 3)), atol=1e-6)


def test_shading(tmp_path):
    save_mesh(tmp_path / "flat.obj", sphere(0))
    assert load_mesh(tmp_path / "flat.obj").normal_faces is None
    assert load_mesh(tmp_path / "flat.obj", shading="file").normal_faces is None  # nothing stored
    assert load_mesh(tmp_path / "flat.obj", shading="smooth").normal_group_count == 12


def test_vertex_shading_is_hard_where_the_file_splits_vertices(tmp_path):
    """A strip of three quads: the first fold by two vertices of the file, the second by two pairs of equal ones."""
    text = "v 0 0 0\nv 0 1 0\nv 1 0 0\nv 1 1 0\nv 2 0 1\nv 2 1 1\nv 2 0 1\nv 2 1 1\nv 3 0 1\nv 3 1 1\n"
    path = write(tmp_path / "strip.obj", text + "f 1 3 4 2\nf 3 5 6 4\nf 7 9 10 8\n")
    mesh = load_mesh(path, shading="vertex")
    assert len(mesh.vertices) == 8 and mesh.normal_group_count == 10
    normals = np.asarray(mesh.vertex_normals())[np.asarray(mesh.normal_faces)]
    at = {x: np.unique(np.round(normals[corners(mesh)[..., 0] == x], 4), axis=0) for x in range(4)}
    slanted = np.array([-1, 0, 1]) / 2**0.5
    between = slanted + np.array([0, 0, 1])
    between /= np.linalg.norm(between)
    np.testing.assert_allclose(at[0], [[0, 0, 1]], atol=1e-3)
    np.testing.assert_allclose(at[1], [between], atol=1e-3)
    np.testing.assert_allclose(at[2], [slanted, [0, 0, 1]], atol=1e-3)
    assert load_mesh(path, shading="smooth").normal_group_count == 8


def test_vertex_shading_takes_stored_normals_where_there_are_some(tmp_path):
    scene = trimesh.Scene()
    plain = trimesh.creation.box()
    hard = trimesh.Trimesh(plain.vertices[plain.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False)
    hard.vertex_normals  # noqa: B018  computed, so that they are stored
    scene.add_geometry(hard, geom_name="hard")
    moved = trimesh.transformations.translation_matrix([3, 0, 0])
    scene.add_geometry(trimesh.Trimesh(plain.vertices, plain.faces, process=False), geom_name="plain", transform=moved)
    scene.export(tmp_path / "mixed.glb")
    mesh = load_mesh(tmp_path / "mixed.glb", shading="vertex")
    normals = np.asarray(mesh.vertex_normals())[np.asarray(mesh.normal_faces)]
    is_plain = corners(mesh)[:, 0, 0] > 2
    assert np.ptp(normals[~is_plain], axis=1).max() < 1e-6  # a face has one normal
    np.testing.assert_allclose(np.abs(normals[is_plain]), 3**-0.5, atol=0.2)  # a corner of the cube has one


def test_face_normals_in_a_file_mean_flat_shading(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvn 0 1 0\nf 1//1 2//1 3//1\nf 1//2 4//2 2//2\n"
    mesh = load_mesh(write(tmp_path / "corner.obj", text), shading="file")
    assert len(mesh.vertices) == 4 and mesh.normal_group_count == 6
    np.testing.assert_allclose(mesh.vertex_normals()[mesh.normal_faces[0]], np.tile([0, 0, 1.0], (3, 1)), atol=1e-6)


PLY = """ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
{}element face 2
property list uchar int vertex_indices
{}end_header
"""


def test_ply_vertices_with_uvs_and_normals(tmp_path):
    columns = "".join(f"property float {name}\n" for name in ("nx", "ny", "nz", "s", "t"))
    rows = "9 9 9 1 0 0 0 0\n0 0 0 0 0 1 0 0\n1 0 0 0 0 1 1 0\n0 1 0 0 0 1 0 1\n0 0 1 0 0 1 0.5 0\n"
    path = write(tmp_path / "mesh.ply", PLY.format(columns, "") + rows + "3 1 2 3\n3 1 4 2\n")
    mesh = load_mesh(path, shading="file")
    assert mesh.normal_group_count == 4  # the two faces share both normals of their edge
    np.testing.assert_allclose(np.asarray(mesh.uvs)[mesh.uv_faces[1]], [[0, 0], [0.5, 0], [1, 0]])


def test_ply_uvs_at_the_corners_of_faces(tmp_path):
    rows = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n9 9 9\n3 0 1 2 6 0 0 1 0 0 1\n3 1 3 2 6 0.5 0 1 1 0 0.5\n"
    path = write(tmp_path / "mesh.ply", PLY.format("", "property list uchar float texcoord\n") + rows)
    mesh = load_mesh(path)
    assert (np.asarray(mesh.edges.kind) == 0).sum() == 1  # the seam does not cut the mesh
    expected = [[[0, 0], [1, 0], [0, 1]], [[0.5, 0], [1, 1], [0, 0.5]]]
    np.testing.assert_allclose(np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)], expected)


def test_quads_and_several_materials_become_one_mesh(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nusemtl a\nf 1 2 3 4\nusemtl b\nf 2 5 3\n"
    mesh = load_mesh(write(tmp_path / "quad.obj", text))
    assert mesh.vertices.shape == (5, 3) and mesh.faces.shape == (3, 3)


def test_glb_nodes_are_placed_and_joined(tmp_path):
    scene = trimesh.Scene()
    unit = trimesh.creation.box()
    mirror = np.diag([-2.0, 1, 1, 1])
    mirror[0, 3] = 5
    scene.add_geometry(unit, node_name="first", geom_name="unit")
    scene.add_geometry(unit, node_name="second", geom_name="unit", transform=mirror)
    scene.export(tmp_path / "two.glb")

    mesh = load_mesh(tmp_path / "two.glb")
    assert mesh.closed and len(mesh.vertices) == 16
    np.testing.assert_allclose([np.min(mesh.vertices[:, 0]), np.max(mesh.vertices[:, 0])], [-0.5, 6])
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    np.testing.assert_allclose(np.sum(a * np.cross(b, c)) / 6, 1 + 2, rtol=1e-5)  # the mirrored one faces out, too


def test_parts_without_uvs_or_normals_next_to_parts_with_them(tmp_path):
    scene = trimesh.Scene()
    textured = rectangle()
    uvs = trimesh.visual.TextureVisuals(uv=np.asarray(textured.uvs))
    up = np.tile([0, 0, 1.0], (4, 1))
    flat = trimesh.Trimesh(np.asarray(textured.vertices), np.asarray(textured.faces), process=False)
    scene.add_geometry(
        trimesh.Trimesh(flat.vertices, flat.faces, process=False, visual=uvs, vertex_normals=up), geom_name="textured"
    )
    scene.add_geometry(flat, geom_name="plain", transform=trimesh.transformations.translation_matrix([3, 0, 0]))
    scene.export(tmp_path / "mixed.glb")
    mesh = load_mesh(tmp_path / "mixed.glb", shading="file")
    plain = corners(mesh)[:, 0, 0] > 2
    np.testing.assert_array_equal(np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)][plain], 0)
    assert np.ptp(np.asarray(mesh.uvs), axis=0).tolist() == [1, 1]
    np.testing.assert_allclose(mesh.vertex_normals(), np.tile([0, 0, 1.0], (mesh.normal_group_count, 1)), atol=1e-6)


def test_zero_area_faces_of_a_file_are_counted(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\nf 1 2 4\n"  # vertices 2 and 4 weld
    with pytest.warns(UserWarning, match="dropped 1 of 2 faces"):
        assert len(load_mesh(write(tmp_path / "sliver.obj", text)).faces) == 1


BAD_FILES = {
    "nan": ("nan.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n", r"nan\.obj.*line 2: v needs 3 to 8 finite numbers"),
    "index": ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", r"index\.obj"),
    "points only": ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", r"points\.obj has no triangles"),
    "empty": ("empty.obj", "", r"empty\.obj"),
    "not a ply": ("bad.ply", "hello", r"bad\.ply is not a readable \.ply file"),
    "not a glb": ("bad.glb", "hello", r"bad\.glb: the JSON: is not readable JSON"),
    "not an stl": ("bad.stl", "hello", r"bad\.stl"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_is_one_clear_error(tmp_path, name):
    file, text, message = BAD_FILES[name]
    with pytest.raises(ValueError, match=message):
        load_mesh(write(tmp_path / file, text))


def test_bad_arguments(tmp_path):
    with pytest.raises(ValueError, match=r"there is no file .*missing\.obj"):
        load_mesh(tmp_path / "missing.obj")
    with pytest.raises(ValueError, match=r"unknown extension; known are \.obj, \.ply, \.glb, \.stl"):
        load_mesh(write(tmp_path / "mesh.blend", ""))
    with pytest.raises(ValueError, match="shading must be one of flat, smooth, file"):
        load_mesh(write(tmp_path / "mesh.obj", ""), shading="phong")
    with pytest.raises(ValueError, match="there is no folder"):
        save_mesh(tmp_path / "nowhere" / "mesh.obj", box())
    with pytest.raises(ValueError, match="unknown extension"):
        save_mesh(tmp_path / "mesh.blend", box())
