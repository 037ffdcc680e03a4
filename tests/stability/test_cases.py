"""Every estimator on every case: bias and spread against central differences. Tables: docs/stability_cases.md.

In the default run a few cells that share one compiled program; all of them with `-m slow`.
"""

import dataclasses
import math
import re
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.stability import catalogue as kept
from tests.stability.case import COLUMNS, ESTIMATORS, Case, integrator
from tests.stability.elsewhere import ELSEWHERE
from tests.stability.measure import BORDER, CLEAR, SURE, Reference, compare, measure, off, reference, unrest, verdict

ROOT = Path(__file__).parents[2]
CASES = kept.catalogue()
SHARED = (
    "shadow",
    "tiny_light",
    "soft_light",
    "sharp_corner",
    "contact",
    "slivers",
    "emitter_at_wall",
    "image_border",
)


def known(case: Case, estimator: str) -> str:
    """The verdict that a cell is expected to have: right, where the case does not say otherwise."""
    return case.expected[estimator].verdict if estimator in case.expected else "right"


def against(case: Case) -> Reference:
    """The kept reference, if it is of the very scene; else a new one."""
    return kept.stored(case) or reference(case)


def check(case: Case, estimator: str, found: dict) -> None:
    """Size, bias and spread."""
    assert found["status"] == "ok", found
    assert abs(found["projection"] - 1) < case.tolerance + SURE * found["projection_error"], found
    assert found["bias2"] < (2 * case.tolerance) ** 2 + SURE * found["bias2_error"], found
    assert found["deviation"] < case.largest_spread(estimator), found
    assert found["verdict"] == "right", found


@pytest.mark.slow
def test_values_of_one_program():
    """Light, size, place and shape differ; the program does not."""
    assert len({kept.structure(CASES[name]) for name in SHARED}) == 1
    for name in SHARED:
        against = kept.stored(CASES[name])
        assert against is not None, f"{name}: no reference of this scene is kept; run experiments.stability.run"
        check(CASES[name], "LineSampling", measure(CASES[name], "LineSampling", against, most=2))


def cells() -> list:
    """All that can be measured."""
    return [
        pytest.param(case.name, estimator, id=f"{case.name}, {estimator}", marks=pytest.mark.slow)
        for case in CASES.values()
        for estimator in case.estimators()
        if known(case, estimator) != "refuses"
    ]


@pytest.mark.filterwarnings("ignore::jaxdr.EstimatorWarning")  # some cells are there to show what it says
@pytest.mark.parametrize(("name", "estimator"), cells())
def test_cell(name, estimator):
    """What the table says, right or wrong, and how much: a cell that was never measured is nothing to go by."""
    case = CASES[name]
    table = kept.measured(case).get(estimator)
    if table is None:
        pytest.skip(f"not measured yet: python -m experiments.stability.run --case {name}")
    found = measure(case, estimator, against(case))
    tolerance = case.tolerance
    if found["verdict"] == table["verdict"]:
        if table["verdict"] == "right":
            check(case, estimator, found)
    # Another computer, other calls: what is near the limit may end on the other side of it.
    elif {found["verdict"], table["verdict"]} == {"right", "noisy"}:
        for cell in (found, table):
            assert 1 / BORDER < unrest(case, estimator, cell) < BORDER, (found, table)
    else:
        assert {found["status"], table["status"]} == {"ok"}, (found, table)
        assert not any(off(case, cell, CLEAR) for cell in (found, table)), (found, table)
        error2 = math.hypot(found["bias2_error"], table["bias2_error"])
        assert abs(found["bias2"] - table["bias2"]) < SURE * error2, (found, table)
        tolerance = 0.0
    if table["status"] == "ok":
        error = math.hypot(found["projection_error"], table["projection_error"])
        assert abs(found["projection"] - table["projection"]) < tolerance + SURE * error, (found, table)


@pytest.mark.parametrize("name", [name for name, case in CASES.items() if isinstance(case.made, jd.Scene)])
def test_what_is_wrong_has_a_reason(name):
    """Every measured cell has the verdict that its case names with a reason; what is right is not called wrong."""
    case = CASES[name]
    for estimator, cell in kept.measured(case).items():
        assert cell["verdict"] == known(case, estimator), (estimator, cell)


def refusals() -> list:
    """One case for every program that is refused."""
    found = {}
    for case in CASES.values():
        for estimator in case.estimators():
            if known(case, estimator) == "refuses":
                found.setdefault((estimator, case.expected[estimator].why, case.max_depth), case.name)
    return [pytest.param(name, estimator, id=f"{name}, {estimator}") for (estimator, *_), name in found.items()]


@pytest.mark.parametrize(("name", "estimator"), refusals())
def test_what_is_not_covered_is_refused(name, estimator):
    """Before anything is compiled, and with a remedy."""
    case = CASES[name]
    method = integrator(estimator, case.max_depth)
    with pytest.raises(ValueError, match=case.expected[estimator].why) as refusal:
        jax.eval_shape(lambda scene: _derivative(case, scene, method), case.scene)
    assert "take" in str(refusal.value), refusal.value


@pytest.mark.filterwarnings("ignore::jaxdr.EstimatorWarning")
@pytest.mark.parametrize("estimator", CASES["open_non_manifold"].estimators())
def test_edges_of_three_faces(estimator):
    """Every estimator takes them. (The slow cells say that the derivative is right.)"""
    case = CASES["open_non_manifold"]
    method = integrator(estimator, case.max_depth)
    assert jax.eval_shape(lambda scene: _derivative(case, scene, method), case.scene).shape[-1] == 3


