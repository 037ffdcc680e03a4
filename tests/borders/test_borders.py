"""Every parameter at the ends of its range: derivatives and images against what inner values say.

In the default run a few materials under a point light and a sky; all programs with `-m slow`. docs/borders.md is the
table.
"""

import inspect

import equinox as eqx
import numpy as np
import pytest

import jaxdr as jd
from experiments.borders import table
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.principled import LEAST_SPECULAR
from jaxdr.scene.emitters import AreaEmitter, Environment
from jaxdr.scene.ranges import FINITE, Parametric, range_of
from tests.borders.measure import STEPS, SURE, cells, measured, places, sampled
from tests.borders.registry import ARGUMENTS, MODELS, PLACES, Border, borders, made, of_kind
from tests.borders.stages import CORE, INTEGRATORS, PROGRAMS, Stage, lights, surface_borders, surfaces

KINDS = (BSDF, jd.Texture, AreaEmitter, Environment, jd.DeltaLight)


def wrong(found: dict) -> dict:
    return {name: cell for name, cell in found.items() if cell["verdict"] == "wrong"}


def test_every_public_model_is_in_the_matrix():
    """A new model is in it by itself, or needs a row of arguments."""
    covered = {border.model for border in [*surface_borders(), *lights("EnvironmentMap").borders]}
    covered |= {border.model for border in lights("ConstantEnvironment").borders}
    without_own = {"Product"}  # its parameters are those of the textures inside
    assert {name for name in MODELS if issubclass(getattr(jd, name), KINDS)} == covered | without_own
    assert all(inspect.isclass(getattr(jd, name)) for name in ARGUMENTS)


@pytest.mark.parametrize("name", MODELS)
def test_every_field_has_a_border_or_is_a_place(name):
    model = made(name)
    floats = {field for field in model.__dataclass_fields__ if eqx.is_inexact_array(getattr(model, field))}
    open_ended = {field for field in floats if range_of(model, field).open}
    assert floats - open_ended - set(PLACES) == {border.field for border in borders(name)}
    assert all(range_of(model, field) == FINITE for field in floats & set(PLACES))


@pytest.mark.parametrize("name", MODELS)
def test_every_optional_part_is_given(name):
    """Otherwise its border would be missing."""
    model = made(name)
    given = {"specular_reflectance"}
    assert [f for f in model.__dataclass_fields__ if getattr(model, f) is None and f not in given] == []


def test_places_are_where_they_say():
    border = Border("Diffuse", "reflectance", 1.0, -1, 2.0)
    np.testing.assert_allclose(places(border), [1.02, 1.0, 0.98, 0.5, 0.0, -0.5])


def made_up(slope_at_end=3.0, value_at_end=1.0, noise=0.0, outside=3.0, keys=16):
    """The cells of one linear field, value 1 + 3 x, whose end may be wrong."""
    border = Border("Diffuse", "reflectance", 0.0, 1, 1.0)
    rng = np.random.default_rng(3)
    x = places(border)
    values = 1.0 + 3.0 * x + noise * rng.normal(size=(keys, len(x)))
    slopes = 3.0 + 4.0 * noise * rng.normal(size=(keys, len(x)))
    values[:, 1] += value_at_end - 1.0
    slopes[:, 1] += slope_at_end - 3.0
    slopes[:, 0] += outside - 3.0
    return cells(Stage(None, [border], [], [], True), values[..., None], slopes[..., None])


@pytest.mark.parametrize(
    "changed, place, verdict",
    [
        ({}, "end", "right"),
        ({"slope_at_end": 0.0}, "end", "wrong"),
        ({"slope_at_end": 2.0, "noise": 0.05}, "end", "wrong"),
        ({"value_at_end": 1.5}, "end", "wrong"),
        ({"slope_at_end": np.nan}, "end", "wrong"),
        ({"slope_at_end": 0.0}, "inside", "right"),
        ({"outside": 0.0}, "outside", "right"),
        ({"outside": 1.5}, "outside", "wrong"),
        ({"noise": 1.0}, "end", "noisy"),
    ],
)
def test_verdicts(changed, place, verdict):
    assert made_up(**changed)[f"Diffuse.reflectance = 0, {place}"]["verdict"] == verdict


def test_core():
    """No cell is wrong."""
    stage = surfaces("point and sky", CORE)
    found = cells(stage, *sampled(stage, stage.measure(INTEGRATORS["default"](2), 64), 12))
    assert len(found) == len(STEPS) * len(stage.borders)
    assert wrong(found) == {}
    assert sum(cell["verdict"] == "right" for cell in found.values()) > 0.5 * len(found)


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_no_cell_is_wrong(program):
    assert wrong(measured(program, keys=16, spp=64)) == {}


def test_the_page_has_the_numbers_that_are_kept():
    assert table.DOCUMENT.read_text() == table.page()


def test_every_model_derives_from_parametric():
    assert all(issubclass(kind, Parametric) for kind in KINDS)
    assert SURE >= 3 and of_kind(BSDF)


def test_a_root_is_judged_by_the_value_that_stands_in():
    """The image stays as it is below that value; the slope is that at it, not zero."""
    border = Border("Principled", "specular", 0.0, 1, 1.0)
    x = np.maximum(places(border), LEAST_SPECULAR)
    values, slopes = (np.tile(y[:, None], (4, 1, 1)) for y in (np.sqrt(x), 0.5 / np.sqrt(x)))
    for wrong_at, verdict in ((None, "right"), (1, "wrong")):
        if wrong_at is not None:
            slopes[:, wrong_at] = 0.0
        assert cells(Stage(None, [border], [], [], True), values, slopes)[f"{border.name}, end"]["verdict"] == verdict
