"""Where directions beyond rough glass are sampled: the bounds against the density itself."""

import numpy as np
import pytest

import jaxdr as jd
from tests.scene.bsdf.checks import call, random_directions


@pytest.mark.parametrize("bsdf", [jd.RoughDielectric(0.5, 1.5, 1.0), jd.RoughDielectric(0.5, 1.0, 1.33)], ids=str)
def test_rims_of_rough_glass(bsdf):
    """The density beyond is positive within all of them and the horizon, and zero elsewhere."""
    wi, wo = random_directions(40_000, 0), random_directions(40_000, 1)
    beyond = np.asarray(wi[:, 2] * wo[:, 2] < 0)
    density = call(bsdf, "pdf", wi, wo)
    within = beyond.copy()
    for rim in call(bsdf, "rims", wi):
        within &= (rim.axis * np.asarray(wo)).sum(-1) > rim.least
    assert within.sum() > 1000 and (beyond & ~within).sum() > 1000
    np.testing.assert_array_equal((density > 0)[beyond], within[beyond])
    assert np.all(density[~beyond] > 0)


def test_the_density_vanishes_at_the_first():
    """In proportion to how far directions are within it; the second needs no such thing."""
    bsdf = jd.RoughDielectric(0.5, 1.5, 1.0)
    wi = np.array([0.6, 0.0, 0.8])
    for side in (1.0, -1.0):
        least = 1.0 / 1.5
        axis = -side * wi
        excess = np.array([1e-2, 1e-3, 1e-4])
        angle = np.arccos(least + excess)
        wo = np.cos(angle)[:, None] * axis + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0])
        density = call(bsdf, "pdf", np.broadcast_to(side * wi, wo.shape).astype(np.float32), wo.astype(np.float32))
        np.testing.assert_allclose(density / excess, density[-1] / excess[-1], rtol=0.2)
