"""A scene as a notebook shows it: tables of shapes, lights and parameters. Nothing is rendered."""

from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from jaxdr.html_summary import folded, summary, table
from jaxdr.scene.bsdf import TwoSided

MOST_VALUES = 10_000_000  # of a parameter whose lowest and highest value are looked for


def scene_html(scene: Any, parameters: dict[str, Any]) -> str:
    """Tables of a `Scene` and its parameters by name, as HTML.

    Also of a scene in a traced function, and of one without some leaves or with other things in their place, as
    gradients have them: what is not known is left empty.
    """
    shapes = [
        (name, kind(shape.bsdf), rows_of(shape.mesh.faces), rows_of(shape.mesh.vertices), kind(shape.emitter))
        for name, shape in scene.shapes.items()
    ]
    around = [("camera", kind(scene.camera), film_of(scene.camera))]
    around.append(("environment", kind(scene.environment) or "none", ""))
    around += [(name, kind(light), "light without area") for name, light in scene.lights.items()]
    around += [(name, "tie", ", ".join(members)) for name, members in scene.tied]
    arrays = {name: value for name, value in parameters.items() if hasattr(value, "shape")}
    rows = [(name, list(value.shape), value.dtype, values(value)) for name, value in arrays.items()]
    return summary(
        "jaxdr.Scene",
        table(("shape", "BSDF", "faces", "vertices", "emitter"), shapes),
        table(("id", "kind", ""), around),
        folded(f"{len(rows)} parameters", table(("name", "shape", "dtype", "values"), rows)),
    )


def kind(model: Any) -> str:
    """The class of a model; nothing for None."""
    if isinstance(model, TwoSided):
        return f"TwoSided({kind(model.bsdf)})"
    return "" if model is None else type(model).__name__


def rows_of(array: Any) -> str:
    """How many rows an array has."""
    shape = getattr(array, "shape", ())
    return f"{shape[0]:,}" if shape else ""


def film_of(camera: Any) -> str:
    """Width, height and filter of a camera's film."""
    film = camera.film
    crop = "" if film.crop is None else f", crop {film.crop}"
    return f"{film.width} x {film.height} pixels, {kind(film.filter)}{crop}"


def values(array: Any) -> str:
    """The value of a number, or the lowest and the highest one; nothing for those of many."""
    if isinstance(array, Tracer):
        return "traced"
    if not isinstance(array, jax.Array | np.ndarray) or not 0 < array.size <= MOST_VALUES:
        return ""
    found = np.asarray(array)
    low, high = float(found.min()), float(found.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
