"""glTF materials: vertex colours, alpha, index and strength of reflection, glass, light that shines with alpha."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from experiments.real_scenes.gltf_corpus import CHECKS, png, write
from experiments.real_scenes.gltf_writer import CORNERS, SQUARE, SQUARE_FACES, File
from jaxdr.scene.bsdf import Blend, Dielectric, Diffuse, Mask, Principled, RoughDielectric, ThinDielectric, TwoSided
from jaxdr.scene.formats.gltf.load import load_gltf
from jaxdr.scene.textures import Bitmap, Product, VertexColors
from tests.scene.bsdf.checks import call, random_directions

UNLIT, LIGHTS = "KHR_materials_unlit", "KHR_lights_punctual"
pytestmark = pytest.mark.filterwarnings("ignore:.*(holes end|a thin pane|specularFactor|shines|edges lie|unlit;)")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """The first shape of a file of the corpus."""
    cases = {case.name: case for case in write(tmp_path_factory.mktemp("corpus"))}

    def load(name, **options):
        return next(iter(load_gltf(cases[name].path, **options).shapes.values()))

    return load


def load(tmp_path, file):
    return next(iter(load_gltf(file.save(tmp_path / "a.glb")).shapes.values()))


@pytest.mark.parametrize(("name", "factor"), [("colors_u8.glb", [1, 1, 1]), ("colors_float.glb", [0.5, 0.25, 1])])
def test_vertex_colours_times_base_colour(corpus, name, factor):
    """The cube's corners have their own coordinates as colours; linear."""
    shape = corpus(name)
    assert isinstance(shape.bsdf.base_color, VertexColors)
    np.testing.assert_allclose(shape.bsdf.base_color.colors, np.asarray(shape.mesh.vertices) * factor, atol=1e-6)


def test_colours_of_triangles(corpus):
    """A red and a green triangle: vertices at one position stay two, so that neither fades into the other."""
    shape = corpus("colors_u16.glb")
    colors = np.asarray(shape.bsdf.base_color.colors)[np.asarray(shape.mesh.faces)]
    np.testing.assert_array_equal(colors, np.repeat([[[1, 0, 0]], [[0, 1, 0]]], 3, axis=1))


def test_one_colour_of_all_vertices_is_a_factor_of_the_texture(corpus):
    found = corpus("tint_on_texture.glb").bsdf.base_color.pixels
    plain = corpus("wraps.glb").bsdf.base_color.pixels
    np.testing.assert_allclose(found, np.asarray(plain) * [0.5, 1, 0.25], rtol=1e-6)


def test_alpha_mask(corpus):
    """Opaque from the cutoff on: texels of alpha 1, 64/255, 192/255, 0."""
    bsdf = corpus("alpha_mask.glb").bsdf
    assert isinstance(bsdf, Mask) and isinstance(bsdf.bsdf, Principled)
    assert bsdf.opacity.filter == "nearest"
    np.testing.assert_array_equal(bsdf.opacity.pixels[..., 0], [[1, 0], [1, 0]])


def test_the_cutoff_itself_is_opaque(tmp_path):
    file = File()
    alpha = {"alphaMode": "MASK", "alphaCutoff": 0.25, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.25]}}
    file.square(alpha)
    assert isinstance(load(tmp_path, file).bsdf, Principled)


def test_alpha_blend(corpus):
    """The share of the surface that is there."""
    bsdf = corpus("alpha_blend.glb").bsdf
    assert isinstance(bsdf, TwoSided) and isinstance(bsdf.bsdf, Mask) and float(bsdf.bsdf.opacity) == 0.25
    shape = corpus("alpha_blend_vertices.glb")
    at = np.asarray(shape.mesh.vertices)[:, :2].tolist()
    alphas = {(0, 0): 0, (1, 0): 1, (1, 1): 1, (0, 1): 0.5}
    np.testing.assert_allclose(shape.bsdf.opacity.colors[:, 0], [alphas[tuple(map(int, p))] for p in at])


def test_opaque_materials_have_no_alpha(tmp_path):
    file = File()
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(CHECKS)}}})
    assert isinstance(load(tmp_path, file).bsdf, Principled)


