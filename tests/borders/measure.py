"""Derivatives and images at borders against what values inside of the range say."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.scene.bsdf.principled import LEAST_COLOR, LEAST_SPECULAR
from tests.borders.registry import Border
from tests.borders.stages import DEPTHS, INTEGRATORS, Program, Stage

# Steps from an end, inwards, as shares of the span: just outside, the end, just inside, and those that the truth is
# taken from. The image is linear in most fields; where it is curved, the truth is a parabola through closer values.
NEAR, STEP = 0.01, 0.25
STEPS = {"outside": -NEAR, "end": 0.0, "inside": NEAR}
INNER = (STEP, 2 * STEP, 3 * STEP)
ROOT_STEP = 0.05  # of a value that stands in for a smaller one
CURVED = {
    **dict.fromkeys(("eta", "exponent", "roughness", "specular", "clearcoat_gloss", "normal"), 0.2),
    **dict.fromkeys(("alpha = 0.0001", "alpha_v = 0.0001"), 8e-5),  # steps of a fifth of it
    **dict.fromkeys(("alpha = 1", "alpha_v = 1"), 0.4),
    "roughness = 0": 0.04,  # the model's least alpha, to .03
    "clearcoat_gloss = 1": 0.008,  # steps of a fifth of the least alpha
    "base_color": 0.2,
    "k": 0.05,
    "anisotropic": 0.05,
    "BumpMap.scale": 0.2,
    "RoughPlastic.eta": 0.02,  # its table of transmittances is linear in pieces
}
PARABOLA = np.array([-2.5, 4.0, -1.5]), np.array([3.0, -3.0, 1.0])  # slope times step, and value, at the end
LINE = np.array([-0.5, 0.0, 0.5]), np.array([4.0, 1.0, -2.0]) / 3.0
# The exact slope at the end is infinite: there is a root. So the model counts these as at least this value.
RAISED = {"Principled.base_color = 0": LEAST_COLOR, "Principled.specular = 0": LEAST_SPECULAR}
FLAT = 0.1  # a slope below this share of image over span counts as this
BIAS = 0.1
SURE = 4.0  # standard errors
UNTOLD = 0.5  # of the bias that has to be told: a larger standard error tells nothing


def places(border: Border) -> np.ndarray:
    """Values of the field, in the order of `STEPS` and then of `INNER`."""
    least = RAISED.get(border.name)
    if least is not None:
        return least * np.array([-NEAR, 0.0, 1.0 + NEAR, *(1.0 + np.arange(1, 4) * ROOT_STEP)])
    steps = np.array([*STEPS.values(), *INNER]) * (_curved(border) or 1.0)
    return border.end + border.inwards * border.span * steps


def _curved(border: Border) -> float | None:
    """The share of the steps to take where the image is curved; None where it is linear in the field."""
    if border.name in RAISED:
        return ROOT_STEP
    end = border.name.partition(".")[2]
    return next((CURVED[n] for n in (f"{border.model}.{border.field}", end, border.field) if n in CURVED), None)


def measured(program: Program, keys: int, spp: int) -> dict[str, dict[str, Any]]:
    """Verdicts of all cells of one program. Where it is refused, the message stands for all of them."""
    stage = program.stage()
    try:
        integrator = INTEGRATORS[program.integrator](DEPTHS[program.integrator])
        values, slopes = sampled(stage, stage.measure(integrator, spp), keys)
    except ValueError as refusal:
        cell = {"verdict": "refused", "why": str(refusal).splitlines()[0]}
        return {f"{border.name}, {place}": cell for border in stage.borders for place in STEPS}
    return cells(stage, values, slopes)


def sampled(stage: Stage, measure: Callable, keys: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives [keys, places, borders]."""
    count = len(stage.borders)
    values = np.stack([places(border) for border in stage.borders], 1).astype(np.float32)
    found = np.zeros((2, keys, len(values), count))
    for k in range(keys):
        key = jax.random.fold_in(jax.random.key(seed), k)
        for v, row in enumerate(values):
            if stage.apart:
                found[:, k, v] = jax.device_get(measure(jnp.asarray(row), jnp.ones(count), key))
                continue
            for i in range(count):
                alone = np.full(count, np.nan, np.float32)
                alone[i] = row[i]
                found[:, k, v, i] = [x[i] for x in jax.device_get(measure(jnp.asarray(alone), jnp.eye(count)[i], key))]
    return found[0], found[1]


def cells(stage: Stage, values: np.ndarray, slopes: np.ndarray) -> dict[str, dict[str, Any]]:
    """Verdicts by border and place; `values` and `slopes` are those of `sampled`."""
    found = {}
    for i, border in enumerate(stage.borders):
        step = places(border)[-1] - places(border)[-2]
        inner = values[:, len(STEPS) :, i]
        slope, value = PARABOLA if _curved(border) else LINE
        truth, limit = inner @ slope / step, inner @ value
        # What the parabola may be off by.
        bend = 0.3 * abs(_mean(truth - (inner[:, 1] - inner[:, 0]) / step)[0]) if _curved(border) else 0.0
        size = abs(_mean(inner[:, 0])[0])
        for p, place in enumerate(STEPS):
            found[f"{border.name}, {place}"] = _cell(
                slopes[:, p, i], truth, values[:, p, i], limit, bend, size, border.span, place
            )
    return found


def _mean(samples: np.ndarray) -> tuple[float, float]:
    """Mean and standard error."""
    return float(samples.mean()), float(samples.std(ddof=1) / math.sqrt(len(samples)))


def _cell(slopes, truth, values, limit, bend: float, size: float, span: float, place: str) -> dict[str, Any]:
    if not np.isfinite([slopes, values]).all():
        return {"verdict": "wrong", "why": "not finite"}
    slope, slope_error = _mean(slopes)
    expected, _ = _mean(truth)
    off, error = _mean(slopes - truth)
    error = max(math.hypot(error, bend), 1e-6 * size / span)
    scale = max(abs(expected), FLAT * size / span)
    image_off, image_error = _mean(values - limit)
    cell = {"slope": slope, "expected": expected, "error": error, "image": image_off / (size or 1.0)}
    jump = abs(image_off) > 0.1 * abs(expected) * span + 0.02 * size + SURE * image_error
    clamped = place == "outside" and abs(slope) <= BIAS * scale + SURE * slope_error  # as at the end from there on
    if jump and place == "end":
        return cell | {"verdict": "wrong", "why": "the image jumps"}
    if abs(off) > BIAS * scale + SURE * error and not clamped:
        return cell | {"verdict": "wrong", "why": "derivative"}
    return cell | {"verdict": "noisy" if error > UNTOLD * BIAS * scale and not clamped else "right"}
