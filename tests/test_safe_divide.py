"""Guarded divisions: values, and gradients where there is nothing to divide by."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.safe_divide import nonzero, safe_divide
from jaxdr.transport.sampler import sample_cdf

A, B = jnp.asarray([1.0, 2.0, 3.0]), jnp.asarray([2.0, 0.0, -4.0])


def test_values():
    np.testing.assert_array_equal(safe_divide(A, B), [0.5, 2.0, -0.75])
    np.testing.assert_array_equal(safe_divide(A, B, otherwise=7.0), [0.5, 7.0, -0.75])
    np.testing.assert_array_equal(safe_divide(A, B, B > 0, 0.0), [0.5, 0.0, 0.0])
    np.testing.assert_array_equal(nonzero(B), [2.0, 1.0, -4.0])
    assert np.isnan(safe_divide(1.0, jnp.nan, otherwise=0.0))  # what is wrong stays to be seen


def test_gradients_are_finite():
    for otherwise in (None, 0.0):
        by_a, by_b = jax.grad(lambda a, b, o=otherwise: safe_divide(a, b, otherwise=o).sum(), (0, 1))(A, B)
        assert np.isfinite(by_a).all() and np.isfinite(by_b).all()
        np.testing.assert_allclose(by_b[np.array([0, 2])], [-0.25, -3.0 / 16.0])


def test_cumulative_sums():
    """Entries without mass are never drawn; shares and masses lead back to the numbers."""
    cdf = jnp.cumsum(jnp.asarray([0.0, 2.0, 0.0, 1.0]))
    target = jnp.asarray([0.0, 1.5, 2.0, 2.75])
    entry, along, mass = sample_cdf(cdf, target)
    np.testing.assert_array_equal(entry, [1, 1, 3, 3])
    np.testing.assert_allclose(along, [0.0, 0.75, 0.0, 0.75])
    np.testing.assert_allclose(jnp.where(entry > 0, cdf[entry - 1], 0.0) + along * mass, target)
