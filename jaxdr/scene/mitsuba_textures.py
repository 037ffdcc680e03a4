"""Texture and spectrum plugins of Mitsuba 3 scene files, and the parameters that take them."""

from collections.abc import Callable

import numpy as np
from jaxtyping import ArrayLike

from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_xml import COLOR, NUMBER, Properties, read_plugin


def _uniform(element: Element) -> ArrayLike:
    return Properties(element).value("value", NUMBER, 1.0)


def _d65(element: Element) -> ArrayLike:
    """Daylight, the white of linear sRGB."""
    return Properties(element).value("scale", NUMBER, 1.0)


TEXTURES: dict[str, Callable[[Element], ArrayLike]] = {"uniform": _uniform, "d65": _d65}


def color(properties: Properties, name: str, default: ArrayLike) -> ArrayLike:
    """Take a colour: a number, `<rgb>`, `<spectrum>`, or what a nested texture makes of it."""
    element = properties.texture(name)
    if element is None:
        return properties.value(name, COLOR, default)
    value = read_plugin(element, TEXTURES, f"{name} is {np.asarray(default).tolist()}")
    return default if value is None else value
