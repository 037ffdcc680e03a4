"""Texture and spectrum plugins of Mitsuba 3 scene files, and functions that read parameters which may be textures.

Mitsuba's v starts at the top of an image. Here it starts at the bottom, and `to_uv` is converted accordingly.
"""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxdr.arrays import as_array
from jaxdr.scene.bsdf.parameters import SMOOTHEST
from jaxdr.scene.color import LUMINANCE
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.xml import COLOR, NUMBER, Properties, read_plugin
from jaxdr.scene.textures import Bitmap, Checkerboard, FaceColors, Texture, VertexColors

VERTEX_COLOR = "vertex_color"
ATTRIBUTES = ("vertex_", "face_")
# Filters of Mitsuba 0.x that blur distant textures. Without them the image is the same but for that blur, and noisier.
BLURRED = ("trilinear", "ewa")


def _uniform(element: Element) -> ArrayLike:
    return Properties(element).value("value", NUMBER, 1.0)


def _d65(element: Element) -> ArrayLike:
    """Daylight, the white of linear sRGB."""
    return Properties(element).value("scale", NUMBER, 1.0)


def _bitmap(element: Element) -> Bitmap:
    """An image file. Its alpha is dropped."""
    properties = Properties(element)
    properties.ignore("format", "accel")  # they only change the precision
    filename = properties.value("filename", "string")
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    return Bitmap.from_file(
        element.find_file(filename),
        raw=properties.value("raw", "boolean", False),
        filter=_filter(properties),
        wrap=properties.value("wrap_mode", "string", "repeat"),
        to_uv=_to_uv(properties),
    )


def _filter(properties: Properties) -> str:
    name = properties.value("filter_type", "string", "bilinear")
    if name not in BLURRED:
        return name
    properties.ignore("max_anisotropy")
    return "bilinear"


def _checkerboard(element: Element) -> Checkerboard:
    properties = Properties(element)
    colors = (color(properties, name, default) for name, default in (("color0", 0.4), ("color1", 0.2)))
    return Checkerboard(*colors, to_uv=_to_uv(properties))


def _to_uv(properties: Properties) -> Float[np.ndarray, "2 3"] | None:
    """The map of our UVs. It turns v over before and after Mitsuba's map, which is the x and y part of a transform."""
    given = properties.value("to_uv", "transform")
    if given is None:
        return None
    theirs = np.eye(3)
    theirs[:2] = given[:2, [0, 1, 3]]
    turned = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, 1.0]])
    return (turned @ theirs @ turned)[:2]


def _mesh_attribute(element: Element) -> VertexColors | FaceColors:
    """Values that the file of a mesh stores at its vertices or faces."""
    properties = Properties(element)
    name, scale = properties.value("name", "string", ""), properties.value("scale", NUMBER, 1.0)
    if not name.startswith(ATTRIBUTES):
        raise ValueError(f"the name of an attribute starts with {' or '.join(ATTRIBUTES)}, got {name!r}")
    model = VertexColors if name.startswith("vertex_") else FaceColors
    if element.vertex_data is None:  # outside of a shape it is only checked
        return model(np.full((1, 3), 0.5))
    if name not in element.vertex_data:
        raise ValueError(f"the mesh has no attribute {name!r}; it has: {', '.join(element.vertex_data) or 'none'}")
    values = element.vertex_data[name]
    if values is None:
        raise ValueError(
            f"vertices at the same position have different values of {name!r}, and are one vertex with one value here"
        )
    return model(scale * np.asarray(values))


def _scale(element: Element) -> ArrayLike | Texture:
    """A texture times a number (Mitsuba 0.x)."""
    properties = Properties(element)
    factor = properties.value("scale", NUMBER, 1.0)
    texture = any_texture(properties)
    with np.errstate(over="ignore"):
        scaled = texture.times(factor)
    if not all(np.isfinite(np.asarray(array)).all() for array in scaled.data()):
        raise ValueError(f"its values times {factor:g} are not finite")
    return scaled


CONSTANTS: dict[str, Callable[[Element], ArrayLike]] = {"uniform": _uniform, "d65": _d65}
TEXTURES: dict[str, Callable[[Element], ArrayLike | Texture]] = {
    **CONSTANTS,
    "bitmap": _bitmap,
    "checkerboard": _checkerboard,
    "mesh_attribute": _mesh_attribute,
    "scale": _scale,
}


