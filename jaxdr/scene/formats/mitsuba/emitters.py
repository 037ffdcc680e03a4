"""Emitter plugins of Mitsuba 3 scene files: those of shapes, and those of the scene."""

from collections.abc import Callable, Collection
from typing import Literal

import numpy as np
from jaxtyping import ArrayLike, Float

from jaxdr.images import load_image
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment, Environment
from jaxdr.scene.environment_map import EnvironmentMap
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.names import object_names, parameter_name
from jaxdr.scene.formats.mitsuba.sensors import field_of_view
from jaxdr.scene.formats.mitsuba.spectra import light_color
from jaxdr.scene.formats.mitsuba.textures import CONSTANTS, color, textured_color
from jaxdr.scene.formats.mitsuba.xml import COLOR, NUMBER, Properties, read_plugin
from jaxdr.scene.lights import DeltaLight, DirectionalLight, PointLight, Projector, SpotLight, TexturedSpotLight
from jaxdr.scene.lights.projector import WRAPS


def _light_color(properties: Properties, name: str) -> ArrayLike:
    properties.ignore("sampling_weight")  # how often the light is chosen: only the noise depends on it
    if properties.tag(name) == "spectrum":
        return properties.value(name, "spectrum", read=light_color)
    return color(properties, name, 1.0)


def _area(element: Element) -> AreaEmitter:
    properties = Properties(element)
    if properties.tag("radiance") is not None:
        return AreaEmitter(_light_color(properties, "radiance"))
    properties.ignore("sampling_weight")
    return AreaEmitter(textured_color(properties, "radiance", 1.0))


def _constant(element: Element) -> ConstantEnvironment:
    return ConstantEnvironment(_light_color(Properties(element), "radiance"))


def _environment_map(element: Element) -> EnvironmentMap:
    properties = Properties(element)
    scale = properties.value("scale", NUMBER, 1.0)
    to_world = properties.value("to_world", "transform", np.eye(4))
    properties.ignore("mis_compensation", "sampling_weight")  # they say how it is sampled
    return EnvironmentMap(_image(properties), to_world, scale)


def _image(properties: Properties, raw: bool = False) -> Float[np.ndarray, "H W 3"]:
    """The image file that `filename` names. Grey becomes RGB, and alpha is dropped."""
    filename = properties.value("filename", "string")
    if filename is None:
        raise ValueError("parameter 'filename' is missing")
    image = load_image(properties.element.find_file(filename), raw=raw)
    return image[..., :3] * np.ones(3, image.dtype)


def _point(element: Element) -> PointLight:
    properties = Properties(element)
    position = _one_of(properties, "position", "point", np.zeros(3), lambda matrix: matrix[:3, 3])
    return PointLight(position, _light_color(properties, "intensity"))


def _directional(element: Element) -> DirectionalLight:
    properties = Properties(element)
    direction = _one_of(properties, "direction", "vector", np.array([0.0, 0.0, 1.0]), lambda matrix: matrix[:3, 2])
    return DirectionalLight(direction, _light_color(properties, "irradiance"))


def _one_of(properties: Properties, name: str, tag: str, default: ArrayLike, of_matrix: Callable) -> ArrayLike:
    """A vector that is given either by its name or by `to_world`."""
    given = properties.value(name, tag)
    matrix = properties.value("to_world", "transform")
    if given is not None and matrix is not None:
        raise ValueError(f"give either {name} or to_world, not both")
    if given is None:
        return default if matrix is None else of_matrix(matrix)
    return given


def _spot(element: Element) -> SpotLight | TexturedSpotLight:
    properties = Properties(element)
    matrix = properties.value("to_world", "transform", np.eye(4))
    intensity = _light_color(properties, "intensity")
    cutoff = properties.value("cutoff_angle", NUMBER, 20.0)
    texture = properties.texture("texture")
    beam = properties.value("beam_width", NUMBER)
    if texture is None:
        return SpotLight(matrix[:3, 3], matrix[:3, 2], intensity, cutoff, beam)
    image, wrap = _projected(texture)
    if wrap != "repeat":
        raise ValueError(f"wrap_mode of a spot's texture must be repeat, got {wrap!r}")
    return TexturedSpotLight(matrix[:3, 3], matrix[:3, 2], image, matrix[:3, 1], intensity, cutoff, beam)


def _projector(element: Element) -> Projector:
    properties = Properties(element)
    matrix = properties.value("to_world", "transform", np.eye(4))
    if not np.allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-3):
        raise ValueError("to_world must not scale or shear")
    view = field_of_view(properties)
    scale = properties.value("scale", NUMBER, 1.0)
    texture = properties.texture("irradiance")
    if texture is None:
        image, wrap = np.ones((1, 1, 3)) * np.asarray(properties.value("irradiance", COLOR, 1.0)), "repeat"
    else:
        image, wrap = _projected(texture)
    return Projector(image, matrix, view["fov"], scale, view["fov_axis"], wrap)


def _projected(texture: Element) -> tuple[Float[np.ndarray, "H W 3"], Literal["clamp", "repeat"]]:
    """(image, wrap mode) of a texture that a light projects. A constant becomes one texel."""
    if texture.type in CONSTANTS:
        constant = read_plugin(texture, CONSTANTS, "it is white")
        return np.ones((1, 1, 3)) * np.asarray(1.0 if constant is None else constant), "repeat"
    return read_plugin(texture, {"bitmap": _bitmap}, "it is white") or (np.ones((1, 1, 3)), "repeat")


def _bitmap(element: Element) -> tuple[Float[np.ndarray, "H W 3"], Literal["clamp", "repeat"]]:
    """(image, wrap mode) of an image file that a light projects."""
    properties = Properties(element)
    properties.ignore("format", "accel")  # they only change the precision
    wrap = properties.value("wrap_mode", "string", "repeat")
    if wrap not in WRAPS:
        raise ValueError(f"wrap_mode of a projected image must be {' or '.join(WRAPS)}, got {wrap!r}")
    if properties.value("filter_type", "string", "bilinear") != "bilinear":
        raise ValueError("filter_type of a projected image must be bilinear")
    return _image(properties, properties.value("raw", "boolean", False)), wrap


SHAPE_EMITTERS: dict[str, Callable[[Element], AreaEmitter]] = {"area": _area}
EMITTERS: dict[str, Callable[[Element], Environment | DeltaLight]] = {
    "constant": _constant,
    "envmap": _environment_map,
    "point": _point,
    "spot": _spot,
    "directional": _directional,
    "projector": _projector,
}


def read_shape_emitter(element: Element | None) -> AreaEmitter | None:
    """The `<emitter>` inside a shape. If it can't be read, it is None, and that is noted as a problem."""
    return None if element is None else read_plugin(element, SHAPE_EMITTERS, "the shape does not glow")


def read_emitters(elements: list[Element], taken: Collection[str]) -> tuple[Environment | None, dict[str, DeltaLight]]:
    """(environment, lights by name) of a scene's `<emitter>`s. Those that can't be read are noted as problems.

    Lights are named as shapes are. `taken` are the names of the shapes.
    """
    environment, lights = None, {}
    for name, element in zip(object_names(elements, taken), elements, strict=True):
        emitter = read_plugin(element, EMITTERS, "it is left out")
        if isinstance(emitter, DeltaLight):
            whole = parameter_name(element, name)
            if whole in taken or whole in lights:
                element.problems.add(element, element.place(f"a second {whole!r}; give one of them another id"))
            lights[whole] = emitter
        elif emitter is not None and environment is not None:
            element.unsupported("a second environment in one <scene>", "the first one counts")
        elif emitter is not None:
            environment = emitter
    return environment, lights
