"""Numbers of glTF files that are out of range, and properties of a wrong kind: one error that names file and place."""

import warnings

import numpy as np
import pytest

from experiments.real_scenes.gltf_writer import CORNERS, SQUARE, SQUARE_FACES, SQUARE_UVS, File
from jaxdr.geometry.load import load_mesh
from jaxdr.scene.formats.gltf.load import load_gltf
from tests.scene.formats.bad_gltf import cube, png, refused, refused_file

LIGHTS = "KHR_lights_punctual"


def camera(**lens):
    file = cube()
    lens = {"yfov": 0.7, "znear": 0.1, "zfar": 100.0, "aspectRatio": 1.5} | lens
    file.node(camera=file.add("cameras", {"type": "perspective", "perspective": lens}))
    return file


@pytest.mark.parametrize(
    ("lens", "words"),
    [
        ({"aspectRatio": 0}, "aspectRatio: must be a finite number from"),
        ({"aspectRatio": 1e-9}, "the film: expected 1 to"),
        ({"aspectRatio": -1}, "aspectRatio: must be"),
        ({"aspectRatio": True}, "aspectRatio: expected a number, got True"),
        ({"aspectRatio": "1"}, "aspectRatio: expected a number"),
        ({"yfov": 0}, "yfov: must be"),
        ({"yfov": 4}, "fov must be"),
        ({"yfov": 1e300}, "yfov: must be"),
        ({"znear": 0}, "znear: must be"),
        ({"znear": 200}, "near_clip"),
        ({"zfar": 10**300}, "zfar: must be"),
        ({"zfar": 1e30}, "zfar: must be"),
    ],
)
def test_a_lens_out_of_range(tmp_path, lens, words):
    refused_file(tmp_path, camera(**lens), "camera 0: ", words)


@pytest.mark.parametrize(
    "lens", [{"xmag": 0}, {"ymag": 0}, {"xmag": 1e-9}, {"zfar": 0}, {"znear": -1}, {"xmag": None}, {"ymag": 1e300}]
)
def test_an_orthographic_lens_out_of_range(tmp_path, lens):
    file = cube()
    lens = {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 10} | lens
    file.node(camera=file.add("cameras", {"type": "orthographic", "orthographic": lens}))
    refused_file(tmp_path, file, "camera 0: ")


def test_other_cameras(tmp_path):
    file = cube()
    file.node(name="eye", scale=[0, 1, 1], camera=file.add("cameras", {"type": "fisheye", "fisheye": {}}))
    refused_file(tmp_path, file, "camera 0: node 'eye' scales it to nothing")
    del file.json["nodes"][1]["scale"]
    refused_file(tmp_path, file, "camera 0: a camera must be of type perspective or orthographic, not 'fisheye'")


@pytest.mark.parametrize(
    ("light", "words"),
    [
        ({"intensity": float("nan")}, "the JSON: is not readable JSON (NaN"),
        ({"intensity": 1e400}, "the JSON: is not readable JSON (Infinity"),
        ({"intensity": -1}, "intensity: must be"),
        ({"intensity": 1e300}, "intensity: must be"),
        ({"intensity": None}, "intensity: expected a number, got None"),
        ({"color": [1, 1]}, "color must be 3 numbers, not [1, 1]"),
        ({"color": [1, 1, "x"]}, "color: expected a number, got 'x'"),
        ({"color": [10**300] * 3}, "color: must be"),
        ({"type": 3}, "type must be a string, not 3"),
        ({"type": "spot", "spot": {"outerConeAngle": 9}}, "outerConeAngle: must be"),
        ({"type": "spot", "spot": {"innerConeAngle": 1, "outerConeAngle": 0.5}}, "need 0 <= beam_width"),
        ({"type": "spot", "spot": []}, "spot must be an object, not []"),
    ],
)
def test_a_light_out_of_range(tmp_path, light, words):
    file = cube(extensions={LIGHTS: {"light": 0}})
    file.json["extensions"] = {LIGHTS: {"lights": [{"type": "point"} | light]}}
    refused_file(tmp_path, file, words)


@pytest.mark.parametrize("lights", [None, {}, [None], ["x"], 7])
def test_lists_of_lights_that_are_none(tmp_path, lights):
    file = cube(extensions={LIGHTS: {"light": 0}})
    file.json["extensions"] = {LIGHTS: {"lights": lights}}
    refused_file(tmp_path, file, "lights")


def test_a_number_of_thousands_of_digits(tmp_path):
    path = tmp_path / "a.gltf"
    path.write_text('{"asset": {"version": "2.0"}, "x": ' + "9" * 5000 + "}")
    refused(path, "the JSON: is not readable JSON (a whole number of 5000 digits)")
    path.write_text("[" * 100_000)
    refused(path, "the JSON: is not readable JSON (it is nested too deeply)")


@pytest.mark.parametrize(
    "node",
    [
        {"translation": [1e300, 0, 0]},
        {"scale": [1e19, 1, 1]},
        {"rotation": [0, 0, 0, 0]},
        {"rotation": [0, 0, 0]},
        {"matrix": [1e300] * 16},
        {"matrix": ["x"] * 16},
        {"matrix": {}},
        {"scale": [1, 1, None]},
    ],
)
def test_transforms_out_of_range(tmp_path, node):
    refused_file(tmp_path, cube(**node), "node 'cube': ")