def test_light_shines_by_the_share_of_alpha(tmp_path):
    file = File()
    material = {
        "alphaMode": "BLEND",
        "emissiveFactor": [1, 0.5, 0],
        "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.5]},
    }
    file.square(material)
    np.testing.assert_allclose(load(tmp_path, file).emitter.radiance, [0.5, 0.25, 0])
    material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": file.texture(CHECKS)}
    radiance = load(tmp_path, file).emitter.radiance
    assert isinstance(radiance, Bitmap)
    alphas = 0.5 * np.array([[255, 64], [192, 0]]) / 255
    np.testing.assert_allclose(radiance.pixels, alphas[..., None] * [1, 0.5, 0], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "reflectance"),
    [("ior.glb", (0.4 / 2.4) ** 2), ("specular.glb", 0.02), ("emissive_strength.glb", 0.04)],
)
def test_reflectance_at_normal_incidence(corpus, name, reflectance):
    """((n - 1) / (n + 1))² times the strength: of an index of 1.4, of half of the default, and the default."""
    np.testing.assert_allclose(0.08 * corpus(name).bsdf.specular, reflectance, rtol=1e-5)


def test_glass(corpus):
    thin = corpus("glass_thin.glb").bsdf
    assert isinstance(thin, ThinDielectric) and float(thin.eta) == 1.5
    np.testing.assert_allclose(thin.specular_transmittance, [0.5, 1, 1])
    thick = corpus("glass_thick.glb").bsdf
    assert isinstance(thick, RoughDielectric) and float(thick.eta) == 1.25 and float(thick.alpha) == 0.25
    part = corpus("glass_in_part.glb").bsdf
    assert isinstance(part, Blend) and isinstance(part.second, RoughDielectric) and float(part.weight) == 0.375
    np.testing.assert_allclose(part.first.metallic, 0.25 / 0.625)


THICK = {"KHR_materials_volume": {"thicknessFactor": 1}}
RED = (0.9, 0.4, 0.2)


def dielectric_mix(transmission, metallic, roughness=0.6):
    """The specification: metal, and below the reflection of what is not metal, diffuse and transmitted light mixed."""

    def of(wi, wo):
        metal = call(Principled(RED, 1.0, roughness), "eval", wi, wo)
        opaque = call(Principled(RED, 0.0, roughness), "eval", wi, wo)
        glass = call(RoughDielectric(roughness**2, 1.5, 1.0, specular_transmittance=RED), "eval", wi, wo)
        return metallic * metal + (1 - metallic) * ((1 - transmission) * opaque + transmission * glass)

    return of


@pytest.mark.parametrize(("transmission", "metallic"), [(0.3, 0.0), (0.7, 0.4), (1.0, 0.2)])
def test_glass_in_part_is_the_mixture_of_the_specification(tmp_path, transmission, metallic):
    file = File()
    factors = {"baseColorFactor": [*RED, 1], "metallicFactor": metallic, "roughnessFactor": 0.6}
    extensions = {"KHR_materials_transmission": {"transmissionFactor": transmission}, **THICK}
    file.square({"pbrMetallicRoughness": factors, "extensions": extensions})
    wi, wo = np.asarray(random_directions(200, 0, 0.0)), np.asarray(random_directions(200, 1, -1.0))
    found, expected = call(load(tmp_path, file).bsdf, "eval", wi, wo), dielectric_mix(transmission, metallic)(wi, wo)
    assert (expected > 0).any(1).sum() > 100 and (expected[wo[:, 2] < 0] > 0).any(1).sum() > 10
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6)


