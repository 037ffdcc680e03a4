"""BSDF plugins of Mitsuba 3 scene files."""

from collections.abc import Callable

import numpy as np

from jaxdr.scene.bsdf import BSDF, Diffuse, Mask, NormalMap, TwoSided
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_materials import MATERIALS
from jaxdr.scene.mitsuba_textures import textured_color, textured_number
from jaxdr.scene.mitsuba_xml import Properties, read_plugin
from jaxdr.scene.textures import Texture


def _diffuse(element: Element) -> Diffuse:
    reflectance = textured_color(Properties(element), "reflectance", 0.5)
    if isinstance(reflectance, Texture):
        return Diffuse(reflectance)
    if np.min(reflectance) < 0 or np.max(reflectance) > 1:
        raise ValueError(f"reflectance must be in [0, 1], got {np.asarray(reflectance).tolist()}")
    return Diffuse(reflectance)


def _two_sided(element: Element) -> TwoSided:
    inner, bsdf = _inner(Properties(element))
    if isinstance(bsdf, TwoSided):
        raise inner.error("the BSDF inside is two-sided already")
    return TwoSided(bsdf)


def _mask(element: Element) -> Mask | TwoSided:
    """Of a two-sided BSDF as well: the holes have no sides."""
    properties = Properties(element)
    opacity = textured_number(properties, "opacity", 0.5)
    _, bsdf = _inner(properties)
    if isinstance(bsdf, TwoSided):
        return TwoSided(Mask(opacity, bsdf.bsdf))
    return Mask(opacity, bsdf)


def _normal_map(element: Element) -> NormalMap | TwoSided:
    properties = Properties(element)
    normal = textured_color(properties, "normalmap", None)
    for name in ("flip_invalid_normals", "use_shadowing_function"):
        if not properties.value(name, "boolean", True):
            raise ValueError(f"{name} other than true is not supported")
    inner, bsdf = _inner(properties)
    if not isinstance(normal, Texture):
        raise ValueError("needs a <texture> named 'normalmap'")
    if isinstance(bsdf, TwoSided):
        inner.unsupported(
            "twosided inside a normalmap is not supported; put it around", "the back's bumps are those of the front"
        )
        return TwoSided(NormalMap(normal, bsdf.bsdf))
    return NormalMap(normal, bsdf)


def _inner(properties: Properties) -> tuple[Element, BSDF | TwoSided]:
    """The one BSDF that an adapter holds."""
    inner = properties.at_most_one("bsdf")
    if inner is None:
        raise ValueError("needs a <bsdf> inside")
    return inner, read_bsdf(inner)


BSDFS: dict[str, Callable[[Element], BSDF | TwoSided]] = {
    "diffuse": _diffuse,
    "twosided": _two_sided,
    "mask": _mask,
    "normalmap": _normal_map,
    **{name: lambda element, make=make: make(Properties(element)) for name, make in MATERIALS.items()},
}


def read_bsdf(element: Element) -> BSDF | TwoSided:
    """A `<bsdf>`; grey where it can't be read, which is noted as a problem."""
    bsdf = read_plugin(element, BSDFS, "a grey diffuse BSDF takes its place")
    return Diffuse(0.5) if bsdf is None else bsdf
