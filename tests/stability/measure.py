"""Bias and spread of an estimator's derivative images against central differences, and what follows from them."""

import math
import time
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from jaxdr.chart.statistics import errors, positions, size2
from tests.stability.case import Case, integrator

POSITIONS = 8  # within the step of the reference
SURE = 3.0  # standard errors
MOST = 8  # times as many calls as a case asks for
DOUBT = 2.0  # standard errors of a bias below which it may be chance
CLEAR = 6.0  # standard errors of a bias above which it is none, however often one looks
IN_DOUBT = 4  # times as many calls for a bias between the two
ENOUGH = 0.01  # standard error of a projection after which no more calls are made
LONG = 240.0  # seconds after which no more calls are made
UNRESOLVED = 0.15  # standard error of a projection above which nothing is known
BORDER = 1.25  # what a spread estimated by 32 calls may be off by


class Reference(NamedTuple):
    """Derivative image [H, W, 1], and the standard error of every value."""

    image: np.ndarray
    error: np.ndarray

    @property
    def noise(self) -> float:
        """Root mean square of the standard errors."""
        return float(np.sqrt(np.mean(self.error.astype(np.float64) ** 2)))


def _moved(scene, velocities, t):
    parameters = scene.parameters()
    return scene.replace({name: parameters[name] + t * velocity for name, velocity in velocities.items()})


@partial(jax.jit, static_argnames=("method", "spp"))
def _image(scene, velocities, t, key, method, spp):
    return jd.render(_moved(scene, velocities, t), key, spp, method).mean(-1, keepdims=True)


@partial(jax.jit, static_argnames=("method", "spp"))
def _derivative(scene, velocities, t, key, method, spp):
    def image(t):
        return jd.render(_moved(scene, velocities, t), key, spp, method).mean(-1, keepdims=True)

    return jax.jvp(image, (t,), (jnp.ones_like(t),))[1]


def reference(case: Case, seed: int = 1) -> Reference:
    """By central differences with common random numbers, of images that nobody differentiates."""
    method, velocities = jd.PathTracer(case.max_depth, None), case.velocities()
    batches = []
    for number in range(case.batches):
        key = jax.random.fold_in(jax.random.key(seed), number)
        ahead, behind = (
            np.asarray(_image(case.scene, velocities, jnp.float32(t), key, method, case.reference_spp), np.float64)
            for t in (case.step, -case.step)
        )
        batches.append((ahead - behind) / (2 * case.step))
    found = np.stack(batches)
    return Reference(found.mean(0), found.std(0, ddof=1) / math.sqrt(len(found)))


def calls(case: Case, estimator: str, count: int = 0, seed: int = 2) -> np.ndarray:
    """Derivative images [positions, calls, H, W, 1], evenly over the step of the reference.

    Raises ValueError where the estimator does not take the scene, and FloatingPointError for numbers that are not
    finite: JAX's own checks are on.
    """
    method, velocities = integrator(estimator, case.max_depth), case.velocities()
    places = positions(case.step, POSITIONS)
    each = max(2, (count or case.calls) // len(places))
    rows = []
    with jax.debug_nans(True), jax.debug_infs(True):
        for i, t in enumerate(places):
            keys = [jax.random.fold_in(jax.random.key(seed), each * i + k) for k in range(each)]
            rows.append([_derivative(case.scene, velocities, jnp.float32(t), key, method, case.spp) for key in keys])
    return np.asarray(jax.device_get(rows), np.float64)


def compare(values: np.ndarray, against: Reference) -> dict[str, float]:
    """`jaxdr.chart.statistics.errors`, and `bias2_error`: the standard error of the squared bias.

    Of pixel p with difference d_p and variance v_p of it, the variance of d_p² is about 2 v_p² + 4 v_p b_p².
    """
    image = against.image.astype(np.float64)
    found = errors(values, image, against.noise)
    count = values.shape[0] * values.shape[1]
    variance = values.var(1, ddof=1).mean(0) / count + against.error.astype(np.float64) ** 2
    bias2 = np.maximum((values.mean((0, 1)) - image) ** 2 - variance, 0.0)
    spread = np.sqrt(np.sum(2 * variance**2 + 4 * variance * bias2)) / variance.size
    return found | {"bias2_error": float(spread) / size2(image, against.noise)}


def verdict(case: Case, estimator: str, found: dict[str, Any]) -> str:
    """right, biased, noisy (nothing can be said, or more spread than the case allows); or the `status` of a failure."""
    if found["status"] != "ok":
        return found["status"]
    if not math.isfinite(found["deviation"]):
        return "not finite"
    if off(case, found, SURE):
        return "biased"
    return "noisy" if unrest(case, estimator, found) > 1 else "right"


def off(case: Case, found: dict[str, Any], errors: float) -> bool:
    """Whether the bias is above the tolerance by so many standard errors."""
    low = abs(found["projection"] - 1) - errors * found["projection_error"]
    low2 = found["bias2"] - errors * found["bias2_error"]
    return low > case.tolerance or low2 > (2 * case.tolerance) ** 2


def unrest(case: Case, estimator: str, found: dict[str, Any]) -> float:
    """Above 1 the cell is called noisy."""
    return max(found["projection_error"] / UNRESOLVED, found["deviation"] / case.largest_spread(estimator))


def measure(case: Case, estimator: str, against: Reference, most: int = MOST) -> dict[str, Any]:
    """Everything about one cell of the table.

    More calls until they tell enough: up to `most` times as many as the case asks for, and up to `IN_DOUBT` times that
    if a bias is in doubt then. After `LONG` there are no more; then the errors are larger.
    """
    size2(against.image, against.noise)  # a reference that is all noise is no estimator's fault
    values, enough, start = None, most, time.perf_counter()
    try:
        for done in range(1, 1 + IN_DOUBT * most):
            more = calls(case, estimator, seed=1 + done)
            values = more if values is None else np.concatenate([values, more], axis=1)
            found = {"status": "ok"} | compare(values, against) | {"calls": values.shape[0] * values.shape[1]}
            precise = found["projection_error"] < ENOUGH and 2 * SURE * found["bias2_error"] < (2 * case.tolerance) ** 2
            doubtful = off(case, found, DOUBT)
            if done == most and doubtful:  # for good: a single huge value makes the error large, and hides the bias
                enough = IN_DOUBT * most
            told = (precise and not doubtful) or done >= enough
            if told or off(case, found, CLEAR) or time.perf_counter() - start > LONG:
                break
    except ValueError as refusal:
        if "take" not in str(refusal):  # a refusal names a remedy; all else is a fault
            raise
        found = {"status": "refuses", "message": str(refusal).splitlines()[0]}
    except FloatingPointError as problem:
        found = {"status": "not finite", "message": str(problem).splitlines()[0]}
    return found | {"verdict": verdict(case, estimator, found)}
