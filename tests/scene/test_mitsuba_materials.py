"""BSDF plugins of Mitsuba scene files: parameters, defaults, what is refused."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.mitsuba import load_mitsuba
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_materials import MATERIALS
from jaxdr.scene.mitsuba_xml import Properties

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
    ("principled", {}, jd.Principled()),
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
    '<bsdf type="roughconductor"><float name="alpha_u" value="0.1"/></bsdf>': "anisotropic roughness is not supported",
    '<bsdf type="principled"><float name="clearcoat" value="1"/></bsdf>': "clearcoat other than 0 is not supported",
    '<bsdf type="principled"><float name="gloss" value="1"/></bsdf>': "unknown parameter 'gloss'",
    '<bsdf type="hair"/>': "unknown type 'hair'",
}


@pytest.mark.parametrize("content", WRONG)
def test_what_is_refused(scene_file, content):
    with pytest.raises(ValueError, match=WRONG[content]):
        load_mitsuba(scene_file(SCENE % content))
