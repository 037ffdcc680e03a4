"""glTF scenes: files that trimesh writes, with their JSON changed; nodes, materials, cameras, what is left out."""

import json
import struct

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from jaxdr.scene.bsdf import Principled, TwoSided
from jaxdr.scene.formats.gltf.load import load_gltf


def box(extents=(1, 1, 1), **material):
    mesh = trimesh.creation.box(extents)
    if material:
        uv = np.zeros((len(mesh.vertices), 2))
        mesh.visual = TextureVisuals(uv=uv, material=PBRMaterial(metallicFactor=0.0, **material))
    return mesh


@pytest.fixture
def write(tmp_path):
    """Write boxes by name as scene.glb, its JSON changed by a function; the path."""

    def write_glb(boxes, change=None, places=None):
        scene = trimesh.Scene()
        for name, mesh in boxes.items():
            place = trimesh.transformations.translation_matrix((places or {}).get(name, (0, 0, 0)))
            scene.add_geometry(mesh, node_name=name, geom_name=f"{name} mesh", transform=place)
        data = scene.export(file_type="glb")
        (length,) = struct.unpack_from("<I", data, 12)
        header = json.loads(data[20 : 20 + length])
        if change is not None:
            change(header)
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + length :]
        path = tmp_path / "scene.glb"
        path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return path

    return write_glb


def bounds(shape):
    vertices = np.asarray(shape.mesh.vertices)
    return [vertices.min(0).tolist(), vertices.max(0).tolist()]


def test_nodes_become_shapes_with_materials(write):
    grey = box(baseColorFactor=[0.2, 0.4, 0.6, 1.0], doubleSided=True)
    lamp = box((2, 2, 0.5), baseColorFactor=[0, 0, 0, 1.0], emissiveFactor=[1, 0.5, 0.25])
    scene = load_gltf(write({"lamp.1": lamp, "grey": grey}, places={"lamp.1": (0, 3, 0), "grey": (1, 0, 0)}))
    assert list(scene.shapes) == ["grey", "lamp_1"]
    assert bounds(scene.shapes["grey"]) == [[0.5, -0.5, -0.5], [1.5, 0.5, 0.5]]
    assert bounds(scene.shapes["lamp_1"]) == [[-1, 2, -0.25], [1, 4, 0.25]]
    assert isinstance(scene.shapes["grey"].bsdf, TwoSided) and isinstance(scene.shapes["lamp_1"].bsdf, Principled)
    np.testing.assert_allclose(scene.parameters()["grey.bsdf.base_color"], [0.2, 0.4, 0.6], atol=2e-3)
    np.testing.assert_allclose(scene.parameters()["lamp_1.emitter.radiance"], [1, 0.5, 0.25])
    assert scene.shapes["grey"].emitter is None and scene.environment is None
    assert scene.shapes["grey"].mesh.closed  # vertices that the file splits are one again


def test_where_nothing_emits_a_sky_does(write):
    np.testing.assert_array_equal(load_gltf(write({"a": box()})).environment.radiance, [1, 1, 1])


def test_base_colours_are_read_in_full_precision_and_emission_has_a_strength(write):
    def change(header):
        material = header["materials"][0]
        material["pbrMetallicRoughness"]["baseColorFactor"] = [0.001, 0.002, 0.003, 1]
        material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 20}}
        header["extensionsRequired"] = ["KHR_materials_emissive_strength"]

    scene = load_gltf(write({"a": box(baseColorFactor=[1, 1, 1, 1.0], emissiveFactor=[0.1, 0.2, 0.3])}, change))
    np.testing.assert_allclose(scene.parameters()["a.bsdf.base_color"], [0.001, 0.002, 0.003])
    np.testing.assert_allclose(scene.parameters()["a.emitter.radiance"], [2, 4, 6], rtol=1e-6)


