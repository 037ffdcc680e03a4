"""Forward images against those that Mitsuba 3.9 made of the same files (`experiments.forward_images.run --store`)."""

from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.stats import t

import jaxdr as jd

FOLDER = Path(__file__).parent / "forward_images"
COUNT, SPP = 12, 48


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.npz")))
def test_images_as_mitsuba_made_them(name):
    """z of every pixel and channel, and of the mean colours, over independent images."""
    stored = np.load(FOLDER / f"{name}.npz")
    tracer = jd.PathTracer(max_depth=int(stored["max_depth"]), boundary=None)
    render = jax.jit(lambda scene, key: jd.render(scene, key, SPP, tracer))
    scene = jd.load_mitsuba(FOLDER / f"{name}.xml")
    ours = np.stack([render(scene, key) for key in jax.random.split(jax.random.key(1), COUNT)]).astype(float)
    z = z_scores(ours, stored["mean"].astype(float), stored["error"].astype(float))
    # A pixel's channels are not independent: as many independent z as pixels, at worst.
    pixels, expected = z[..., 0].size, 2 * t.sf(3, COUNT - 1)
    assert np.mean(np.abs(z) > 3) < expected + 4 * np.sqrt(expected / pixels)
    assert abs(z.mean()) < 0.3 and z.std() < 1.3
    colors = stored["colors"].astype(float)
    whole = z_scores(ours.mean((1, 2)), colors.mean(0), colors.std(0, ddof=1) / np.sqrt(len(colors)))
    assert np.abs(whole).max() < 4.5, whole


def z_scores(values, mean, error):
    """Difference of the mean of independent values from a mean with a standard error of its own, in standard errors."""
    rounding = 1e-5 * np.abs(mean) + 1e-7
    return (values.mean(0) - mean) / np.sqrt(values.var(0, ddof=1) / len(values) + error**2 + rounding**2)
