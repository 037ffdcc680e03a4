"""BSDF plugins of Mitsuba 3 scene files that stand alone: (their properties) -> our model, with Mitsuba's defaults.

What they have that our models have not is an error: a material is never loaded in part.
"""

from collections.abc import Callable
from typing import Any

from jaxdr.scene.bsdf import (
    BSDF,
    Conductor,
    Dielectric,
    Plastic,
    Principled,
    RoughConductor,
    RoughDielectric,
    RoughPlastic,
    ThinDielectric,
)
from jaxdr.scene.bsdf.materials import METALS
from jaxdr.scene.mitsuba_textures import textured_color, textured_number, textured_roughness
from jaxdr.scene.mitsuba_xml import NUMBER, Properties

# Lobes of Mitsuba's principled BSDF that ours has not; without them their other settings have no effect.
MISSING_LOBES = ("spec_trans", "anisotropic", "spec_tint", "sheen", "flatness", "clearcoat")
WITHOUT_EFFECT = (
    *("sheen_tint", "clearcoat_gloss"),
    *("diffuse_reflectance_sampling_rate", "main_specular_sampling_rate", "clearcoat_sampling_rate"),
)


def _metal(properties: Properties) -> dict[str, Any]:
    """Index and colour of a conductor."""
    material = properties.value("material", "string", "none")
    plain = material.removesuffix("_palik")  # Mitsuba's files of both names are the same where ours has only one
    found: dict[str, Any] = {"material": plain if material not in METALS and plain in METALS else material}
    if material == "none":
        found["material"] = None
    return {**found, **_colors(properties, "eta", "k", "specular_reflectance")}


def _colors(properties: Properties, *names: str) -> dict[str, Any]:
    given = {name: textured_color(properties, name, None) for name in names}
    return {name: value for name, value in given.items() if value is not None}


def _interface(properties: Properties, inside: str) -> dict[str, Any]:
    """Indices of a dielectric."""
    names = {"int_ior": inside, "ext_ior": "air"}
    return {name: properties.value(name, f"string {NUMBER}", default) for name, default in names.items()}


def _roughness(properties: Properties) -> dict[str, Any]:
    """Distribution of microfacets."""
    properties.ignore("sample_visible")  # a matter of noise
    along, across = (properties.value(name, NUMBER) for name in ("alpha_u", "alpha_v"))
    alpha = textured_roughness(properties, "alpha")
    if along != across:
        raise ValueError("alpha_u and alpha_v must be equal: anisotropic roughness is not supported")
    if along is not None and alpha is not None:
        raise ValueError("give either alpha or alpha_u and alpha_v, not both")
    given = next((value for value in (alpha, along) if value is not None), 0.1)
    return {"alpha": given, "distribution": properties.value("distribution", "string", "beckmann")}


def _base(properties: Properties) -> dict[str, Any]:
    """Diffuse base of a plastic, and its coat."""
    return {
        **_interface(properties, "polypropylene"),
        **_colors(properties, "diffuse_reflectance", "specular_reflectance"),
        "nonlinear": properties.value("nonlinear", "boolean", False),
    }


def _two_lobes(properties: Properties) -> dict[str, Any]:
    """Indices and colours of a dielectric."""
    return {**_interface(properties, "bk7"), **_colors(properties, "specular_reflectance", "specular_transmittance")}


def _principled(properties: Properties) -> Principled:
    for name in MISSING_LOBES:
        if properties.value(name, NUMBER, 0.0) != 0:
            raise ValueError(f"{name} other than 0 is not supported")
    properties.ignore(*WITHOUT_EFFECT)
    specular, eta = textured_number(properties, "specular", None), properties.value("eta", NUMBER)
    if specular is not None and eta is not None:
        raise ValueError("give either specular or eta, not both")
    if eta is not None:
        specular = ((eta - 1) / (eta + 1)) ** 2 / 0.08  # as Mitsuba relates the two
    return Principled(
        textured_color(properties, "base_color", 0.5),
        textured_number(properties, "metallic", 0.0),
        textured_number(properties, "roughness", 0.5),
        0.5 if specular is None else specular,
    )


MATERIALS: dict[str, Callable[[Properties], BSDF]] = {
    "roughconductor": lambda properties: RoughConductor(**_metal(properties), **_roughness(properties)),
    "roughdielectric": lambda properties: RoughDielectric(**_two_lobes(properties), **_roughness(properties)),
    "roughplastic": lambda properties: RoughPlastic(**_base(properties), **_roughness(properties)),
    "principled": _principled,
    "conductor": lambda properties: Conductor(**_metal(properties)),
    "dielectric": lambda properties: Dielectric(**_two_lobes(properties)),
    "thindielectric": lambda properties: ThinDielectric(**_two_lobes(properties)),
    "plastic": lambda properties: Plastic(**_base(properties)),
}
