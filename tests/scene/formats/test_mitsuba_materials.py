"""BSDF plugins of Mitsuba scene files: parameters, defaults, what is refused."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.bsdf.principled import OPTIONAL
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.formats.mitsuba.materials import MATERIALS
from jaxdr.scene.formats.mitsuba.xml import Properties
from tests.scene.bsdf.checks import call, random_directions

FILE = Path("scene.xml")
SCENE = '<sensor type="perspective"/><shape type="cube" id="c">%s</shape>'


def parsed(kind, **values):
    """The material of a plugin; parameters are (tag, value)."""
    children = [Element(tag, {"name": name, "value": value}, FILE, 1) for name, (tag, value) in values.items()]
    properties = Properties(Element("bsdf", {"type": kind}, FILE, 1, children))
    material = MATERIALS[kind](properties)
    properties.finish()
    return material


COLOR = ("rgb", "0.1, 0.5, 0.8")
CASES = [
    ("roughconductor", {}, jd.RoughConductor(0.1, distribution="beckmann")),
    (
        "roughconductor",
        {"material": ("string", "Ni_palik"), "alpha": ("float", "0.3"), "distribution": ("string", "ggx")},
        jd.RoughConductor(0.3, "Ni"),
    ),
    (
        "roughconductor",
        {"eta": COLOR, "k": ("float", "2"), "alpha_u": ("float", "0.2"), "alpha_v": ("float", "0.2")},
        jd.RoughConductor(0.2, eta=(0.1, 0.5, 0.8), k=2.0, distribution="beckmann"),
    ),
    ("conductor", {"material": ("string", "Cu_palik")}, jd.Conductor("Cu_palik")),
    (
        "conductor",
        {"material": ("string", "none"), "specular_reflectance": COLOR},
        jd.Conductor(specular_reflectance=(0.1, 0.5, 0.8)),
    ),
    ("roughdielectric", {"int_ior": ("string", "water")}, jd.RoughDielectric(0.1, "water", distribution="beckmann")),
    ("dielectric", {"ext_ior": ("float", "1.2")}, jd.Dielectric("bk7", 1.2)),
    ("thindielectric", {"specular_transmittance": COLOR}, jd.ThinDielectric(specular_transmittance=(0.1, 0.5, 0.8))),
    ("plastic", {"nonlinear": ("boolean", "true")}, jd.Plastic(nonlinear=True)),
    (
        "roughplastic",
        {"diffuse_reflectance": COLOR, "sample_visible": ("boolean", "false")},
        jd.RoughPlastic((0.1, 0.5, 0.8), distribution="beckmann"),
    ),
    (
        "roughdielectric",
        {"alpha_u": ("float", "0.2"), "alpha_v": ("float", "0.3"), "distribution": ("string", "ggx")},
        jd.RoughDielectric(0.2, alpha_v=0.3),
    ),
    ("conductor", {"material": ("string", "a-C")}, jd.Conductor("a-C")),
    ("phong", {}, jd.Phong()),
    (
        "phong",
        {"exponent": ("float", "7"), "specular_reflectance": COLOR},
        jd.Phong(0.5 * 0.99 / 1.3, np.multiply((0.1, 0.5, 0.8), 0.99 / 1.3), 7),
    ),
    ("principled", {}, jd.Principled()),
    (
        "principled",
        {"spec_trans": ("float", "0.5"), "sheen_tint": ("float", "0.5"), "flatness": ("float", "0")},
        jd.Principled(spec_trans=0.5),
    ),
    (
        "principled",
        {name: ("float", "0.3") for name in OPTIONAL},
        jd.Principled(**dict.fromkeys(OPTIONAL, 0.3)),
    ),
    (
        "principled",
        {"base_color": COLOR, "roughness": ("float", "0.2"), "eta": ("float", "1.5"), "clearcoat": ("float", "0")},
        jd.Principled((0.1, 0.5, 0.8), roughness=0.2, specular=0.5),
    ),
]


@pytest.mark.parametrize("kind, values, expected", CASES)
def test_parameters_and_defaults(kind, values, expected):
    material = parsed(kind, **values)
    assert jax.tree.structure(material) == jax.tree.structure(expected)
    for ours, theirs in zip(jax.tree.leaves(material), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6)


MIXTURE = '<bsdf type="mixturebsdf"><string name="weights" value="%s"/>%s</bsdf>'
PLAIN = '<bsdf type="diffuse"/>'
BLEND = '<bsdf type="blendbsdf"><float name="weight" value="0.2"/>'
NESTED = {
    f'{BLEND}<bsdf type="phong"/><bsdf type="plastic"/></bsdf>': jd.Blend(0.2, jd.Phong(), jd.Plastic()),
    f'{BLEND}<bsdf type="twosided"><bsdf type="phong"/></bsdf>'
    '<bsdf type="twosided"><bsdf type="plastic"/></bsdf></bsdf>': jd.TwoSided(jd.Blend(0.2, jd.Phong(), jd.Plastic())),
    '<bsdf type="mask"><rgb name="opacity" value="0.3, 0.3, 0.3"/><bsdf type="diffuse"/></bsdf>': jd.Mask(
        0.3, jd.Diffuse(0.5)
    ),
    MIXTURE % ("0.2, 0.3 0.5", PLAIN + '<bsdf type="phong"/><bsdf type="plastic"/>'): jd.Blend(
        0.5, jd.Blend(0.6, jd.Diffuse(0.5), jd.Phong()), jd.Plastic()
    ),
    MIXTURE % ("0.25", f'<bsdf type="twosided">{PLAIN}</bsdf>'): jd.TwoSided(
        jd.Blend(0.75, jd.Diffuse(0.5), jd.Diffuse(0.0))
    ),
    MIXTURE % ("0, 1", PLAIN + '<bsdf type="phong"/>'): jd.Blend(1.0, jd.Diffuse(0.5), jd.Phong()),
    MIXTURE % ("2, 2", PLAIN + '<bsdf type="phong"/>'): jd.Blend(0.5, jd.Diffuse(0.5), jd.Phong()),
    '<bsdf type="principledthin"><float name="sheen" value="0.3"/><float name="eta" value="1.7"/></bsdf>': jd.TwoSided(
        jd.Principled(0.5, 0.0, 0.5, 0.0, sheen=0.3)
    ),
}


@pytest.mark.filterwarnings("ignore:.*weights add up to 4")
@pytest.mark.parametrize("content", NESTED)
def test_nested(scene_file, content):
    made, expected = load_mitsuba(scene_file(SCENE % content)).shapes["c"].bsdf, NESTED[content]
    assert jax.tree.structure(made) == jax.tree.structure(expected)
    for ours, theirs in zip(jax.tree.leaves(made), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def test_what_is_said(scene_file):
    """Colours that reflect too much, and holes that would be coloured."""
    much = '<bsdf type="phong"><float name="diffuse_reflectance" value="1"/></bsdf>'
    with pytest.warns(UserWarning, match="the two reflectances add up to 1.2; both are made darker"):
        load_mitsuba(scene_file(SCENE % much))
    holes = '<bsdf type="mask"><rgb name="opacity" value="0.2, 0.5, 0.8"/><bsdf type="diffuse"/></bsdf>'
    with pytest.warns(UserWarning, match="opacity is one number for all colours here: the mean of"):
        mask = load_mitsuba(scene_file(SCENE % holes)).shapes["c"].bsdf
    np.testing.assert_allclose(mask.opacity, 0.5)
    with pytest.warns(UserWarning, match="the weights add up to 4; they are made smaller to add up to 1"):
        load_mitsuba(scene_file(SCENE % MIXTURE % ("2, 2", 2 * PLAIN)))
    one = '<bsdf type="blendbsdf"><float name="weight" value="0.2"/><bsdf type="twosided"><bsdf type="phong"/></bsdf>'
    one += '<bsdf type="plastic"/></bsdf>'
    with pytest.raises(ValueError, match="one BSDF of the blend is twosided and another is not"):
        load_mitsuba(scene_file(SCENE % one))


def test_in_a_scene(scene_file):
    path = scene_file(SCENE % '<bsdf type="twosided"><bsdf type="roughconductor"/></bsdf>')
    scene = load_mitsuba(path)
    assert isinstance(scene.shapes["c"].bsdf.bsdf, jd.RoughConductor)
    np.testing.assert_allclose(scene.parameters()["c.bsdf.alpha"], 0.1)
    brighter = scene.replace({"c.bsdf.alpha": jnp.asarray(0.2)})
    np.testing.assert_allclose(brighter.shapes["c"].bsdf.bsdf.alpha, 0.2)


WRONG = {
    '<bsdf type="twosided"><bsdf type="roughdielectric"/></bsdf>': "TwoSided: RoughDielectric lets light through",
    '<bsdf type="roughconductor"><float name="alpha" value="2"/></bsdf>': "RoughConductor: alpha must be in",
    '<bsdf type="roughconductor"><string name="material" value="Xx"/></bsdf>': "unknown material 'Xx'",
    '<bsdf type="roughconductor"><float name="alpha_u" value="0.1"/></bsdf>': "give both alpha_u and alpha_v",
    '<bsdf type="roughplastic"><float name="alpha_u" value="0.1"/><float name="alpha_v" value="0.2"/></bsdf>': (
        "alpha_u and alpha_v must be equal: this coat"
    ),
    '<bsdf type="twosided"><bsdf type="principled"><float name="spec_trans" value="1"/></bsdf></bsdf>': (
        "TwoSided: Principled lets light through"
    ),
    '<bsdf type="blendbsdf"><bsdf type="diffuse"/><bsdf type="plastic"/></bsdf>': "parameter 'weight' is missing",
    '<bsdf type="blendbsdf"><float name="weight" value="0.5"/><bsdf type="diffuse"/></bsdf>': "needs two <bsdf>",
    '<bsdf type="bumpmap"><bsdf type="diffuse"/></bsdf>': "needs a <texture> of heights inside",
    '<bsdf type="pplastic"/>': "unknown type 'pplastic'; polarisation is not supported",
    '<bsdf type="principled"><float name="gloss" value="1"/></bsdf>': "unknown parameter 'gloss'",
    '<bsdf type="hair"/>': "unknown type 'hair'",
    MIXTURE % ("0.5", 2 * PLAIN): "needs a weight of at least 0 for each of its 2 <bsdf>, got '0.5'",
    MIXTURE % ("-0.5, 1", 2 * PLAIN): "needs a weight of at least 0",
    '<bsdf type="principledthin"><float name="diff_trans" value="1"/></bsdf>': (
        r"a sheet that lets light through \(diff_trans other than 0\) is not supported; .*it lets none through"
    ),
}


LOBES_OF_A_SHEET = {"sheen": 0.7, "sheen_tint": 0.4, "flatness": 0.6}


@pytest.mark.parametrize("roughness", [0.0, 0.4, 1.0])
def test_a_sheet_is_mitsubas(scene_file, roughness):
    """`principledthin` without transmission, seen from both sides."""
    mi = pytest.importorskip("mitsuba", reason="Mitsuba 3 is not installed (extra `peers`)")
    mi.set_variant("scalar_rgb")
    values = {"roughness": roughness, "spec_tint": 0.3, "anisotropic": 0.5, **LOBES_OF_A_SHEET}
    base = '<rgb name="base_color" value="0.7, 0.3, 0.2"/>'
    numbers = "".join(f'<float name="{name}" value="{value}"/>' for name, value in values.items())
    content = f'<bsdf type="principledthin">{base}{numbers}</bsdf>'
    ours = load_mitsuba(scene_file(SCENE % content)).shapes["c"].bsdf
    theirs = mi.load_dict({"type": "principledthin", "base_color": {"type": "rgb", "value": [0.7, 0.3, 0.2]}, **values})
    assert isinstance(ours, jd.TwoSided)
    wi, wo = np.asarray(random_directions(100, 0, -1.0)), np.asarray(random_directions(100, 1))
    expected = []
    for a, b in zip(wi, wo, strict=True):
        si = mi.SurfaceInteraction3f()
        si.wi, si.sh_frame = a.tolist(), mi.Frame3f([0, 0, 1])
        expected.append(list(theirs.eval(mi.BSDFContext(), si, b.tolist())))
    assert (np.asarray(expected) > 0).any(1).sum() > 20
    upwards = np.where(wi[:, 2:] < 0, -1.0, 1.0)  # what `TwoSided` does
    found = call(ours.bsdf, "eval", upwards * wi, upwards * wo)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("content", WRONG)
def test_what_is_refused(scene_file, content):
    with pytest.raises(ValueError, match=WRONG[content]):
        load_mitsuba(scene_file(SCENE % content))
