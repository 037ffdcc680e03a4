"""Emitter plugins of Mitsuba 3 scene files: those of a shape, and those of the scene."""

from collections.abc import Callable

import numpy as np
from jaxtyping import ArrayLike

from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_textures import color
from jaxdr.scene.mitsuba_xml import Properties, read_plugin

# Linear sRGB of the spectrum that is 1 everywhere, seen as a light (XYZ = 1, 1, 1). As a reflectance it is plain 1.
EQUAL_ENERGY_LIGHT = np.array([1.204794, 0.948292, 0.908916])


def _radiance(element: Element) -> ArrayLike:
    properties = Properties(element)
    tint = EQUAL_ENERGY_LIGHT if properties.tag("radiance") == "spectrum" else 1.0
    return tint * color(properties, "radiance", 1.0)


def _area(element: Element) -> AreaEmitter:
    return AreaEmitter(_radiance(element))


def _constant(element: Element) -> ConstantEnvironment:
    return ConstantEnvironment(_radiance(element))


SHAPE_EMITTERS: dict[str, Callable[[Element], AreaEmitter]] = {"area": _area}
EMITTERS: dict[str, Callable[[Element], ConstantEnvironment]] = {"constant": _constant}


def read_shape_emitter(element: Element | None) -> AreaEmitter | None:
    """The `<emitter>` inside a shape; None where it can't be read, which is noted as a problem."""
    return None if element is None else read_plugin(element, SHAPE_EMITTERS, "the shape does not glow")


def read_emitter(element: Element | None) -> ConstantEnvironment | None:
    """An `<emitter>` of the scene; None where it can't be read, which is noted as a problem."""
    return None if element is None else read_plugin(element, EMITTERS, "it is left out")
