"""Draco and meshopt: what is said where their packages are missing, and filters that meshopt applies."""

import sys

import numpy as np
import pytest

from experiments.real_scenes.gltf_corpus import CASES
from experiments.real_scenes.gltf_writer import CORNERS, CUBE, File
from jaxdr.scene.formats.gltf.load import load_gltf

DracoPy = pytest.importorskip("DracoPy")


def written(tmp_path, name):
    function = next(function for case, function in CASES if case.name == name)
    function(tmp_path / name)
    return tmp_path / name


@pytest.mark.parametrize(
    ("name", "package", "extra", "extension"),
    [
        ("draco.glb", "DracoPy", "gltf", "mesh 0, primitive 0: KHR_draco_mesh_compression"),
        ("meshopt.glb", "meshoptimizer", "meshopt", "EXT_meshopt_compression"),
    ],
)
def test_a_missing_package_is_named(tmp_path, monkeypatch, name, package, extra, extension):
    pytest.importorskip(package)  # writes the file
    path = written(tmp_path, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ValueError) as caught:
        load_gltf(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and extension in message
    assert f"the package {package} is missing" in message and f'pip install -e ".[{extra}]"' in message


def test_without_draco_the_same_data_may_be_there_uncompressed(tmp_path, monkeypatch):
    file = File()
    primitive = file.primitive()
    primitive["extensions"] = {
        "KHR_draco_mesh_compression": {"bufferView": file.view(b"?"), "attributes": {"POSITION": 0}}
    }
    file.node(mesh=file.mesh(primitive))
    path = file.save(tmp_path / "a.glb")
    with pytest.raises(ValueError, match="KHR_draco_mesh_compression: its data can't be decoded"):
        load_gltf(path)
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    (shape,) = load_gltf(path).shapes.values()
    assert shape.mesh.closed


def test_draco_with_texture_coordinates_and_colours(tmp_path):
    """Attributes are found by their numbers; integers are shares of their range."""
    file = File()
    colors, uvs = (CORNERS * 255).astype(np.uint8), CORNERS[:, :2].astype(float)
    faces = CUBE.astype(np.uint32)
    data = DracoPy.encode(CORNERS, faces, quantization_bits=16, preserve_order=True, colors=colors, tex_coord=uvs)
    numbers = {a["attribute_type"]: a["unique_id"] for a in DracoPy.decode(data).attributes}
    kinds = {"POSITION": DracoPy.AttributeType.POSITION, "COLOR_0": DracoPy.AttributeType.COLOR}
    kinds["TEXCOORD_0"] = DracoPy.AttributeType.TEX_COORD
    described = {
        "POSITION": file.described(CORNERS),
        "COLOR_0": file.described(colors, normalized=True),
        "TEXCOORD_0": file.described(np.float32(uvs)),
    }
    extension = {"bufferView": file.view(data), "attributes": {name: numbers[kind] for name, kind in kinds.items()}}
    attributes = {name: file.add("accessors", accessor) for name, accessor in described.items()}
    primitive = {"attributes": attributes, "extensions": {"KHR_draco_mesh_compression": extension}}
    file.node(mesh=file.mesh(primitive))
    (shape,) = load_gltf(file.save(tmp_path / "a.glb")).shapes.values()
    np.testing.assert_allclose(shape.bsdf.base_color.colors, shape.mesh.vertices, atol=1e-3)
    corners = np.asarray(shape.mesh.vertices)[np.asarray(shape.mesh.faces)]
    found = np.asarray(shape.mesh.uvs)[np.asarray(shape.mesh.uv_faces)]
    np.testing.assert_allclose(found, corners[..., :2] * [1, -1] + [0, 1], atol=1e-3)


def test_meshopt_filters(tmp_path):
    """The exponential filter by its definition: e = the upper 8 bits, m = the lower 24, value m · 2^e."""
    meshoptimizer = pytest.importorskip("meshoptimizer")
    file = File()
    file.uses("EXT_meshopt_compression", required=True)
    mantissas = (CORNERS * 3 - 1).astype(np.int32)
    stored = (np.uint32(0xFF) << 24) | (mantissas.astype(np.uint32) & 0xFFFFFF)  # e = -1
    data = meshoptimizer.encode_vertex_buffer(stored.view(np.float32), 8, 12)
    number = file.view(data)
    extension = {
        **file.json["bufferViews"][number],
        "byteStride": 12,
        "count": 8,
        "mode": "ATTRIBUTES",
        "filter": "EXPONENTIAL",
    }
    view = {"buffer": 1, "byteLength": 96, "extensions": {"EXT_meshopt_compression": extension}}
    position = file.described(CORNERS) | {"bufferView": file.add("bufferViews", view)}
    file.json["buffers"] = [{}, {"byteLength": 96}]
    mesh = {"attributes": {"POSITION": file.add("accessors", position)}, "indices": file.accessor(CUBE.reshape(-1))}
    file.node(mesh=file.mesh(mesh))
    (shape,) = load_gltf(file.save(tmp_path / "a.glb")).shapes.values()
    np.testing.assert_allclose(sorted(np.asarray(shape.mesh.vertices).tolist()), sorted((mantissas / 2).tolist()))