def test_glass_by_textures(tmp_path):
    """Transmission in red, roughness in green, metallic in blue of one image: shares a texel."""
    pixels = np.random.default_rng(3).integers(0, 256, (3, 2, 3), np.uint8)
    file = File()
    info = {"index": file.texture(png(pixels))}
    factors = {"metallicFactor": 0.5, "roughnessFactor": 0.8, "metallicRoughnessTexture": info}
    transmission = {"transmissionFactor": 0.75, "transmissionTexture": info}
    file.square({"pbrMetallicRoughness": factors, "extensions": {"KHR_materials_transmission": transmission, **THICK}})
    bsdf = load(tmp_path, file).bsdf
    through, rough, metal = (np.moveaxis(pixels / 255, 2, 0).T * [0.75, 0.8, 0.5]).T
    share = through * (1 - metal)
    np.testing.assert_allclose(bsdf.weight.pixels[..., 0], share, atol=1e-6)
    np.testing.assert_allclose(bsdf.first.metallic.pixels[..., 0], metal / (1 - share), atol=1e-6)
    np.testing.assert_allclose(bsdf.second.alpha.pixels[..., 0], rough**2, rtol=1e-5)
    transmission["transmissionTexture"] = {"index": file.texture(png(255 - pixels))}
    with pytest.raises(
        ValueError, match="transmissionTexture and metallicRoughnessTexture of different images are not"
    ):
        load(tmp_path, file)


def test_reflection_of_glass_by_strength_is_named(tmp_path):
    file = File()
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_specular": {"specularFactor": 0},
    }
    file.square({"pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": extensions | THICK})
    with pytest.raises(ValueError, match="KHR_materials_specular: specularFactor of glass is not supported"):
        load(tmp_path, file)


def test_vertex_colours_times_a_texture(tmp_path):
    """The specification: the base colour is factor times texture times vertex colour, and so is alpha."""
    pixels = np.random.default_rng(4).integers(0, 256, (2, 2, 4), np.uint8)
    colors = np.random.default_rng(5).uniform(size=(4, 4)).astype(np.float32)
    file = File()
    factors = {"baseColorFactor": [1, 0.5, 0.25, 0.75], "baseColorTexture": {"index": file.texture(png(pixels))}}
    file.square({"alphaMode": "BLEND", "pbrMetallicRoughness": factors}, attributes={"COLOR_0": colors})
    shape = load(tmp_path, file)
    base, opacity = shape.bsdf.bsdf.base_color, shape.bsdf.opacity
    assert isinstance(base, Product) and isinstance(opacity, Product)
    found = np.asarray(shape.mesh.vertices)
    stored = [int(np.flatnonzero((SQUARE == vertex).all(1))[0]) for vertex in found]
    np.testing.assert_allclose(base.second.colors, colors[stored, :3], rtol=1e-6)
    np.testing.assert_allclose(opacity.second.colors[:, 0], colors[stored, 3], rtol=1e-6)
    np.testing.assert_allclose(opacity.first.pixels[..., 0], 0.75 * pixels[..., 3] / 255, rtol=1e-5)


def test_unlit_shows_the_base_colour_in_any_light(tmp_path):
    """The picture of a square that fills it is the base colour, with a lamp or without."""
    file = File()
    file.square({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]}, "extensions": {UNLIT: {}}})
    file.json["extensions"] = {LIGHTS: {"lights": [{"type": "point", "intensity": 9}]}}
    file.node(translation=[0.5, 0.5, 2], extensions={LIGHTS: {"light": 0}})
    lens = {"xmag": 0.2, "ymag": 0.2, "znear": 0, "zfar": 9}
    file.node(camera=file.add("cameras", {"type": "orthographic", "orthographic": lens}), translation=[0.5, 0.5, 3])
    scene = load_gltf(file.save(tmp_path / "a.glb"), width=4, height=4)
    assert set(scene.lights) and scene.environment is None
    image = jd.render(scene, jax.random.key(0), 4, jd.PathTracer(3, None))
    np.testing.assert_allclose(image, np.tile([0.5, 0.25, 1], (4, 4, 1)), rtol=1e-5)


def test_unlit_with_textures_and_alpha(tmp_path):
    file = File()
    pixels = np.random.default_rng(6).integers(0, 256, (2, 2, 4), np.uint8)
    factors = {"baseColorFactor": [1, 0.5, 0.25, 0.75], "baseColorTexture": {"index": file.texture(png(pixels))}}
    file.square({"alphaMode": "BLEND", "pbrMetallicRoughness": factors, "extensions": {UNLIT: {}}})
    shape = load(tmp_path, file)
    assert isinstance(shape.bsdf, Mask) and isinstance(shape.bsdf.bsdf, Diffuse)
    assert isinstance(shape.emitter.radiance, Product)
    np.testing.assert_allclose(shape.emitter.radiance.second.pixels[..., 0], 0.75 * pixels[..., 3] / 255, rtol=1e-5)
    file.json["materials"][0]["pbrMetallicRoughness"] = {"baseColorFactor": [0, 0, 0, 1]}
    assert load(tmp_path, file).emitter is None


