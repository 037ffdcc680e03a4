"""The warped-area estimator against exact numbers: a floor point under a polygonal light, a sky, or a lit panel."""

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients import test_environment_shadow as environment
from tests.gradients import test_indirect_shadow as indirect
from tests.gradients.floor_point import BOX, HALF_PLANE, QUADRANGLE, estimates, exact, mean_and_error, scene, sheet

# Wider than the default, for less noise.
WIDE, WIDER = jd.WarpedArea(sigma0=0.03), jd.WarpedArea(sigma0=0.1)


@pytest.mark.parametrize(
    ("blocker", "boundary", "spp"),
    [
        pytest.param(sheet(HALF_PLANE, 0.1), WIDER, 32, id="half plane"),
        pytest.param(sheet(HALF_PLANE, 0.1), WIDE, 128, id="half plane, narrow", marks=pytest.mark.slow),
        pytest.param(sheet(QUADRANGLE, 0.1), WIDE, 128, id="quadrangle", marks=pytest.mark.slow),
        pytest.param(BOX, WIDE, 128, id="box", marks=pytest.mark.slow),
    ],
)
def test_every_derivative_is_the_closed_form(blocker, boundary, spp):
    """Blocker, light and floor move: apex, occluder and target. One or two per cent are missing, see `WarpedArea`.

    What the floor's height does is noisier: the point slides three times as far along the camera ray.
    """
    check(estimates(scene(blocker), boundary, keys=8, spp=spp)[1], exact(blocker)[1])


@pytest.mark.slow
def test_light_from_a_surface():
    """The same derivative where the light is a lit panel: the target of a BSDF-sampled segment."""
    blocker = sheet(HALF_PLANE, 0.1)
    check(indirect.estimates(blocker, WIDER, keys=8)[1], exact(blocker)[1])


def check(rows, truth):
    """Errors relative to the largest entry of the blocker's derivative."""
    scale = np.abs(truth["blocker.vertices"]).max()
    for name, found in rows.items():
        true, (mean, deviation) = truth[name] / scale, (x / scale for x in mean_and_error(found))
        assert deviation.max() < (0.15 if name == "floor.height" else 0.04), (name, deviation)
        assert np.all(np.abs(mean - true) < 0.02 + 4 * deviation), (name, mean, deviation, true)


@pytest.mark.slow
def test_before_a_sky():
    """Translations of a rectangle before an environment map; what its two sides do nearly cancels."""
    image = environment.sky((16, 32), 5.0)
    of, truth = environment.scene(image), environment.exact(image)
    rows = [environment.derivatives(of, key, WIDER, 64) for key in jax.random.split(jax.random.key(0), 16)]
    mean, deviation = mean_and_error(np.stack(rows).astype(float))
    scale = np.abs(truth).max()
    assert deviation.max() < 0.12 * scale
    assert np.all(np.abs(mean - truth) < 0.05 * scale + 4 * deviation), (mean, deviation, truth)
