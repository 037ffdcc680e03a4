"""What a narrow lobe sees, and how it moves: derivatives of one point's radiance against their closed form."""

import pytest

import jaxdr as jd
from tests.gradients.lobe_point import CASES, check


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_derivative_is_the_closed_form(case):
    """A black roof before a sky, its two sides in the light of a lamp (with the crease between), a lamp."""
    check(case, jd.LineSampling(), depth=3, keys=32, spp=32)
