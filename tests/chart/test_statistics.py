"""Bias, variance and noise of the reference are told apart: against closed forms on synthetic arrays."""

import numpy as np
import pytest

from jaxdr.chart.measure import predicted
from jaxdr.chart.statistics import error_of_mean, errors, is_resolved, mean_and_noise, pareto_front, positions, size2

SHAPE = (12, 12, 3)


def drawn(rng, *, bias, deviation, noise, calls=(4, 4)):
    """Calls with a known bias and spread around a truth of root mean square 1, and a reference with known noise."""
    truth = rng.normal(size=SHAPE)
    truth /= np.sqrt(np.mean(truth**2))
    shift = rng.normal(size=SHAPE)
    shift *= bias / np.sqrt(np.mean(shift**2))
    values = truth + shift + deviation * rng.normal(size=(*calls, *SHAPE))
    return values, truth + noise * rng.normal(size=SHAPE)


def average(**known):
    """Mean of the errors over repetitions, and its standard error."""
    found = [errors(*drawn(np.random.default_rng(seed), **known), known["noise"]) for seed in range(100)]
    stack = {name: np.array([f[name] for f in found]) for name in found[0]}
    return {name: (v.mean(), v.std(ddof=1) / np.sqrt(len(v))) for name, v in stack.items()}


@pytest.mark.parametrize(
    "known",
    [
        {"bias": 0.0, "deviation": 0.5, "noise": 0.3},
        {"bias": 0.2, "deviation": 0.5, "noise": 0.3},
        {"bias": 0.2, "deviation": 0.05, "noise": 0.0},
        {"bias": 0.0, "deviation": 1.5, "noise": 0.1},
    ],
)
def test_bias_variance_and_noise_are_separated(known):
    """`bias2` and `variance` are unbiased: z-tests. The size they are relative to is estimated too: 2 %."""
    found = average(**known)
    for name, expected in (("bias2", known["bias"] ** 2), ("variance", known["deviation"] ** 2)):
        mean, error = found[name]
        assert abs(mean - expected) < 4 * error + 0.02 * expected, name
    assert found["noise"][0] == pytest.approx(known["noise"], rel=0.04)
    assert found["deviation"][0] == pytest.approx(known["deviation"], rel=0.04)
    taken_off = known["deviation"] ** 2 / 16 + known["noise"] ** 2
    assert found["bias_resolution"][0] == pytest.approx(np.sqrt(taken_off), rel=0.04)


@pytest.mark.parametrize("broken", ["noise", "calls"])
def test_the_test_above_can_fail(broken):
    """Without taking off the reference's noise, or the calls' share, the bias is not what it is."""
    known = {"bias": 0.0, "deviation": 0.5, "noise": 0.3}
    if broken == "noise":
        found = [errors(*drawn(np.random.default_rng(s), **known), 0.0)["bias2"] for s in range(20)]
    else:
        found = []
        for seed in range(20):
            values, reference = drawn(np.random.default_rng(seed), **known)
            found.append(np.mean((values.mean((0, 1)) - reference) ** 2) - known["noise"] ** 2)
    assert np.mean(found) > 5 * np.std(found, ddof=1) / np.sqrt(20)


def test_error_of_one_call_is_what_it_is_defined_as():
    """rmse² = mean over calls of (g - r)² minus s², the textbook identity, where the bias shows."""
    values, reference = drawn(np.random.default_rng(3), bias=0.4, deviation=0.3, noise=0.1)
    values = values.reshape(1, 16, *SHAPE)
    found = errors(values, reference, 0.1)
    direct = np.mean((values - reference) ** 2) - 0.1**2
    assert found["rmse"] ** 2 == pytest.approx(direct / (np.mean(reference**2) - 0.1**2), rel=1e-9)


def test_error_of_the_mean_of_calls():
    """Predicted from single calls, and made."""
    values, reference = drawn(np.random.default_rng(5), bias=0.4, deviation=0.3, noise=0.0)
    found = errors(values, reference, 0.0)
    means = values.reshape(-1, 4, *SHAPE).mean(1)
    direct = np.mean((means - reference) ** 2) / np.mean(reference**2)
    assert error_of_mean(found["bias2"], found["variance"], 4.0) ** 2 == pytest.approx(direct, rel=0.02)
    assert error_of_mean(-1.0, 0.09, 9.0) == pytest.approx(0.1)


def test_spread_between_positions_is_no_variance():
    """What changes along the step belongs to the derivative: exact calls have no variance, and their mean no bias."""
    rng = np.random.default_rng(0)
    slope, truth = rng.normal(size=(2, *SHAPE))
    at = np.array(positions(0.5, 4))
    values = np.repeat((truth + at[:, None, None, None] * slope)[:, None], 2, axis=1)
    found = errors(values, truth, 0.0)
    assert found["deviation"] == pytest.approx(0, abs=1e-12) and found["bias"] == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize("scale", [1.0, 0.8])
def test_projection_and_its_error(scale):
    rng = np.random.default_rng(1)
    scores = []
    for _ in range(60):
        truth = rng.normal(size=(16, 16, 1))
        values = scale * truth + 0.5 * rng.normal(size=(2, 4, 16, 16, 1))
        found = errors(values, truth + 0.2 * rng.normal(size=truth.shape), 0.2)
        scores.append((found["projection"] - scale) / found["projection_error"])
    assert abs(np.mean(scores)) < 0.4 and 0.7 < np.std(scores) < 1.3


def test_mean_and_noise_of_batches():
    batches = np.random.default_rng(0).normal(2.0, 0.6, (64, 20, 20, 3))
    mean, noise = mean_and_noise(batches)
    assert noise == pytest.approx(0.6 / 8, rel=0.03)
    assert mean.mean() == pytest.approx(2.0, abs=0.01)


def test_what_can_not_be_judged():
    values, reference = drawn(np.random.default_rng(0), bias=0, deviation=0.1, noise=0)
    with pytest.raises(ValueError, match="all noise"):
        errors(values, reference, 1.5)
    with pytest.raises(ValueError, match="all noise"):
        size2(np.zeros(SHAPE), 0.0)
    with pytest.raises(ValueError, match="2 or more calls"):
        errors(values[:, :1], reference, 0.0)
    with pytest.raises(ValueError, match="shape"):
        errors(values, reference[:5], 0.0)


def test_positions():
    assert positions(0.0, 4) == [0.0]
    np.testing.assert_allclose(positions(0.4, 4), [-0.3, -0.1, 0.1, 0.3])


def test_pareto_front():
    points = [(1.0, 1.0), (2.0, 0.5), (2.0, 0.7), (3.0, 0.6), (4.0, 0.5), (5.0, 0.1)]
    assert pareto_front(points) == [0, 1, 5]
    assert pareto_front(points[::-1]) == [5, 4, 0]
    brute = [
        i for i, (t, e) in enumerate(points) if not any((a <= t and b <= e) and (a < t or b < e) for a, b in points)
    ]
    assert brute == pareto_front(points)
    assert pareto_front([]) == []


def test_inside_the_band():
    assert not is_resolved(0.02, 0.03) and is_resolved(0.04, 0.03)


def test_predicted_seconds():
    assert predicted([], 4) == 0.0
    assert predicted([(4, 1.0)], 16) == 1.0  # no more is known
    assert predicted([(4, 1.0), (16, 2.2)], 64) == pytest.approx(7.0)
    assert predicted([(4, 2.0), (16, 1.0)], 64) == 1.0  # noise of the machine does not make calls faster
