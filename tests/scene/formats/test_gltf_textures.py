"""Textures of glTF materials: colours, samplers, transforms, sets of coordinates, normal maps."""

import jax
import numpy as np
import pytest
from PIL import Image

from experiments.real_scenes.gltf_corpus import png
from experiments.real_scenes.gltf_writer import SQUARE, SQUARE_FACES, SQUARE_UVS, File
from jaxdr.arrays import as_array
from jaxdr.scene.bsdf import NormalMap, Principled, TwoSided
from jaxdr.scene.formats.gltf.load import load_gltf
from jaxdr.scene.textures import TexturePoint

COLOURS = np.random.default_rng(0).integers(0, 256, (2, 3, 3), np.uint8)
OTHERS = np.random.default_rng(1).integers(0, 256, (4, 2, 3), np.uint8)
WIDE = np.random.default_rng(2).integers(0, 256, (4, 4, 3), np.uint8)


def linear(stored):
    share = stored / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def load(tmp_path, file, **options):
    """The one shape of a file, and its scene."""
    scene = load_gltf(file.save(tmp_path / "a.glb"), **options)
    return next(iter(scene.shapes.values())), scene


def look_up(texture, uvs):
    """Values of a texture at UVs [n, 2] whose v goes up."""
    stacked, n = jax.tree.map(lambda x: x[None], texture), len(uvs)
    point = TexturePoint(as_array(uvs), as_array(np.zeros((n, 3))), as_array(np.zeros((n, 3)), int))
    return np.asarray(stacked.values(as_array(np.zeros(n), int), point))


def test_colours_metallic_and_roughness(tmp_path):
    """Colours in sRGB, roughness in green, metallic in blue, all times their factors; UVs start at the lower left."""
    file = File()
    factors = {
        "baseColorFactor": [0.5, 1.0, 1.0, 1.0],
        "baseColorTexture": {"index": file.texture(png(COLOURS))},
        "metallicRoughnessTexture": {"index": file.texture(png(OTHERS))},
        "metallicFactor": 0.5,
        "roughnessFactor": 0.8,
    }
    file.square({"pbrMetallicRoughness": factors})
    shape, _ = load(tmp_path, file)
    bsdf = shape.bsdf
    assert isinstance(bsdf, Principled)
    np.testing.assert_allclose(bsdf.base_color.pixels, linear(COLOURS) * [0.5, 1, 1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(bsdf.metallic.pixels[..., 0], 0.5 * OTHERS[..., 2] / 255, rtol=1e-5)
    np.testing.assert_allclose(bsdf.roughness.pixels[..., 0], 0.8 * OTHERS[..., 1] / 255, rtol=1e-5)
    assert bsdf.base_color.wrap == "repeat" and bsdf.base_color.filter == "bilinear"
    corners = np.asarray(shape.mesh.vertices)[np.asarray(shape.mesh.faces)]
    uvs = np.asarray(shape.mesh.uvs)[np.asarray(shape.mesh.uv_faces)]
    np.testing.assert_allclose(uvs, corners[..., :2], atol=1e-6)


def test_emissive_textures(tmp_path):
    """Colours in sRGB times factor and strength; without a factor nothing glows."""
    file = File()
    material = {
        "emissiveTexture": {"index": file.texture(png(COLOURS))},
        "emissiveFactor": [1.0, 0.5, 0.25],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 20}},
    }
    file.square(material)
    shape, scene = load(tmp_path, file)
    np.testing.assert_allclose(
        shape.emitter.radiance.pixels, 20 * linear(COLOURS) * [1, 0.5, 0.25], rtol=1e-5, atol=1e-6
    )
    assert scene.environment is None
    file.json["materials"][0]["emissiveFactor"] = [0, 0, 0]
    shape, scene = load(tmp_path, file)
    assert shape.emitter is None and scene.environment is not None


def test_samplers(tmp_path):
    """Wraps along u and v, each on its own; values against the definition of the three wraps."""
    file = File()
    texture = file.texture(png(WIDE), {"wrapS": 33648, "wrapT": 33071, "magFilter": 9728})
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}})
    found = load(tmp_path, file)[0].bsdf.base_color
    assert (found.wrap, found.filter) == (("mirror", "clamp"), "nearest")
    columns, rows = np.meshgrid(np.arange(-6, 10), np.arange(-6, 10))
    uvs = np.stack([(columns + 0.5) / 4, 1 - (rows + 0.5) / 4], -1).reshape(-1, 2)
    mirrored = np.array([[0, 1, 2, 3, 3, 2, 1, 0][c % 8] for c in columns.ravel()])
    expected = linear(WIDE)[np.clip(rows, 0, 3).ravel(), mirrored]
    np.testing.assert_allclose(look_up(found, uvs), expected, rtol=1e-4, atol=1e-6)


