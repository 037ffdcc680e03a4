"""Typed values in Mitsuba 3 scene files: numbers, colours, points and transforms."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxdr.scene.camera import look_at
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.number import floats, integer
from jaxdr.scene.formats.mitsuba.spectra import surface_color
from jaxdr.untrusted import LARGEST, shortened


def tangent(normal: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The first of Mitsuba's two tangents to a unit normal (Duff et al. 2017)."""
    x, y, z = normal
    sign = math.copysign(1.0, z)
    a = -1 / (sign + z)
    return np.array([1 + sign * x * x * a, sign * x * y * a, -sign * x])


def _boolean(element: Element) -> bool:
    text = element.attributes["value"].lower()
    if text not in ("true", "false"):
        raise ValueError(f"expected true or false, got {shortened(text)}")
    return text == "true"


def _triple(element: Element, default: float | None = None, extra: tuple[str, ...] = ()) -> Float[np.ndarray, "3"]:
    """Three numbers, from value="x, y, z" (or one number for all) or from x=, y=, z= (missing ones are `default`)."""
    if "value" in element.attributes:
        element.check_attributes((*extra, "value"))
        return np.array(floats(element.attributes["value"], 1, 3)) * np.ones(3)
    element.check_attributes(extra if default is not None else (*extra, "x", "y", "z"), ("x", "y", "z"))
    return np.array([floats(element.attributes[k], 1)[0] if k in element.attributes else default for k in "xyz"])


def _rgb(element: Element) -> Float[np.ndarray, "3"]:
    if element.attributes["value"].startswith("#"):
        raise ValueError("hexadecimal colours are not part of Mitsuba 3 files; give linear RGB, such as 0.2, 0.5, 0.1")
    return np.array(floats(element.attributes["value"], 1, 3)) * np.ones(3)


def _translate(element: Element) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, 3] = _triple(element, 0.0)
    return matrix


def _scale(element: Element) -> Float[np.ndarray, "4 4"]:
    return np.diag([*_triple(element, 1.0), 1.0])


def _rotate(element: Element) -> Float[np.ndarray, "4 4"]:
    """Rotation about an axis by an angle in degrees. An axis whose length is not 1 scales and shears, as in Mitsuba."""
    axis = _triple(element, 0.0, extra=("angle",))
    length = np.linalg.norm(axis)
    if length == 0:
        raise ValueError("the rotation axis must not be zero")
    if abs(length - 1) < 1e-3:
        axis = axis / length
    else:
        element.harmless(
            f"the rotation axis has length {length:.4g}: as in Mitsuba, which does not normalise it, this scales and "
            "shears; give an axis of length 1 for a rotation"
        )
    x, y, z = axis
    angle = math.radians(floats(element.attributes["angle"], 1)[0])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = (
        math.cos(angle) * np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * np.outer(axis, axis)
    )
    return matrix


def _matrix(element: Element) -> Float[np.ndarray, "4 4"]:
    element.check_attributes(("value",))
    values = np.array(floats(element.attributes["value"], 9, 16))
    matrix = np.eye(4)
    size = 3 if len(values) == 9 else 4
    matrix[:size, :size] = values.reshape(size, size)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"the last row of a matrix must be 0 0 0 1, got {matrix[3].tolist()}")
    return matrix


def _lookat(element: Element) -> Float[np.ndarray, "4 4"]:
    """The camera-to-world matrix of a `<lookat>`. Without `up` it takes Mitsuba's up vector."""
    element.check_attributes(("origin", "target"), ("up",))
    origin, target = (np.array(floats(element.attributes[name], 3)) for name in ("origin", "target"))
    up = np.array(floats(element.attributes.get("up", "0 0 0"), 3))
    distance = np.linalg.norm(target - origin)
    if not up.any() and distance > 0:
        up = tangent((target - origin) / distance)
    return np.asarray(look_at(origin, target, up))


TRANSFORMS: dict[str, Callable[[Element], Float[np.ndarray, "4 4"]]] = {
    "translate": _translate,
    "scale": _scale,
    "rotate": _rotate,
    "matrix": _matrix,
    "lookat": _lookat,
}


def _transform(element: Element) -> Float[np.ndarray, "4 4"]:
    """The product of the steps inside. The first step is applied first."""
    matrix = np.eye(4)
    for step in element.children:
        if step.tag not in TRANSFORMS:
            raise step.error(f"unknown transform; known: {', '.join(TRANSFORMS)}")
        with step.located():
            matrix = TRANSFORMS[step.tag](step) @ matrix
            if not (np.abs(matrix) <= LARGEST).all():
                raise ValueError(f"with this step the transform has numbers beyond {LARGEST:g}")
    return matrix


VALUES: dict[str, Callable[[Element], Any]] = {
    "boolean": _boolean,
    "integer": lambda element: integer(element.attributes["value"]),
    "float": lambda element: floats(element.attributes["value"], 1)[0],
    "string": lambda element: element.attributes["value"],
    "point": lambda element: _triple(element, extra=("name",)),
    "vector": lambda element: _triple(element, extra=("name",)),
    "rgb": _rgb,
    "spectrum": surface_color,
    "transform": _transform,
}
