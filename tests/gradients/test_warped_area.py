"""The warped-area estimator against exact numbers: a floor point under a polygonal light or under a lit panel."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients import test_environment_shadow as environment
from tests.gradients.floor_point import BOX, HALF_PLANE, LIGHT, QUADRANGLE, check_derivatives, sheet
from tests.gradients.test_indirect_shadow import check_under_a_panel

# Wider than the default, for less noise; as for every kernel here, what is left of it is measured against the noise.
WARPED = jd.WarpedArea(sigma0=0.03)


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
    check_derivatives(blocker, WARPED)
