"""Mitsuba's own mesh format: what is in a file, beside Mitsuba's loader, and what is wrong with one."""

import warnings

import numpy as np
import pytest

from experiments.real_scenes.mitsuba_meshes import FACE_NORMALS, hill, serialized
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.serialized import read_serialized

from ..conftest import SENSOR

HILL = hill(3)
BARE = {name: HILL[name] for name in ("vertices", "faces")}
COLORED = {**BARE, "colors": np.random.default_rng(0).random((9, 3))}
MESHES = [BARE, HILL, COLORED]
SHAPE = '<shape type="serialized" id="s"><string name="filename" value="m.serialized"/>{}</shape>'
INDEX = '<integer name="shape_index" value="{}"/>'


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_every_mesh_of_a_file(tmp_path, version, kind):
    """Also streams beyond the size in which the file is read."""
    path = tmp_path / "m.serialized"
    large = {
        "vertices": np.random.default_rng(1).normal(size=(120_000, 3)),
        "faces": np.arange(120_000).reshape(-1, 3),
    }
    path.write_bytes(serialized([*MESHES, large, BARE], version, kind))
    for index, mesh in enumerate([*MESHES, large, BARE]):
        found = read_serialized(path, index).triangles
        np.testing.assert_array_equal(found.vertices, mesh["vertices"].astype(kind))
        np.testing.assert_array_equal(found.faces, mesh["faces"])
        assert (found.normals is None) == ("normals" not in mesh) and (found.uvs is None) == ("uvs" not in mesh)
        if "normals" in mesh:
            np.testing.assert_allclose(found.normals, mesh["normals"], atol=1e-6)
            np.testing.assert_array_equal(found.uvs, mesh["uvs"].astype(kind))
        if "colors" in mesh:
            np.testing.assert_array_equal(found.stored["vertex"]["g"], mesh["colors"][:, 1].astype(kind))


def bent(degrees):
    """A flat grid whose normals lean to one side, all by the same angle."""
    flat, angle = hill(4), np.radians(degrees)
    flat["vertices"][:, 2] = 0
    return {**flat, "normals": np.tile([np.sin(angle), 0, np.cos(angle)], (16, 1))}