def test_transforms_that_overflow_together(tmp_path):
    file, below = File(), []
    for number in range(30):
        below = [file.node(root=number == 29, name=f"n{number}", scale=[1e10] * 3, children=below)]
    file.json["nodes"][0]["mesh"] = file.mesh()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused_file(tmp_path, file, "its transform has numbers beyond 1e+18, with those of its parents")


def test_vertices_that_a_node_puts_too_far_away(tmp_path):
    file = File()
    far = file.primitive(CORNERS * np.float32(1e12))
    file.node(mesh=file.mesh(far), scale=[1e12] * 3)
    for reader in (load_gltf, load_mesh):
        refused(file.save(tmp_path / "a.glb"), "mesh 0, primitive 0: ", reader=reader)


@pytest.mark.parametrize("name", ["NORMAL", "TEXCOORD_0", "COLOR_0", "POSITION"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_attributes_that_are_not_finite(tmp_path, name, value):
    file, values = File(), np.full((4, 2 if name == "TEXCOORD_0" else 3), value, np.float32)
    primitive = file.primitive(SQUARE, SQUARE_FACES, attributes={"TEXCOORD_0": SQUARE_UVS})
    primitive["attributes"][name] = file.accessor(values, min=[0], max=[0])
    file.node(mesh=file.mesh(primitive))
    refused_file(tmp_path, file, f"mesh 0, primitive 0: {name} has values that are not finite")


@pytest.mark.parametrize(
    ("material", "words"),
    [
        ({"pbrMetallicRoughness": {"metallicFactor": 1e300}}, "metallicFactor: must be"),
        ({"pbrMetallicRoughness": {"roughnessFactor": True}}, "roughnessFactor: expected a number"),
        ({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, "x"]}}, "baseColorFactor 3: expected a number"),
        ({"pbrMetallicRoughness": []}, "pbrMetallicRoughness must be an object"),
        ({"emissiveFactor": [-1, 0, 0]}, "radiance"),
        ({"doubleSided": "no"}, "doubleSided must be true or false, not 'no'"),
        ({"alphaMode": "MASK", "alphaCutoff": []}, "alphaCutoff: expected a number"),
        ({"extensions": {"KHR_materials_ior": {"ior": -1}}}, "ior: must be"),
        ({"extensions": {"KHR_materials_ior": 3}}, "KHR_materials_ior must be an object, not 3"),
        ({"extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": -2}}}, "emissiveStrength: must"),
        ({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 7}}}, "material 0"),
        ({"extensions": []}, "extensions must be an object, not []"),
    ],
)
def test_materials_out_of_range(tmp_path, material, words):
    file = File()
    file.square(material)
    refused_file(tmp_path, file, "material 0: ", words)


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        *[("samplers", key, value) for key in ("wrapS", "wrapT", "magFilter") for value in (7, 10497.0, True, "x")],
        *[("textures", key, value) for key in ("source", "sampler") for value in (0.0, True, -1, 99, None)],
        *[("images", "bufferView", value) for value in (0.0, True, 99)],
        *[("nodes", "mesh", value) for value in (0.0, False, "0", [0], -1, 10**300)],
        *[("nodes", "children", value) for value in (7, "12", [0.0], [[]], {"a": 1})],
        *[("accessors", "count", value) for value in (0, -1, 8.0, True, 10**300)],
        *[("accessors", "type", value) for value in ("VEC9", [], None)],
        *[("accessors", "sparse", value) for value in (3, [], {}, {"count": 0, "indices": {}, "values": {}})],
        *[("bufferViews", "byteStride", value) for value in (0, 3, -4, 4.5)],
        *[("bufferViews", "byteLength", value) for value in (-1, 10**300, 1.5)],
        *[("meshes", "primitives", value) for value in (None, 7, [7], "x")],
        *[("meshes", "name", value) for value in (7, [])],
    ],
)
def test_properties_of_a_wrong_kind(tmp_path, kind, key, value):
    file = File()
    sampler = {"wrapS": 10497}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(png(), sampler)}}})
    file.json[kind][1 if kind == "bufferViews" else 0][key] = value  # the first view is that of the image
    message = refused(file.save(tmp_path / "a.glb"))
    assert "object is not" not in message and "'NoneType'" not in message


@pytest.mark.parametrize("mode", [7, -1, 4.0, True, "x"])
def test_unknown_modes_of_primitives(tmp_path, mode):
    file = cube()
    file.json["meshes"][0]["primitives"][0]["mode"] = mode
    refused_file(tmp_path, file, "mesh 0", "mode: ")


@pytest.mark.parametrize("transform", [{"scale": [1e300, 1]}, {"offset": 3}, {"rotation": "x"}, {"texCoord": 0.5}])
def test_texture_transforms_out_of_range(tmp_path, transform):
    file = File()
    info = {"index": file.texture(png()), "extensions": {"KHR_texture_transform": transform}}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": info}})
    refused_file(tmp_path, file, "material 0: ")
