"""Random numbers: uniform, reproducible, independent between pixels, well spread within one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2, kstest

from jaxdr.transport.sampler import FIRST_DIMENSIONS, lattice, path_numbers, uniform

KEY = jax.random.key(30)


def points(pixels, samples, key=KEY, dtype=jnp.float32, start=0):
    points = lattice(key, pixels, start + jnp.arange(samples), FIRST_DIMENSIONS, dtype)
    return np.asarray(points).reshape(pixels, samples, FIRST_DIMENSIONS)


def test_range_and_shape():
    u = points(100, 16)
    assert u.shape == (100, 16, FIRST_DIMENSIONS) and u.dtype == np.float32
    assert np.all(u >= 0) and np.all(u < 1)
    fresh = np.asarray(uniform(KEY, (50_000,)))
    assert fresh.dtype == np.float32 and np.all(fresh >= 0) and np.all(fresh < 1)
    assert kstest(fresh, "uniform").pvalue > 1e-4


def test_every_sample_is_uniform_over_pixels():
    """The shifts of 20,000 pixels: each dimension of any one sample is uniform, so every estimate is unbiased."""
    u = points(20_000, 3)
    for sample in (0, 2):
        for dimension in range(FIRST_DIMENSIONS):
            assert kstest(u[:, sample, dimension], "uniform").pvalue > 1e-4


def test_pairs_of_dimensions_are_uniform_together():
    """Chi² of one sample over pixels on 8 x 8 cells, for all pairs."""
    u = (points(20_000, 1)[:, 0] * 8).astype(int)
    for i in range(FIRST_DIMENSIONS):
        for j in range(i):
            counts = np.bincount(u[:, i] * 8 + u[:, j], minlength=64)
            assert np.sum((counts - 312.5) ** 2 / 312.5) < chi2.ppf(1 - 1e-5, 63)


def test_reproducible_and_numbered_across_chunks():
    whole = points(10, 8)
    np.testing.assert_array_equal(whole, points(10, 8))
    np.testing.assert_array_equal(whole[:, 5:], points(10, 3, start=5))
    assert np.all(whole != points(10, 8, jax.random.key(31)))
    assert np.all(np.asarray(uniform(KEY, (100,))) == np.asarray(uniform(KEY, (100,))))


def test_the_same_in_both_precisions():
    with jax.enable_x64(True):
        double = points(10, 8, dtype=jnp.float64)
        fresh = np.asarray(uniform(KEY, (100,), jnp.float64))
    assert double.dtype == fresh.dtype == np.float64
    np.testing.assert_array_equal(double, points(10, 8))
    np.testing.assert_array_equal(fresh, np.asarray(uniform(KEY, (100,))))


def test_pixels_are_independent():
    """No correlation between neighbours, and no two pixels share a shift."""
    u = points(20_000, 1)[:, 0]
    centred = u - 0.5
    correlation = 12 * (centred[1:] * centred[:-1]).mean(0)
    assert np.all(np.abs(correlation) < 4 / np.sqrt(20_000))
    assert len(np.unique(u, axis=0)) == 20_000


@pytest.mark.parametrize("samples", [16, 64, 256])
def test_samples_of_a_pixel_are_well_spread(samples):
    """Integrals over one pixel's samples vary less than with independent ones, in every dimension and for pairs."""
    u = points(2000, samples).astype(float)
    share = u.mean(1).std(0) / np.sqrt(1 / 12 / samples)
    assert np.all(share < 0.75) and share.mean() < 0.5, share
    product = 4 * u[..., :-1] * u[..., 1:]  # variance 7/9 for one sample
    share = product.mean(1).std(0) / np.sqrt(7 / 9 / samples)
    assert np.all(share < 0.8) and share.mean() < 0.6, share
    # The estimates are unbiased all the same.
    mean, error = product.mean((0, 1)), product.mean(1).std(0) / np.sqrt(2000)
    assert np.all(np.abs(mean - 1) < 4.5 * error)


def test_samples_of_a_pixel_leave_no_gaps():
    """64 points in one dimension: no gap is wider than five average ones (independent points: ten)."""
    u = np.sort(points(50, 64), axis=1)
    assert np.diff(u, axis=1, append=u[:, :1] + 1).max() < 5 / 64


def test_numbers_of_paths():
    """Uniform in every dimension, in pairs of dimensions, from one path or bounce to the next; a path keeps its own."""
    paths = jnp.arange(40_000)
    first, second = (np.asarray(path_numbers(KEY, paths, bounce)) for bounce in (0, 1))
    assert first.shape == (40_000, 4) and first.dtype == np.float32
    assert np.all(first >= 0) and np.all(first < 1)
    columns = [*first.T, *second.T, *np.roll(first, 1, axis=0).T]
    for i, a in enumerate(columns):
        assert kstest(a, "uniform").pvalue > 1e-4
        for b in columns[:i]:
            counts = np.bincount((a * 8).astype(int) * 8 + (b * 8).astype(int), minlength=64)
            assert np.sum((counts - 625) ** 2 / 625) < chi2.ppf(1 - 1e-6, 63)
    np.testing.assert_array_equal(first[[7, 3000]], path_numbers(KEY, jnp.array([7, 3000]), 0))
    assert np.all(first != np.asarray(path_numbers(jax.random.key(31), paths, 0)))
