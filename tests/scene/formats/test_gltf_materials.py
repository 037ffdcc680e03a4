"""glTF materials: vertex colours, alpha, index and strength of reflection, glass, light that shines with alpha."""

import numpy as np
import pytest

from experiments.real_scenes.gltf_corpus import CHECKS, write
from experiments.real_scenes.gltf_writer import CORNERS, SQUARE, SQUARE_FACES, File
from jaxdr.scene.bsdf import Dielectric, Mask, Principled, RoughDielectric, ThinDielectric, TwoSided
from jaxdr.scene.formats.gltf.load import load_gltf
from jaxdr.scene.textures import Bitmap, VertexColors

pytestmark = pytest.mark.filterwarnings("ignore:.*(holes end|a thin pane|specularFactor|shines|edges lie|all glass)")


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
    assert isinstance(corpus("glass_in_part.glb", ignore_unsupported=True).bsdf, Principled)


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
