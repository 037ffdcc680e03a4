"""How far the default is from the best, from errors and times that are known."""

import pytest

from jaxdr.chart.default import BUDGETS, error_after, line, seconds_to, times_as_long


def rung(estimator, seconds, deviation, bias2=0.0):
    return {"estimator": estimator, "seconds": seconds, "deviation": deviation, "bias2": bias2, "rmse": 1.0}


def test_without_bias_time_is_variance():
    rows = [rung("default", 0.1, 2.0), rung("better", 0.1, 1.0), rung("slow", 5.0, 0.001)]
    found = times_as_long(rows, "default")
    assert set(found) == set(BUDGETS)
    assert found[0.3] == (pytest.approx(3.0, rel=1e-3), "better")  # one call, a tenth of a second, is enough
    assert found[3.0] == (pytest.approx(4.0, rel=1e-3), "better")
    # The slow method's first call is worth waiting for: it takes five seconds.
    assert found[30.0] == (pytest.approx(6.0, rel=1e-3), "slow")


def test_the_best_has_one():
    rows = [rung("default", 0.1, 1.0), rung("default", 1.0, 0.1), rung("worse", 0.1, 3.0)]
    for ratio, best in times_as_long(rows, "default").values():
        assert ratio == pytest.approx(1.0, rel=1e-3) and best == "default"


def test_a_biased_method_never_gets_there():
    biased = [rung("biased", 0.01, 0.1, bias2=0.25)]
    assert error_after(biased, 100.0) == pytest.approx(0.5, rel=1e-2)
    assert seconds_to(biased, 0.4) is None
    assert seconds_to(biased, 1.0) == pytest.approx(0.01 * max(0.01 / 0.75, 1.0))
    rows = [*biased, rung("default", 1.0, 0.5)]
    assert times_as_long(rows, "default")[30.0][1] == "default"


def test_what_was_not_measured_is_left_out():
    assert times_as_long([rung("other", 1.0, 1.0)], "default") == {}
    refused = {"estimator": "default", "status": "refused", "rmse": None}
    assert times_as_long([refused, rung("other", 1.0, 1.0)], "default") == {}
    assert set(times_as_long([rung("default", 1.0, 1.0)], "default")) == {3.0, 30.0}


def test_the_line_says_it():
    said = line({3.0: (1.25, "LineSampling")})
    assert said.endswith("times as long as the best: 1.2 at 3 s (best: LineSampling)")
