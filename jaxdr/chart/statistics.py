"""Errors of derivatives against a noisy reference, separated into bias and variance; the Pareto front."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def errors(
    values: Float[np.ndarray, "P S *shape"], reference: Float[np.ndarray, "..."], noise: float
) -> dict[str, float]:
    """Errors of one call, from P x S independent ones, S at each of P positions within the reference's step.

    `noise` is the root mean square of the standard errors of the reference's values. All errors are relative to the
    root mean square of what the reference estimates, that is, of the reference without its noise. g are the calls, r is
    the reference, s its noise, and means are over all values:

    - `variance`: mean of (g - E g)², unbiased, from calls at the same position.
    - `bias2`: mean of (mean g - r)² minus variance / calls minus s². It is unbiased, so it may be negative.
    - `deviation`, `bias`: the roots of these two; `bias` is 0 if `bias2` is negative.
    - `bias_resolution`: root of (variance / calls + s²). A bias well below it can't be seen.
    - `rmse`: √(bias² + variance).
    - `projection`: <mean g, r> / (<r, r> - s²), which is 1 for the right size; `projection_error`: its standard error,
      from the calls and the reference. The reference's noise counts as independent between pixels, but not between
      channels.
    - `noise`: s.

    Raises ValueError for fewer than two calls at a position, for shapes that differ, and for a reference that is all
    noise.
    """
    if values.ndim < 3 or values.shape[1] < 2:
        raise ValueError(f"errors: expected [positions, 2 or more calls, ...], got shape {list(values.shape)}")
    if values.shape[2:] != reference.shape:
        raise ValueError(f"errors: the reference has shape {list(reference.shape)}, calls {list(values.shape[2:])}")
    values, reference = values.astype(np.float64), reference.astype(np.float64)
    calls = values.shape[0] * values.shape[1]
    power = size2(reference, noise)
    mean = values.mean((0, 1))
    variance = float(values.var(1, ddof=1).mean())
    taken_off = variance / calls + noise**2
    bias2 = float(np.mean((mean - reference) ** 2)) - taken_off
    axes = tuple(range(2, values.ndim))
    projections = (values * reference).mean(axes) / power
    independent = reference.size / reference.shape[-1]
    spread = float(projections.var(1, ddof=1).mean()) / calls + noise**2 / power / independent
    return {
        "rmse": error_of_mean(bias2, variance, 1.0) / math.sqrt(power),
        "bias": math.sqrt(max(bias2, 0.0) / power),
        "bias2": bias2 / power,
        "bias_resolution": math.sqrt(taken_off / power),
        "deviation": math.sqrt(variance / power),
        "variance": variance / power,
        "projection": float(projections.mean()),
        "projection_error": math.sqrt(spread),
        "noise": noise / math.sqrt(power),
    }


def error_of_mean(bias2: float, variance: float, calls: float) -> float:
    """Root mean square error of the mean of so many independent calls: √(bias² + variance / calls).

    `bias2` and `variance` are those of `errors`; a negative `bias2` counts as 0.
    """
    return math.sqrt(max(bias2, 0.0) + variance / calls)


def size2(reference: Float[np.ndarray, "*shape"], noise: float) -> float:
    """Mean square of what a reference estimates, without its noise. Raises ValueError if it is all noise."""
    power = float(np.mean(np.square(reference, dtype=np.float64))) - noise**2
    if not power > 0:
        raise ValueError(
            f"the reference is all noise: its root mean square is no larger than its noise, {noise:.3g}; "
            "take more samples"
        )
    return power


def mean_and_noise(batches: Float[np.ndarray, "B *shape"]) -> tuple[Float[np.ndarray, "*shape"], float]:
    """Mean of independent batches, and the root mean square of its standard error."""
    batches = batches.astype(np.float64)
    return batches.mean(0), math.sqrt(float(batches.var(0, ddof=1).mean()) / len(batches))


def positions(step: float, count: int) -> list[float]:
    """Midpoints of `count` equal parts of [-step, step]; only 0 if `step` is 0.

    A central difference is exactly the mean of the derivative over [-step, step], even if the derivative jumps there.
    The mean over these positions is smeared in the same way.
    """
    return [step * ((2 * k + 1) / count - 1) for k in range(count)] if step > 0 else [0.0]


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the points (seconds, error) of the Pareto front, by seconds.

    No other point is better in one of the two and at least as good in the other.
    """
    front, least = [], math.inf
    for number in sorted(range(len(points)), key=lambda i: points[i]):
        if points[number][1] < least:
            front.append(number)
            least = points[number][1]
    return front


def is_resolved(rmse: float, noise: float) -> bool:
    """Whether an error is larger than the noise of the reference."""
    return rmse > noise