def _derivative(case: Case, scene: jd.Scene, method):
    parameters = {name: scene.parameters()[name] for name in case.moves}

    def image(values):
        return jd.render(scene.replace(values), jax.random.key(0), 1, method)

    return jax.jvp(image, (parameters,), (case.velocities(),))[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_kept_references(name):
    """Made again with other random numbers they are the same, within their noise.

    With as many batches: a rare sample is missing in the standard errors that fewer tell. The squared differences are
    compared with their mean and its standard deviation: in some cases a dozen pixels have most of the noise.
    """
    case, one = CASES[name], kept.stored(CASES[name])
    if one is None:
        pytest.skip("none is kept of this scene")
    two = reference(case, seed=100)
    variances = one.error.astype(np.float64) ** 2, two.error.astype(np.float64) ** 2
    expected = sum(variances)
    of_errors = sum(variance**2 for variance in variances) / (case.batches - 1)  # half the variance of a variance
    spread = np.sqrt(np.sum(2 * expected**2 + 2 * of_errors)) / np.sum(expected)
    chi2 = np.sum((one.image - two.image) ** 2) / np.sum(expected)
    assert chi2 < 1 + SURE * spread, (chi2, spread)


def test_thirty_cases_all_estimators():
    assert len(CASES) >= 30
    assert all(set(case.only or COLUMNS) >= {"KernelDensity", "LineSampling"} for case in CASES.values())
    assert set(COLUMNS) < set(ESTIMATORS)
    assert all(case.about and case.source for case in CASES.values())


def test_numbers_that_the_documentation_has():
    """Cells that are right, of those that are not refused."""
    verdicts = {name: [] for name in COLUMNS}
    for case in CASES.values():
        for name, cell in kept.measured(case).items():
            if name in verdicts and cell["verdict"] != "refuses":
                verdicts[name].append(cell["verdict"])
    counts = {name: f"{found.count('right')} of {len(found)}" for name, found in verdicts.items()}
    rows = re.findall(r"^\| `(\w+)` \| (\d+ of \d+)", (ROOT / "docs" / "measured.md").read_text(), re.MULTILINE)
    assert dict(rows) == counts


@pytest.mark.parametrize("row", ELSEWHERE, ids=lambda row: row[0])
def test_what_the_table_cites_is_there(row):
    file, _, name = row[2].partition("::")
    assert f"\ndef {name}(" in (ROOT / file).read_text()


def made_up(scale: float, noise: float, seed=0):
    """Calls of an estimator that is `scale` times right, and a reference; half the image is empty."""
    rng = np.random.default_rng(seed)
    truth = np.where(np.arange(16)[:, None, None] < 8, rng.normal(size=(16, 16, 1)), 0.0)
    error = np.full_like(truth, 0.01)
    values = scale * truth + noise * rng.normal(size=(8, 4, *truth.shape))
    return values, Reference(truth + error * rng.normal(size=truth.shape), error)


@pytest.mark.parametrize(
    ("scale", "noise", "expected"),
    [(1.0, 0.3, "right"), (1.02, 0.1, "right"), (0.85, 0.3, "biased"), (1.3, 1.0, "biased"), (1.0, 20.0, "noisy")],
)
def test_verdicts(scale, noise, expected):
    case = CASES["shadow"]
    assert verdict(case, "KernelDensity", {"status": "ok"} | compare(*made_up(scale, noise))) == expected


def test_a_bias_that_projections_do_not_show():
    """A derivative in the wrong place, of the right size."""
    values, against = made_up(1.0, 0.1)
    values[:, :, 8:] += 0.3 * np.random.default_rng(5).normal(size=values[0, 0, 8:].shape)
    found = {"status": "ok"} | compare(values, against)
    assert abs(found["projection"] - 1) < 0.01
    assert verdict(CASES["shadow"], "KernelDensity", found) == "biased"


def test_error_of_the_squared_bias():
    """It is the standard deviation over repetitions."""
    found = [compare(*made_up(0.9, 0.5, seed)) for seed in range(200)]
    bias2 = np.array([row["bias2"] for row in found])
    error = np.mean([row["bias2_error"] for row in found])
    assert abs(bias2.mean() - 0.01) < 4 * bias2.std() / math.sqrt(len(bias2))
    assert 0.7 < error / bias2.std() < 1.5


def test_kept_references_know_their_scene():
    case = CASES["shadow"]
    moved = dataclasses.replace(case, made=case.scene.replace({"lamp.emitter.radiance": np.array([1.0, 2.0, 3.0])}))
    assert case.digest() != moved.digest() != dataclasses.replace(moved, step=0.5).digest()
    assert kept.stored(case) is not None
    assert kept.stored(moved) is None


def test_numbers_that_are_not_finite_are_named(monkeypatch):
    """JAX's own checks are on while cells are measured."""

    def broken(scene, *rest):
        return scene.shapes["blocker"].mesh.vertices / jax.numpy.zeros(())

    monkeypatch.setattr(jd, "render", broken)
    case = dataclasses.replace(CASES["shadow"], spp=3)  # a program of its own
    found = measure(case, "KernelDensity", against(case))
    assert found["verdict"] == "not finite", found
