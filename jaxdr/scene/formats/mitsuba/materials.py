"""BSDF plugins of Mitsuba 3 scene files that hold no other BSDF: functions from properties to our models.

Defaults are Mitsuba's. A parameter that our model lacks is an error: a material is never loaded in part.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxdr.scene.bsdf import (
    BSDF,
    Conductor,
    Dielectric,
    Phong,
    Plastic,
    Principled,
    RoughConductor,
    RoughDielectric,
    RoughPlastic,
    ThinDielectric,
    TwoSided,
)
from jaxdr.scene.bsdf.materials import METALS
from jaxdr.scene.bsdf.parameters import rgb
from jaxdr.scene.bsdf.phong import most
from jaxdr.scene.bsdf.principled import OPTIONAL
from jaxdr.scene.formats.mitsuba.textures import textured_color, textured_number, textured_roughness
from jaxdr.scene.formats.mitsuba.xml import NUMBER, Properties
from jaxdr.scene.textures import Texture

SAMPLING = ("diffuse_reflectance_sampling_rate", "main_specular_sampling_rate", "clearcoat_sampling_rate")
SAMPLING_OF_THIN = tuple(
    f"{lobe}_{way}_sampling_rate" for lobe in ("diffuse", "specular") for way in ("reflectance", "transmittance")
)
# Parameters of Principled that have no effect without the lobe to which they belong.
DETAILS = {"sheen_tint": "sheen", "clearcoat_gloss": "clearcoat"}


def _metal(properties: Properties) -> dict[str, Any]:
    """Index and colour of a conductor."""
    material = properties.value("material", "string", "none")
    plain = material.removesuffix("_palik")  # where our table has only one of two names, Mitsuba's files are the same
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
    """Distribution and roughness of microfacets, isotropic or anisotropic."""
    properties.ignore("sample_visible")  # only the noise depends on it
    along, across = (textured_roughness(properties, name) for name in ("alpha_u", "alpha_v"))
    alpha = textured_roughness(properties, "alpha")
    if (along is None) != (across is None):
        raise ValueError("give both alpha_u and alpha_v, or neither")
    if along is not None and alpha is not None:
        raise ValueError("give either alpha or alpha_u and alpha_v, not both")
    found: dict[str, Any] = {"distribution": properties.value("distribution", "string", "beckmann")}
    if along is None:
        return {"alpha": 0.1 if alpha is None else alpha, **found}
    same = not isinstance(along, Texture) and not isinstance(across, Texture) and along == across
    return {"alpha": along, **found} if same else {"alpha": along, "alpha_v": across, **found}


def _isotropic(properties: Properties) -> dict[str, Any]:
    found = _roughness(properties)
    if "alpha_v" in found:
        raise ValueError("alpha_u and alpha_v must be equal: this coat is equally rough in all directions")
    return found


def _phong(properties: Properties) -> Phong:
    """The Phong model of Mitsuba 0.x, which darkens the colours if they reflect more light than arrives."""
    diffuse, specular = (
        textured_color(properties, name, default)
        for name, default in (("diffuse_reflectance", 0.5), ("specular_reflectance", 0.2))
    )
    exponent = textured_number(properties, "exponent", 30.0)
    total = most(rgb(diffuse, "diffuse_reflectance"), rgb(specular, "specular_reflectance"))
    if total is not None and total > 1.0:
        message = f"the two reflectances add up to {total:.3g}; both are made darker, so that they reflect 0.99 at most"
        warnings.warn(properties.element.place(message), stacklevel=2)
        diffuse, specular = (
            value.times(0.99 / total) if isinstance(value, Texture) else 0.99 / total * np.asarray(value)
            for value in (diffuse, specular)
        )
    return Phong(diffuse, specular, exponent)


def _base(properties: Properties) -> dict[str, Any]:
    """Diffuse base and coat of a plastic."""
    return {
        **_interface(properties, "polypropylene"),
        **_colors(properties, "diffuse_reflectance", "specular_reflectance"),
        "nonlinear": properties.value("nonlinear", "boolean", False),
    }


def _two_lobes(properties: Properties) -> dict[str, Any]:
    """Indices and colours of a dielectric."""
    return {**_interface(properties, "bk7"), **_colors(properties, "specular_reflectance", "specular_transmittance")}


def _lobes(properties: Properties, names: tuple[str, ...]) -> dict[str, Any]:
    """The lobes of the principled model with these names, as far as they have an effect."""
    lobes = {name: textured_number(properties, name, 0.0) for name in names}
    lobes = {name: value for name, value in lobes.items() if isinstance(value, Texture) or value != 0}
    return {name: value for name, value in lobes.items() if DETAILS.get(name, name) in lobes}


def _principled(properties: Properties) -> Principled:
    properties.ignore(*SAMPLING)
    lobes = _lobes(properties, OPTIONAL)
    specular, eta = textured_number(properties, "specular", None), properties.value("eta", NUMBER)
    if specular is not None and eta is not None:
        raise ValueError("give either specular or eta, not both")
    if eta is not None:
        if not eta > 0:
            raise ValueError(f"eta must be positive, got {eta}")
        specular = ((eta - 1) / (eta + 1)) ** 2 / 0.08  # as Mitsuba relates the two
    return Principled(
        textured_color(properties, "base_color", 0.5),
        textured_number(properties, "metallic", 0.0),
        textured_number(properties, "roughness", 0.5),
        0.5 if specular is None else specular,
        **lobes,
    )


def _thin(properties: Properties) -> TwoSided:
    """A thin sheet. If no light goes through it, it reflects as a two-sided principled surface without facets."""
    properties.ignore(*SAMPLING_OF_THIN)
    for name in _lobes(properties, ("spec_trans", "diff_trans")):
        message = f"a sheet that lets light through ({name} other than 0) is not supported"
        properties.element.unsupported(message, "it lets none through")
    for name in ("anisotropic", "spec_tint", "eta"):  # they only change the lobes of `spec_trans`
        textured_number(properties, name, None)
    base, roughness = textured_color(properties, "base_color", 0.5), textured_number(properties, "roughness", 0.5)
    return TwoSided(Principled(base, 0.0, roughness, 0.0, **_lobes(properties, ("sheen", "sheen_tint", "flatness"))))


MATERIALS: dict[str, Callable[[Properties], BSDF | TwoSided]] = {
    "roughconductor": lambda properties: RoughConductor(**_metal(properties), **_roughness(properties)),
    "roughdielectric": lambda properties: RoughDielectric(**_two_lobes(properties), **_roughness(properties)),
    "roughplastic": lambda properties: RoughPlastic(**_base(properties), **_isotropic(properties)),
    "principled": _principled,
    "principledthin": _thin,
    "conductor": lambda properties: Conductor(**_metal(properties)),
    "dielectric": lambda properties: Dielectric(**_two_lobes(properties)),
    "thindielectric": lambda properties: ThinDielectric(**_two_lobes(properties)),
    "phong": _phong,
    "plastic": lambda properties: Plastic(**_base(properties)),
}