def test_nested_nodes_and_repeated_meshes(write):
    """Parent: turned by 90 degrees about z, scaled by 2, moved along x. Children: a matrix; a copy without name."""

    def change(header):
        half = 0.5**0.5
        header["nodes"] = [
            {"rotation": [0, 0, half, half], "scale": [2, 2, 2], "translation": [10, 0, 0], "children": [1, 2, 3]},
            {"name": "camera", "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]},
            {"mesh": 0},
            {"mesh": 0, "scale": [-1, 1, 1]},
            {"mesh": 0, "name": "not in the scene"},
        ]
        header["scenes"] = [{"nodes": [4]}, {"nodes": [0]}]
        header["scene"] = 1

    scene = load_gltf(write({"a": box((1, 2, 4))}, change))
    assert list(scene.shapes) == ["a mesh", "a mesh_1", "camera_1"]
    np.testing.assert_allclose(bounds(scene.shapes["camera_1"]), [[8, 5, -4], [12, 7, 4]], atol=1e-6)
    np.testing.assert_allclose(bounds(scene.shapes["a mesh"]), [[8, -1, -4], [12, 1, 4]], atol=1e-6)
    mirrored = scene.shapes["a mesh_1"].mesh
    a, b, c = np.moveaxis(np.asarray(mirrored.vertices)[np.asarray(mirrored.faces)] - [10, 0, 0], 1, 0)
    np.testing.assert_allclose(np.sum(a * np.cross(b, c)) / 6, 64, rtol=1e-5)  # its outside is outside


def with_camera(lens):
    def change(header):
        header["cameras"] = [{"type": "perspective", "perspective": lens}]
        turned = {"rotation": [0, 0.5**0.5, 0, 0.5**0.5], "camera": 0, "scale": [2, 3, 4]}  # by 90 degrees about y
        header["nodes"].append({"translation": [5, 1, 0], "children": [len(header["nodes"]) + 1]})
        header["nodes"].append(turned)
        header["scenes"][0]["nodes"].append(len(header["nodes"]) - 2)

    return change


def test_a_camera_at_its_node(write):
    path = write({"a": box()}, with_camera({"yfov": np.pi / 2, "znear": 0.1, "zfar": 50, "aspectRatio": 2}))
    camera = load_gltf(path, width=40).camera
    assert (camera.film.width, camera.film.height, camera.near_clip, camera.far_clip) == (40, 20, 0.1, 50)
    assert load_gltf(path, width=40, height=30).camera.film.height == 30
    origin, directions = camera.rays(jnp.array([[20.0, 10.0], [20.0, 0.0], [40.0, 10.0]]))
    np.testing.assert_allclose(origin, [5, 1, 0])
    # It looks along -x, with y up and -z to the right; the upper edge is 45 degrees up.
    expected = np.array([[-1, 0, 0], [-(0.5**0.5), 0.5**0.5, 0], [-(0.2**0.5), 0, -2 * 0.2**0.5]])
    np.testing.assert_allclose(directions, expected, atol=1e-6)


def test_a_camera_without_limits_of_its_own(write):
    camera = load_gltf(write({"a": box()}, with_camera({"yfov": 1.0, "znear": 0.1})), width=40).camera
    assert camera.film.height == 40 and camera.far_clip > 1e4


@pytest.mark.parametrize("size", [(40, 20), (20, 40)])
def test_without_a_camera_everything_is_in_view(write, size):
    boxes = {"a": box(), "b": box((1, 30, 2))}
    scene = load_gltf(write(boxes, places={"b": (-7, 100, 3)}), width=size[0], height=size[1])
    points = np.concatenate([shape.mesh.vertices for shape in scene.shapes.values()])
    local = np.asarray(scene.camera.local(jnp.asarray(points)))
    assert local[:, 2].min() > scene.camera.near_clip and local[:, 2].max() < scene.camera.far_clip
    film = np.asarray(scene.camera.project(jnp.asarray(points)))
    assert (film > 0).all() and (film < size).all()
    assert np.ptp(film[:, 1]) > 0.3 * min(size)  # and not from far away


def test_metallic_and_roughness(write):
    metal = box(baseColorFactor=[1, 1, 1, 1.0])
    metal.visual.material.metallicFactor = 1.0
    metal.visual.material.roughnessFactor = 0.25
    bsdf = load_gltf(write({"a": metal})).shapes["a"].bsdf
    assert isinstance(bsdf, Principled) and float(bsdf.metallic) == 1.0 and float(bsdf.roughness) == 0.25


def unsupported(header):
    header["extensionsRequired"] = ["EXT_other"]
    header["animations"] = [{"channels": [], "samplers": []}]
    header["nodes"][0]["extensions"] = {"EXT_node": {}, "MSFT_lod": {"ids": []}}
    header["meshes"][0]["extensions"] = {"EXT_mesh": {}}
    header["meshes"][0]["primitives"][0]["extensions"] = {"EXT_primitive": {}}
    material = header["materials"][0]
    material["name"] = "glass"
    material["extensions"] = {
        "KHR_materials_pbrSpecularGlossiness": {},
        "KHR_materials_clearcoat": {"clearcoatFactor": 1},
    }
    material["pbrMetallicRoughness"]["extensions"] = {"EXT_inside": {}}


UNSUPPORTED = [
    "node 'a': extension EXT_node is not supported; it has no effect",
    "mesh 'a mesh': extension EXT_mesh is not supported; it has no effect",
    "mesh 'a mesh': extension EXT_primitive is not supported; it has no effect",
    "material 'glass': extension EXT_inside is not supported; it has no effect",
    "extension EXT_other is required; what it changes is left out",
    "material 'glass': extension KHR_materials_pbrSpecularGlossiness is not supported; its metallic-roughness values "
    "count",
    "material 'glass': extension KHR_materials_clearcoat is not supported; there is no coat; that of Principled is "
    "another one",
]
NOTES = [
    "node 'a': extension MSFT_lod is not supported; the finest level counts",
    "animations are not played; everything stays where its node puts it",
]


def test_what_is_not_supported_is_listed_or_ignored(write):
    """Every extension that is not read is named; a strict error lists them before anything is loaded."""
    path = write({"a": box(baseColorFactor=[1, 1, 1, 1.0])}, unsupported)
    with pytest.raises(ValueError) as caught:
        load_gltf(path)
    first, *rest = str(caught.value).split("\n  ")
    assert first == f"{path} has {len(UNSUPPORTED)} things that are not supported; with ignore_unsupported:"
    assert sorted(rest) == sorted(UNSUPPORTED)
    with pytest.warns(UserWarning) as warned:
        assert list(load_gltf(path, ignore_unsupported=True).shapes) == ["a"]
    messages = [str(warning.message).removeprefix(f"{path}: ") for warning in warned]
    assert sorted(messages) == sorted(UNSUPPORTED + NOTES)


def test_json_with_buffers_beside_it(tmp_path):
    for name, data in trimesh.Scene({"a": box()}).export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    (shape,) = load_gltf(tmp_path / "model.gltf").shapes.values()
    assert bounds(shape) == [[-0.5] * 3, [0.5] * 3]


def test_bad_files_are_one_clear_error(write, tmp_path):
    def check(path, message):
        with pytest.raises(ValueError, match=message):
            load_gltf(path)

    check(tmp_path / "no.glb", r"there is no file .*no\.glb")
    check(tmp_path / "a.fbx", r"a\.fbx has an unknown extension; known are \.glb, \.gltf")
    for name, data, message in (
        ("a.glb", b"", "the JSON: is not readable JSON"),
        ("b.glb", b"glTF\2\0\0\0", "the GLB header: the file is cut off after 8 bytes"),
        ("c.gltf", b"{}", "asset: the property 'asset' is missing"),
        ("d.gltf", b"\xff", "the JSON: is not readable JSON"),
        ("e.gltf", b"[]", "the JSON: must be an object"),
        ("f.glb", b"glTF" + struct.pack("<IIII", 1, 20, 0, 0), "the GLB header: GLB version 1; only 2 is supported"),
    ):
        (tmp_path / name).write_bytes(data)
        check(tmp_path / name, f"{name}: {message}")
    check(write({"a": box()}, lambda header: header["asset"].update(version="1.0")), "glTF version '1.0'; only 2.x")
    check(write({"a": box()}, lambda header: header["nodes"][0].update(children=[99])), "refers to node 99; there are")
    check(write({"a": box()}, lambda header: header["scenes"][0].update(nodes=[])), "has no triangles")
    check(write({"a": box()}, lambda header: header["scenes"][0].update(nodes=[0, 0])), "is in it twice")