def test_unknown_extensions_of_unlit_materials_are_named(tmp_path):
    """Lobes are not: an unlit material has none."""
    file = File()
    coat = {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}
    file.square({"name": "sign", "extensions": {UNLIT: {}, "EXT_other": {}, **coat}})
    with pytest.raises(ValueError, match="only: material 'sign': extension EXT_other is not supported"):
        load(tmp_path, file)


def test_unlit_beside_lit_is_named(tmp_path):
    file = File()
    file.square({"name": "sign", "extensions": {UNLIT: {}}})
    file.square({})
    with pytest.warns(
        UserWarning, match="material 'sign': unlit; it shines with its colour, so that it lights the other"
    ):
        load(tmp_path, file)


def test_smooth_thick_glass_refracts_and_metals_transmit_nothing(tmp_path):
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": {"thicknessFactor": 1},
    }
    for metallic, kind in ((0, Dielectric), (1, Principled)):
        file = File()
        factors = {"metallicFactor": metallic, "roughnessFactor": 0}
        file.square({"pbrMetallicRoughness": factors, "extensions": extensions, "doubleSided": metallic == 0})
        assert isinstance(load(tmp_path, file).bsdf, kind)


def test_absorption_in_glass_is_named(tmp_path):
    volume = {"thicknessFactor": 1, "attenuationDistance": 1, "attenuationColor": [1, 0, 0]}
    extensions = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": volume}
    file = File()
    file.square({"name": "wine", "pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": extensions})
    with pytest.raises(ValueError, match="material 'wine': KHR_materials_volume: absorption inside is not supported"):
        load(tmp_path, file)


def test_double_sided_lamps_are_named(tmp_path):
    file = File()
    file.square({"name": "lamp", "emissiveFactor": [1, 1, 1], "doubleSided": True})
    with pytest.warns(UserWarning, match="material 'lamp': it is double-sided, and shines from its front only"):
        load(tmp_path, file)


def test_a_material_out_of_range_is_named(tmp_path):
    file = File()
    file.square({"name": "odd", "pbrMetallicRoughness": {"roughnessFactor": 2}})
    with pytest.raises(ValueError, match="material 'odd': Principled: roughness must be in"):
        load(tmp_path, file)
    file.json["materials"][0] = {"name": "odd", "alphaMode": "GLASS"}
    with pytest.raises(ValueError, match="material 'odd': alphaMode must be OPAQUE, MASK or BLEND, not 'GLASS'"):
        load(tmp_path, file)


def test_instances_keep_their_colours(tmp_path):
    """Two instances of a cube with vertex colours: as many colours as vertices."""
    file = File()
    moved = file.accessor(np.float32([[0, 0, 0], [4, 0, 0]]))
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": moved}}}
    mesh = file.mesh(file.primitive(attributes={"COLOR_0": np.float32(CORNERS)}))
    file.node(mesh=mesh, extensions=extension)
    shape = load(tmp_path, file)
    vertices = np.asarray(shape.mesh.vertices)
    np.testing.assert_allclose(shape.bsdf.base_color.colors, vertices - [[4, 0, 0]] * (vertices[:, :1] > 2), atol=1e-6)


def test_shading_normals_go_by_the_stored_ones(tmp_path):
    """One normal for all four corners is one smoothing group; none stored is flat shading."""
    for attributes, groups in (({"NORMAL": np.float32([[0, 0, 1]] * 4)}, 4), ({}, 0)):
        file = File()
        file.node(mesh=file.mesh(file.primitive(SQUARE, SQUARE_FACES, attributes=attributes)))
        assert load(tmp_path, file).mesh.normal_group_count == groups
