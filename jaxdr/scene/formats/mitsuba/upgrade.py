"""Rewrites scene files of Mitsuba 0.x as files of Mitsuba 3.

It makes the changes that Mitsuba 3 itself makes when it reads such files. It also rewrites what Mitsuba 3 no longer
reads but can express: colours in sRGB or hexadecimal, the index around a metal, filters of images.
"""

import re

import numpy as np
from jaxtyping import Float

from jaxdr.images import from_srgb
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.number import floats

METALS = ("conductor", "roughconductor")
COLORS = ("rgb", "srgb", "spectrum")
UNBOUNDED = ("eta", "k", "scale", "int_ior", "ext_ior", "sigma_a", "sigma_s", "sigma_t")  # not reflectances
AIR = 1.000277
UV_SETTINGS = {"uoffset": 0.0, "voffset": 0.0, "uscale": 1.0, "vscale": 1.0}


def upgrade(element: Element) -> None:
    """Rewrite an element, and all elements of the same file inside it, in place.

    Names such as `maxDepth` and `intIOR` become snake_case. The colour of a diffuse BSDF becomes `reflectance`.
    `uscale` and its like become a transform. `<lookAt>` becomes `<lookat>`. Changes that alter the image a little, and
    guesses, are noted as problems.
    """
    if "name" in element.attributes:
        element.attributes["name"] = snake_case(element.attributes["name"])
    if element.tag == "lookAt":
        element.tag = "lookat"
    for child in element.children:
        if child.file == element.file:
            upgrade(child)
    if element.tag == "bsdf" and element.attributes.get("type") == "diffuse":
        for child in element.children:
            if child.attributes.get("name") == "diffuse_reflectance":
                child.attributes["name"] = "reflectance"
    if element.tag == "bsdf" and element.attributes.get("type") in METALS:
        _upgrade_metal(element)
    if element.tag == "texture":
        _upgrade_uvs(element)
        _upgrade_image(element)
    for child in element.children:
        if child.tag in COLORS and "value" in child.attributes:
            _upgrade_color(child, element)


def snake_case(name: str) -> str:
    """A name in snake_case: `intIOR` becomes `int_ior`. Capitals in a row are one word."""
    return re.sub(r"(?<=[a-z])[A-Z]+", lambda capitals: "_" + capitals[0].lower(), name)


def _upgrade_uvs(texture: Element) -> None:
    given = {child.attributes.get("name"): child for child in texture.children if child.tag == "float"}
    given = {name: child for name, child in given.items() if name in UV_SETTINGS}
    if not given:
        return
    texture.children[:] = [child for child in texture.children if child not in given.values()]
    text = {name: str(default) for name, default in UV_SETTINGS.items()}
    text |= {name: child.attributes.get("value", "") for name, child in given.items()}
    place = next(iter(given.values()))

    def made(tag: str, attributes: dict[str, str], children: list[Element]) -> Element:
        return Element(tag, attributes, place.file, place.line, children, texture.problems, texture.folders)

    steps = [
        made("translate", {"x": text["uoffset"], "y": text["voffset"]}, []),
        made("scale", {"x": text["uscale"], "y": text["vscale"]}, []),
    ]
    texture.children.append(made("transform", {"name": "to_uv"}, steps))


def _given(element: Element, name: str) -> Element | None:
    return next((child for child in element.children if child.attributes.get("name") == name), None)


def _upgrade_image(texture: Element) -> None:
    """Images become bilinear, and are decoded from sRGB unless they are `raw`."""
    kind, gamma = _given(texture, "filter_type"), _given(texture, "gamma")
    if kind is not None and kind.attributes.get("value") in ("trilinear", "ewa"):
        kind.harmless(f"filter_type {kind.attributes['value']!r} counts as bilinear: images have no smaller versions")
        kind.attributes["value"] = "bilinear"
    for name in ("max_anisotropy", "cache"):
        unused = _given(texture, name)
        if unused is not None:
            texture.children.remove(unused)
    if gamma is not None and re.fullmatch(r"\s*(-1|0|1|2\.2)(\.0*)?\s*", gamma.attributes.get("value", "")):
        texture.children.remove(gamma)
        value = float(gamma.attributes["value"])
        if value == 1:
            raw = {"name": "raw", "value": "true"}
            texture.children.append(Element("boolean", raw, gamma.file, gamma.line, [], gamma.problems, gamma.folders))
        elif value == 2.2:
            gamma.harmless("gamma 2.2 counts as sRGB")


def _upgrade_metal(metal: Element) -> None:
    """Indices become relative to the medium around the metal: in Mitsuba 3 that is vacuum."""
    if all(_given(metal, name) is None for name in ("material", "eta", "k")):
        metal.harmless("a metal without a material is a perfect mirror, as in Mitsuba 3; in Mitsuba 0.x it is copper")
    around = _given(metal, "ext_eta")
    if around is None:
        return
    text = around.attributes.get("value", "").strip().lower()
    outside = {"air": AIR, "vacuum": 1.0}.get(text)
    if outside is None:
        try:
            outside = floats(text, 1)[0]
        except ValueError:
            return  # `ext_eta` is reported later, as an unknown parameter
    if outside <= 0:
        return
    if abs(outside - 1) < 1e-3:  # air changes the indices by 0.03 %
        metal.children.remove(around)
        return
    given = [_given(metal, name) for name in ("eta", "k")]
    numbers = [None if one is None or one.tag == "texture" else _numbers(one) for one in given]
    if _given(metal, "material") is None and all(values is not None for values in numbers):
        metal.children.remove(around)
        for one, values in zip(given, numbers, strict=True):
            one.attributes["value"] = ", ".join(map(repr, (values / outside).tolist()))


def _upgrade_color(color: Element, owner: Element) -> None:
    """Colours in sRGB or hexadecimal, and spectra of three numbers for red, green and blue, become linear RGB.

    A reflectance above 1 can only be meant in bytes. It is noted as a problem.
    """
    values = _numbers(color)
    if values is None:
        color.tag = "rgb" if color.tag == "srgb" else color.tag  # what is wrong with it is told when it is read
        return
    name = color.attributes.get("name", "")
    if color.tag == "spectrum" and len(values) == 3:
        color.tag = "rgb"
    elif color.tag == "spectrum":
        return
    if owner.tag in ("bsdf", "texture") and name not in UNBOUNDED and 1 < values.max() <= 255:
        color.unsupported(f"colour {values.tolist()} is above 1", "it is divided by 255")
        values = values / 255
    if color.tag == "srgb":
        color.tag, values = "rgb", from_srgb(values)
    color.attributes["value"] = ", ".join(map(repr, values.tolist()))


def _numbers(element: Element) -> Float[np.ndarray, " n"] | None:
    """The one or three numbers of a colour; None if it is something else, which is reported when it is read."""
    text = element.attributes.get("value", "").strip()
    if re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        return np.array([int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    try:
        return np.array(floats(text, 1, 3))
    except ValueError:
        return None
