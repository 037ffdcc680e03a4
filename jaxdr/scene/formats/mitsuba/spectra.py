"""Spectra of Mitsuba 3 scene files, given by wavelength, as the linear RGB of Mitsuba's RGB variants."""

import functools
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.number import floats, number
from jaxdr.untrusted import shortened, text_of

TABLES = Path(__file__).with_name("cie_1931.csv")  # CIE 1931 2° observer and illuminant D65, 360 to 830 nm
STEPS = 1000  # points of Mitsuba's quadrature, with both ends
# Mitsuba's own constants: the integral of y, and the mean by which it divides D65. Together they make white 0.999.
Y_INTEGRAL, D65_SCALE = 106.7502593994140625, 98.99741751876255
# Linear sRGB of a light whose spectrum is 1 everywhere (XYZ = 1, 1, 1). As a reflectance such a spectrum is 1, 1, 1.
EQUAL_ENERGY_LIGHT = np.array([1.204794, 0.948292, 0.908916])
INDICES = ("eta", "k")
XYZ_TO_RGB = np.array(  # ITU-R BT.709 primaries, D65
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)


@functools.cache
def _weights() -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """(wavelengths of the quadrature in nm, colour matching functions times weights of the quadrature, D65)."""
    nm, x, y, z, d65 = np.loadtxt(TABLES, delimiter=",", skiprows=1).T
    at = np.linspace(nm[0], nm[-1], STEPS)
    matching = np.stack([np.interp(at, nm, curve) for curve in (x, y, z)], axis=1)
    return at, matching * ((nm[-1] - nm[0]) / STEPS / Y_INTEGRAL), np.interp(at, nm, d65 / D65_SCALE)


def spectrum_to_rgb(
    nm: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], is_light: bool
) -> Float[np.ndarray, "3"]:
    """Linear RGB of a spectrum. Its values at increasing wavelengths (nm) are joined by lines, and are zero outside.

    A light is converted as it is. Anything else (a reflectance, an index of a metal) is seen under D65, so that a
    constant is grey. Colours outside of sRGB's gamut are clamped at zero.
    """
    at, matching, d65 = _weights()
    spectrum = np.interp(at, nm, values, left=0.0, right=0.0)
    return np.maximum(XYZ_TO_RGB @ ((spectrum if is_light else spectrum * d65) @ matching), 0.0)


def surface_color(element: Element) -> Float[np.ndarray, "3"]:
    """Linear RGB of a `<spectrum>` that is a reflectance, a transmittance, or an index of a metal.

    If a reflectance is at most 1 at all wavelengths, its RGB is clamped at 1.
    """
    return _color(element, is_light=False)


def light_color(element: Element) -> Float[np.ndarray, "3"]:
    """Linear RGB of a `<spectrum>` of a light."""
    return _color(element, is_light=True)


def _color(element: Element, is_light: bool) -> Float[np.ndarray, "3"]:
    """RGB of one value for all wavelengths, of pairs such as `400:0.3, 500:0.4`, or of a file with a pair a line."""
    is_reflectance = not is_light and element.attributes.get("name") not in INDICES
    if "filename" in element.attributes:
        path = element.find_file(element.attributes["filename"])
        lines = [line.split("#")[0].split() for line in text_of(path).splitlines()]
        pairs = [(f"{path}, line {number}: ", line) for number, line in enumerate(lines, 1) if line]
        return _of_pairs(pairs, f"{path}: ", is_light, is_reflectance)
    words = element.attributes["value"].replace(",", " ").split()
    if len(words) == 1 and ":" not in words[0]:
        return (EQUAL_ENERGY_LIGHT if is_light else np.ones(3)) * floats(words[0], 1)[0]
    return _of_pairs([("", word.split(":")) for word in words], "", is_light, is_reflectance)


def _of_pairs(
    pairs: list[tuple[str, list[str]]], place: str, is_light: bool, is_reflectance: bool
) -> Float[np.ndarray, "3"]:
    """RGB of pairs of wavelength and value, each with its place in a file."""
    numbers = []
    for at, pair in pairs:
        text = ":".join(pair)
        if len(pair) != 2:
            raise ValueError(
                f"{at}expected pairs of wavelength and value such as 400:0.3, 500:0.4, got {shortened(text)}"
            )
        try:
            numbers.append([number(word, text) for word in pair])
        except ValueError as error:
            raise ValueError(f"{at}{error}") from error
    nm, values = np.array(numbers).reshape(-1, 2).T
    if len(nm) < 2 or np.any(np.diff(nm) <= 0):
        raise ValueError(f"{place}a spectrum needs two or more wavelengths (nm), in increasing order")
    rgb = spectrum_to_rgb(nm, values, is_light)
    return np.minimum(rgb, 1.0) if is_reflectance and values.max() <= 1 else rgb