@pytest.mark.parametrize(
    ("mesh", "said"), [(bent(10), "10.0"), (bent(1), None), (hill(9), "3.1"), (hill(65), None), (BARE, None)]
)
def test_stored_normals_that_do_not_count_are_named(load, tmp_path, mesh, said):
    (tmp_path / "m.serialized").write_bytes(serialized([mesh]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(SENSOR + SHAPE.format(""))
    messages = [str(warning.message) for warning in caught]
    assert len(messages) == (said is not None)
    if said is not None:
        assert f"the stored normals are {said} degrees from those of the triangles, on average" in messages[0]
    smooth = SENSOR + SHAPE.format('<boolean name="face_normals" value="true"/>')
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(smooth)


CASES = {
    "bare": INDEX.format(0),
    "normals and uvs": INDEX.format(1),
    "colours": INDEX.format(2),
    "flat": f'{INDEX.format(1)}<boolean name="face_normals" value="true"/>',
    "flipped": f'{INDEX.format(1)}<boolean name="flip_normals" value="true"/>',
    "mirrored": f'{INDEX.format(1)}<transform name="to_world"><scale x="-2"/><translate z="1"/></transform>',
    "mirrored without normals": f'<transform name="to_world"><scale x="-2"/></transform>{INDEX.format(0)}',
}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("content", CASES.values(), ids=CASES)
def test_as_in_mitsuba(scene_file, tmp_path, version, content):
    """Faces by their corners, the side of each, normals and UVs at the corners."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    (tmp_path / "m.serialized").write_bytes(serialized(MESHES, version))
    path = scene_file(SENSOR + SHAPE.format(content))
    theirs = mitsuba.load_file(str(path)).shapes()[0]
    data = mitsuba.traverse(theirs)
    faces = np.reshape(data["faces"], (-1, 3))
    expected = np.reshape(data["vertex_positions"], (-1, 3))[faces]
    mesh = load_mitsuba(path).shapes["s"].mesh
    corners = np.asarray(mesh.vertices)[mesh.faces]
    order = [np.lexsort(np.round(c.mean(1), 4).T) for c in (expected, corners)]
    normals = np.reshape(data["vertex_normals"], (-1, 3))
    if not len(normals):
        assert mesh.normal_faces is None
    for theirs_row, ours_row in zip(*order, strict=True):
        ours = corners[ours_row]
        match = [int(np.argmin(np.linalg.norm(expected[theirs_row] - corner, axis=1))) for corner in ours]
        np.testing.assert_allclose(expected[theirs_row][match], ours, atol=1e-6)
        normal = np.cross(ours[1] - ours[0], ours[2] - ours[0])
        if len(normals):
            shading = normals[faces[theirs_row][match]] * (-1 if "flip_normals" in content else 1)
            assert np.all(shading @ normal > 0)
            own = np.asarray(mesh.vertex_normals())[np.asarray(mesh.normal_faces)[ours_row]]
            assert np.all(np.sum(own * shading, axis=1) > 0.9)
        if mesh.uvs is not None:
            uvs = np.reshape(data["vertex_texcoords"], (-1, 2))[faces[theirs_row][match]]
            np.testing.assert_allclose(np.asarray(mesh.uvs)[mesh.uv_faces[ours_row]], uvs * (1, -1) + (0, 1), atol=1e-6)
    assert (mesh.uvs is not None) == (len(data["vertex_texcoords"]) > 0)


def test_a_file_that_asks_for_flat_shading_is_as_smooth_as_in_mitsuba(scene_file, tmp_path):
    (tmp_path / "m.serialized").write_bytes(serialized([{**BARE, "flags": FACE_NORMALS}]))
    with pytest.warns(UserWarning, match="line 2, <shape>: the file asks for flat shading"):
        assert load_mitsuba(scene_file(SENSOR + SHAPE.format(""))).shapes["s"].mesh.normal_faces is not None


WHOLE = serialized(MESHES)
DAMAGED = {
    "another format": (b"ply\nformat", "not a serialized mesh of version 3 or 4"),
    "another version": (WHOLE[:2] + b"\x05\0" + WHOLE[4:], "version 5"),
    "empty": (b"", "not a readable serialized mesh"),
    "cut": (WHOLE[:60], "ends inside of a mesh|not a readable serialized mesh"),
    "no zlib": (WHOLE[:4] + b"\0" * 99, "not a readable serialized mesh"),
    "face": (serialized([{**BARE, "faces": BARE["faces"] + 7}]), "face .* has vertex .*, and there are 9"),
}


@pytest.mark.parametrize("content, message", DAMAGED.values(), ids=DAMAGED)
def test_damaged_files(scene_file, tmp_path, content, message):
    (tmp_path / "m.serialized").write_bytes(content)
    with pytest.raises(ValueError, match=f"line 2, <shape>: .*m.serialized: .*({message})"):
        load_mitsuba(scene_file(SENSOR + SHAPE.format("")))


@pytest.mark.parametrize("index, message", [(3, "from 0 to 2, got 3"), (-1, "not be negative")])
def test_index_out_of_range(scene_file, tmp_path, index, message):
    (tmp_path / "m.serialized").write_bytes(WHOLE)
    with pytest.raises(ValueError, match=f"line 2, <shape>: .*shape_index must .*{message}"):
        load_mitsuba(scene_file(SENSOR + SHAPE.format(INDEX.format(index))))


def test_colours_of_vertices(scene_file, tmp_path):
    (tmp_path / "m.serialized").write_bytes(serialized([COLORED]))
    texture = '<texture type="mesh_attribute" name="reflectance"><string name="name" value="vertex_color"/></texture>'
    path = scene_file(SENSOR + SHAPE.format(f'<bsdf type="diffuse">{texture}</bsdf>'))
    shape = load_mitsuba(path).shapes["s"]
    for vertex, color in zip(shape.mesh.vertices, shape.bsdf.reflectance.colors, strict=True):
        row = np.argmin(np.linalg.norm(COLORED["vertices"] - np.asarray(vertex), axis=1))
        np.testing.assert_allclose(color, COLORED["colors"][row], rtol=1e-6)
