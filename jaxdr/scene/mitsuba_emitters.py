"""Emitter plugins of Mitsuba 3 scene files: those of a shape, and those of the scene."""

from collections.abc import Callable

import numpy as np
from jaxtyping import ArrayLike

from jaxdr.images import load_image
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment, Environment
from jaxdr.scene.environment_map import EnvironmentMap
from jaxdr.scene.mitsuba_element import Element
from jaxdr.scene.mitsuba_textures import color
from jaxdr.scene.mitsuba_xml import NUMBER, Properties, read_plugin

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


def _environment_map(element: Element) -> EnvironmentMap:
    properties = Properties(element)
    filename = properties.value("filename", "string")
    scale = properties.value("scale", NUMBER, 1.0)
    to_world = properties.value("to_world", "transform", np.eye(4))
    properties.ignore("mis_compensation")  # how it is sampled
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    image = load_image(element.find_file(filename))
    # Grey, RGB, or RGB and alpha.
    return EnvironmentMap(image[..., :3] * np.ones(3, image.dtype), to_world, scale)


SHAPE_EMITTERS: dict[str, Callable[[Element], AreaEmitter]] = {"area": _area}
EMITTERS: dict[str, Callable[[Element], Environment]] = {"constant": _constant, "envmap": _environment_map}


def read_shape_emitter(element: Element | None) -> AreaEmitter | None:
    """The `<emitter>` inside a shape; None where it can't be read, which is noted as a problem."""
    return None if element is None else read_plugin(element, SHAPE_EMITTERS, "the shape does not glow")


def read_emitter(element: Element | None) -> Environment | None:
    """An `<emitter>` of the scene; None where it can't be read, which is noted as a problem."""
    return None if element is None else read_plugin(element, EMITTERS, "it is left out")
