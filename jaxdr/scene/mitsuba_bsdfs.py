"""BSDF plugins of Mitsuba 3 scene files."""

from collections.abc import Callable

import numpy as np

from jaxdr.scene.bsdf import BSDF, Diffuse, TwoSided
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_materials import MATERIALS
from jaxdr.scene.mitsuba_textures import color
from jaxdr.scene.mitsuba_xml import Properties, read_plugin


def _diffuse(element: Element) -> Diffuse:
    reflectance = color(Properties(element), "reflectance", 0.5)
    if np.min(reflectance) < 0 or np.max(reflectance) > 1:
        raise ValueError(f"reflectance must be in [0, 1], got {np.asarray(reflectance).tolist()}")
    return Diffuse(reflectance)


def _two_sided(element: Element) -> TwoSided:
    inner = Properties(element).at_most_one("bsdf")
    if inner is None:
        raise ValueError("needs a <bsdf> inside")
    bsdf = read_bsdf(inner)
    if isinstance(bsdf, TwoSided):
        raise inner.error("the BSDF inside is two-sided already")
    return TwoSided(bsdf)


BSDFS: dict[str, Callable[[Element], BSDF | TwoSided]] = {
    "diffuse": _diffuse,
    "twosided": _two_sided,
    **{name: lambda element, make=make: make(Properties(element)) for name, make in MATERIALS.items()},
}


def read_bsdf(element: Element) -> BSDF | TwoSided:
    """A `<bsdf>`; grey where it can't be read, which is noted as a problem."""
    bsdf = read_plugin(element, BSDFS, "a grey diffuse BSDF takes its place")
    return Diffuse(0.5) if bsdf is None else bsdf