def test_texture_transforms(tmp_path):
    """The specification's example shows the lower left quadrant, turned clockwise by 90 degrees."""
    file = File()
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    info = {"index": file.texture(png(WIDE)), "extensions": {"KHR_texture_transform": transform}}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": info}})
    found = load(tmp_path, file)[0].bsdf.base_color
    seen = look_up(found, [[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]]).reshape(2, 2, 3)
    np.testing.assert_allclose(seen, np.rot90(linear(WIDE)[2:, :2], -1), rtol=1e-4, atol=1e-6)


def test_texture_transforms_against_the_formula(tmp_path):
    """Offset · rotation · scale of the UVs in glTF's coordinates, whose v goes down."""
    file = File()
    angle, scale, offset = 0.3, np.array([2, 0.7]), np.array([0.1, -0.4])
    transform = {"offset": offset.tolist(), "rotation": angle, "scale": scale.tolist(), "texCoord": 1}
    info = {"index": file.texture(png(WIDE)), "extensions": {"KHR_texture_transform": transform}}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": info}}, attributes={"TEXCOORD_1": SQUARE_UVS * 2})
    shape, _ = load(tmp_path, file)
    assert np.asarray(shape.mesh.uvs)[:, 0].max() == 2 and np.asarray(shape.mesh.uvs)[:, 1].min() == -1
    uvs = np.random.default_rng(3).uniform(-1, 1, (20, 2))
    turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    u, v = (turned @ (scale * (uvs * [1, -1] + [0, 1])).T).T.T + offset[:, None]
    expected = look_up(_plain(shape.bsdf.base_color), np.stack([u, 1 - v], 1))
    np.testing.assert_allclose(look_up(shape.bsdf.base_color, uvs), expected, atol=1e-4)


def _plain(texture):
    return type(texture)(texture.pixels, filter=texture.filter, wrap=texture.wrap)


def test_normal_maps(tmp_path):
    """Stored as they are; a scale multiplies x and y, and leaves the direction of what it makes."""
    file = File()
    material = {"normalTexture": {"index": file.texture(png(COLOURS))}, "doubleSided": True}
    file.square(material)
    bsdf = load(tmp_path, file)[0].bsdf
    assert isinstance(bsdf, TwoSided) and isinstance(bsdf.bsdf, NormalMap) and isinstance(bsdf.bsdf.bsdf, Principled)
    np.testing.assert_allclose(bsdf.bsdf.normal.pixels, COLOURS / 255, atol=1e-6)
    for strength in (0.5, 3):
        material["normalTexture"]["scale"] = strength
        found = 2 * np.asarray(load(tmp_path, file)[0].bsdf.bsdf.normal.pixels, float) - 1
        expected = (2 * (COLOURS / 255) - 1) * [strength, strength, 1]
        np.testing.assert_allclose(np.cross(found, expected), 0, atol=1e-5)
        assert (np.sum(found * expected, -1) > 0).all()


def test_normal_maps_on_mirrored_uvs(tmp_path):
    """Where u runs against the surface's handedness, y of the map points down along v: it is turned over."""
    file = File()
    attributes = {"TEXCOORD_0": np.float32(SQUARE_UVS * [-1, 1] + [1, 0])}
    file.square({"normalTexture": {"index": file.texture(png(COLOURS))}}, attributes=attributes)
    shape, _ = load(tmp_path, file)
    expected = COLOURS / 255 * [1, -1, 1] + [0, 1, 0]
    np.testing.assert_allclose(shape.bsdf.normal.pixels, expected, atol=1e-6)
    file = File()  # a mirroring node mirrors them as well
    file.square({"normalTexture": {"index": file.texture(png(COLOURS))}}, scale=[-1, 1, 1])
    np.testing.assert_allclose(load(tmp_path, file)[0].bsdf.normal.pixels, expected, atol=1e-6)


def test_images_of_16_bits(tmp_path):
    pixels = np.array([[0, 12345, 65535]], np.uint16)
    image = tmp_path / "grey.png"
    Image.fromarray(pixels).save(image)
    file = File()
    number = file.add("images", {"uri": "grey.png"})
    texture = file.add("textures", {"source": number})
    file.square({"normalTexture": {"index": texture}})
    found = np.asarray(load(tmp_path, file)[0].bsdf.normal.pixels)
    np.testing.assert_allclose(found[..., 2], pixels / 65535, atol=1e-6)


def test_textures_without_coordinates(tmp_path):
    file = File()
    material = file.add(
        "materials", {"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(png(COLOURS))}}}
    )
    file.node(mesh=file.mesh(file.primitive(SQUARE, SQUARE_FACES, material=material)))
    message = r"there are no texture coordinates \(TEXCOORD_0\) for baseColorTexture; it is left out"
    with pytest.raises(ValueError, match=message):
        load(tmp_path, file)
    with pytest.warns(UserWarning, match=message):
        assert load(tmp_path, file, ignore_unsupported=True)[0].bsdf.base_color.shape == (3,)
