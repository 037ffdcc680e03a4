"""BSDF plugins of Mitsuba 3 scene files."""

import itertools
from collections.abc import Callable

import numpy as np

from jaxdr.scene.bsdf import BSDF, Blend, BumpMap, Diffuse, Mask, NormalMap, TwoSided
from jaxdr.scene.formats.mitsuba.document import descendants
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.materials import MATERIALS
from jaxdr.scene.formats.mitsuba.number import floats
from jaxdr.scene.formats.mitsuba.textures import heights, opacity, textured_color, textured_number
from jaxdr.scene.formats.mitsuba.xml import NUMBER, Properties, read_plugin
from jaxdr.scene.scene import unwrap
from jaxdr.scene.textures import Texture
from jaxdr.untrusted import shortened

MOST_BSDFS = 128  # in one: they are computed one after the other, and few references make many
ROUNDING = 1e-5  # weights that are meant to add up to 1 may differ from it by this


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
    """A mask, also of a two-sided BSDF: the holes are the same from both sides."""
    properties = Properties(element)
    share = opacity(properties, "opacity", 0.5)
    _, bsdf = _inner(properties)
    if isinstance(bsdf, TwoSided):
        return TwoSided(Mask(share, bsdf.bsdf))
    return Mask(share, bsdf)


def _normal_map(element: Element) -> BSDF | TwoSided:
    properties = Properties(element)
    normal = textured_color(properties, "normalmap", None)
    _as_by_default(properties)
    inner, bsdf = _inner(properties)
    if not isinstance(normal, Texture):
        raise ValueError("needs a <texture> named 'normalmap'")
    return _mapped(element.type, inner, bsdf, lambda inside: NormalMap(normal, inside))


def _bump_map(element: Element) -> BSDF | TwoSided:
    properties = Properties(element)
    _as_by_default(properties)
    scale = properties.value("scale", NUMBER, 1.0)
    inner, bsdf = _inner(properties)
    height = heights(properties)
    return _mapped(element.type, inner, bsdf, lambda inside: BumpMap(height, inside, scale))


def _as_by_default(properties: Properties) -> None:
    for name in ("flip_invalid_normals", "use_shadowing_function"):
        if not properties.value(name, "boolean", True):
            raise ValueError(f"{name} other than true is not supported")


def _mapped(kind: str, inner: Element, bsdf: BSDF | TwoSided, make: Callable[[BSDF], BSDF]) -> BSDF | TwoSided:
    """A normal or bump map of a BSDF. For a two-sided BSDF both sides have the same map."""
    if not isinstance(bsdf, TwoSided):
        return make(bsdf)
    inner.unsupported(
        f"twosided inside a {kind} is not supported; put it around", "the back's bumps are those of the front"
    )
    return TwoSided(make(bsdf.bsdf))


def _blend(element: Element) -> Blend | TwoSided:
    """A blend: 1 - `weight` of the first BSDF, and `weight` of the second."""
    properties = Properties(element)
    weight = textured_number(properties, "weight", None)
    if weight is None:
        raise ValueError("parameter 'weight' is missing")
    elements = properties.objects("bsdf")
    if len(elements) != 2:
        raise ValueError(f"needs two <bsdf> inside, got {len(elements)}")
    two_sided, (first, second) = _mixed(element, elements)
    blend = Blend(weight, first, second)
    return TwoSided(blend) if two_sided else blend


def _mixture(element: Element) -> BSDF | TwoSided:
    """Any number of BSDFs with a weight each (Mitsuba 0.x), as blends in blends. What is missing to 1 is black."""
    properties = Properties(element)
    elements, text = properties.objects("bsdf"), properties.value("weights", "string", "")
    weights = floats(text, *range(1, len(elements) + 1))
    if len(weights) != len(elements) or min(weights) < 0:
        raise ValueError(f"needs a weight of at least 0 for each of its {len(elements)} <bsdf>, got {shortened(text)}")
    total = sum(weights)
    if total > 1 + ROUNDING:
        element.harmless(f"the weights add up to {total:g}; they are made smaller to add up to 1, as in Mitsuba 0.x")
        weights, total = [weight / total for weight in weights], 1.0
    two_sided, parts = _mixed(element, elements)
    if total < 1 - ROUNDING:
        weights, parts = [*weights, 1 - total], [*parts, Diffuse(0.0)]
    mixture, mass = parts[0], weights[0]
    for part, weight in zip(parts[1:], weights[1:], strict=True):
        mass += weight
        mixture = Blend(weight / mass if mass else 1.0, mixture, part)
    return TwoSided(mixture) if two_sided else mixture


def _mixed(element: Element, elements: list[Element]) -> tuple[bool, list[BSDF]]:
    """(whether the BSDFs of a mixture are two-sided, those BSDFs without `TwoSided`)."""
    bsdfs = [read_bsdf(inner) for inner in elements]
    sides = {isinstance(bsdf, TwoSided) for bsdf in bsdfs}
    if len(sides) > 1:
        element.unsupported(
            "one BSDF of the blend is twosided and another is not; put twosided around the blend", "all of them are"
        )
    return True in sides, [unwrap(bsdf) for bsdf in bsdfs]


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
    "bumpmap": _bump_map,
    "blendbsdf": _blend,
    "mixturebsdf": _mixture,
    **{name: lambda element, make=make: make(Properties(element)) for name, make in MATERIALS.items()},
}


def read_bsdf(element: Element) -> BSDF | TwoSided:
    """The BSDF of a `<bsdf>`. If it can't be read, it is grey, and that is noted as a problem."""
    inside = (child for _, child in descendants(element) if child.tag == "bsdf")
    if sum(1 for _ in itertools.islice(inside, MOST_BSDFS + 1)) > MOST_BSDFS:
        element.problems.add(element, element.place(f"more than {MOST_BSDFS} BSDFs inside; make it simpler"))
        return Diffuse(0.5)
    bsdf = read_plugin(element, BSDFS, "a grey diffuse BSDF takes its place")
    return Diffuse(0.5) if bsdf is None else bsdf
