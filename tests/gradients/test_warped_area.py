"""The warped-area estimator against exact numbers: a floor point under a polygonal light, a sky, or a lit panel."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients import test_environment_shadow as environment
from tests.gradients.floor_point import BOX, HALF_PLANE, QUADRANGLE, check_derivatives, mean_and_error, sheet
from tests.gradients.test_indirect_shadow import check_under_a_panel

# Wider than the default, for less noise. At a straight boundary one per cent of the velocity is missing.
WARPED, SKY = jd.WarpedArea(sigma0=0.03), jd.WarpedArea(sigma0=0.1)


@pytest.mark.parametrize(
    "blocker",
    [
        pytest.param(sheet(HALF_PLANE, 0.1), id="half plane"),
        pytest.param(sheet(QUADRANGLE, 0.1), id="quadrangle", marks=pytest.mark.slow),
        pytest.param(BOX, id="box", marks=pytest.mark.slow),
    ],
)
def test_every_derivative_is_the_closed_form(blocker):
    """Blocker, light and floor move: apex, occluder and target."""
    check_derivatives(blocker, WARPED, tolerance=0.015)


@pytest.mark.slow
def test_light_from_a_surface():
    """The same derivative where the light is a lit panel: the target of a BSDF-sampled segment."""
    check_under_a_panel(sheet(QUADRANGLE, 0.1), jd.WarpedArea(sigma0=0.1))


@pytest.mark.slow
def test_before_a_sky():
    """Translations of a rectangle before an environment map; what its two sides do nearly cancels."""
    image = environment.sky((16, 32), 5.0)
    of, truth = environment.scene(image), environment.exact(image)
    rows = [environment.derivatives(of, key, SKY, 64) for key in jax.random.split(jax.random.key(0), 16)]
    mean, deviation = mean_and_error(np.stack(rows).astype(float))
    scale = np.abs(truth).max()
    assert deviation.max() < 0.12 * scale
    assert np.all(np.abs(mean - truth) < 0.05 * scale + 4 * deviation), (mean, deviation, truth)
