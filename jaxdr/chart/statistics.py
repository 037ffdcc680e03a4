"""Errors of derivatives against a reference that has noise of its own: bias and variance apart; Pareto front."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def errors(
    values: Float[np.ndarray, "P S *shape"], reference: Float[np.ndarray, "..."], noise: float
) -> dict[str, float]:
    """Errors of one call, from P x S independent ones, S at each of P positions within the reference's step.

    All are relative to the root mean square of what the reference estimates: its own `noise` (root mean square of a
    value's standard error) taken off. With g the calls, r the reference, s its noise, mean over all values:

    - `variance`: mean of (g - E g)², unbiased, from calls at the same position;
    - `bias2`: mean of (mean g - r)² minus variance / calls minus s²: unbiased, so it may come out negative;
    - `deviation`, `bias`: their roots; `bias` is 0 where `bias2` is negative, that is, nothing is left to see;
    - `bias_resolution`: root of what was taken off: a bias well below it is not known;
    - `rmse`: √(bias² + variance);
    - `projection`: <mean g, r> / (<r, r> - s²), 1 for the right size; `projection_error`: its standard error, of calls
      and reference (whose values count as independent from pixel to pixel, not from channel to channel).
    - `noise`: s.

    Raises ValueError for fewer than two calls a position, shapes that differ, and a reference that is all noise.
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
        "rmse": math.sqrt((max(bias2, 0.0) + variance) / power),
        "bias": math.sqrt(max(bias2, 0.0) / power),
        "bias2": bias2 / power,
        "bias_resolution": math.sqrt(taken_off / power),
        "deviation": math.sqrt(variance / power),
        "variance": variance / power,
        "projection": float(projections.mean()),
        "projection_error": math.sqrt(spread),
        "noise": noise / math.sqrt(power),
    }


def size2(reference: Float[np.ndarray, "*shape"], noise: float) -> float:
    """Mean square of what a reference estimates. Raises ValueError when it is all noise."""
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
    """Middles of `count` equal parts of [-step, step]; the rest alone without a step.

    A central difference is the mean of the derivative over its step exactly, whatever jumps between: means over these
    are smeared alike.
    """
    return [step * ((2 * k + 1) / count - 1) for k in range(count)] if step > 0 else [0.0]


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Numbers of the (seconds, error) that no other beats in one and equals or beats in the other; by seconds."""
    front, least = [], math.inf
    for number in sorted(range(len(points)), key=lambda i: points[i]):
        if points[number][1] < least:
            front.append(number)
            least = points[number][1]
    return front


def is_resolved(rmse: float, noise: float) -> bool:
    """Whether an error stands out of the band: is larger than the noise of the reference."""
    return rmse > noise