def color(properties: Properties, name: str, default: ArrayLike) -> ArrayLike:
    """Take a colour from a number, `<rgb>`, `<spectrum>`, or a nested uniform texture."""
    element = properties.texture(name)
    if element is None:
        return properties.value(name, COLOR, default)
    if element.type in TEXTURES and element.type not in CONSTANTS:
        element.unsupported(f"a texture can't give {name!r} here; give a constant", "the default is used")
        return default
    value = read_plugin(element, CONSTANTS, f"{name} is {np.asarray(default).tolist()}")
    return default if value is None else value


def textured_color(properties: Properties, name: str, default: ArrayLike | None) -> Any:
    """Take a colour that may be a texture."""
    return _textured(properties, name, COLOR, default, _in_color)


def textured_number(properties: Properties, name: str, default: ArrayLike | None) -> Any:
    """Take a number that may be a texture. A texture of colours gives their luminance."""
    return _textured(properties, name, NUMBER, default, _as_number)


def _in_color(value: Texture) -> Texture:
    return value.fitted(3, "a colour")


def _as_number(value: Texture) -> Texture:
    """The same texture, but with luminance in place of colours."""
    if isinstance(value, Bitmap) and value.pixels.shape[-1] == 3:
        return eqx.tree_at(lambda t: t.pixels, value, _grey(value.pixels))
    if isinstance(value, Checkerboard):
        # Mitsuba 3.9 swaps the two colours of a board where it asks for a number instead of RGB.
        first, second = (_grey(c) if c.shape == (3,) else c for c in (value.color1, value.color0))
        return eqx.tree_at(lambda t: (t.color0, t.color1), value, (first, second))
    return value


def _grey(rgb: Float[Array, "*n 3"]) -> Float[Array, "*n 1"]:
    """Luminance of RGB, computed on the host."""
    red, green, blue = (share * np.asarray(rgb)[..., k] for k, share in enumerate(LUMINANCE))
    return as_array((red + green + blue)[..., None])


def textured_roughness(properties: Properties, name: str) -> Any:
    """Take the alpha of a microfacet distribution. Values of a texture that are too small become the least allowed."""
    return _textured(properties, name, NUMBER, None, _rough_enough)


def _rough_enough(value: Texture) -> Texture:
    number = _as_number(value)
    raised = tuple(as_array(np.maximum(array, SMOOTHEST)) for array in number.data())
    return eqx.tree_at(lambda t: t.data(), number, raised)


def opacity(properties: Properties, name: str, default: float) -> Any:
    """Take a number that may be a texture or a colour. A colour gives its mean, as in Mitsuba 3."""
    if properties.tag(name) not in ("rgb", "spectrum"):
        return textured_number(properties, name, default)
    given = np.asarray(properties.value(name, COLOR)) * np.ones(3)
    if np.ptp(given) > 0:
        message = f"{name} is one number for all colours here: the mean of {given.tolist()}, as in Mitsuba 3"
        warnings.warn(properties.element.place(message), stacklevel=2)
    return float(given.mean())


def any_texture(properties: Properties) -> Texture:
    """Take the one texture inside, whatever its name. Raises ValueError if there is none."""
    return _inside(properties, "any kind", lambda texture: texture)


def heights(properties: Properties) -> Texture:
    """Take the one texture inside, whatever its name, as numbers. Raises ValueError if there is none."""
    return _inside(properties, "heights", _as_number)


def _inside(properties: Properties, what: str, convert: Callable[[Texture], Texture]) -> Texture:
    element = properties.at_most_one("texture")
    if element is None:
        raise ValueError(f"needs a <texture> of {what} inside")
    value = read_plugin(element, TEXTURES, "there is none")
    return _converted(element, value, convert) if isinstance(value, Texture) else Bitmap(np.zeros((1, 1)))


def _converted(element: Element, texture: Texture, convert: Callable[[Texture], Texture]) -> Texture:
    """The texture of an element after a conversion, which is done once, as the element is read once."""
    if element.needs_mesh:
        return convert(texture)
    made = element.made.setdefault(convert, [])
    if not made:
        made.append(convert(texture))
    return made[0]


def _textured(properties: Properties, name: str, tags: str, default, convert: Callable[[Texture], Texture]):
    element = properties.texture(name)
    if element is None:
        return properties.value(name, tags, default)
    instead = f"{name} is left at its default" if default is None else f"{name} is {np.asarray(default).tolist()}"
    value = read_plugin(element, TEXTURES, instead)
    if isinstance(value, Texture):
        return _converted(element, value, convert)
    return default if value is None else value
