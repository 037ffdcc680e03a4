"""Vector algebra."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.geometry.vector import dot


def test_dot_with_one_vector_for_many_rows_is_right_under_jit():
    """XLA's CPU compiler gets rows from 32768 on wrong if `dot` is a sum over an axis (jaxlib 0.10.2)."""
    rng = np.random.default_rng(0)
    vector, scale = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.uniform(1, 2, 36864))
    rows = jnp.asarray(rng.normal(size=(36864, 3)))
    found = jax.jit(lambda v, r, s: dot(v, r) / s)(vector, rows, scale)
    expected = np.asarray(rows, np.float64) @ np.asarray(vector, np.float64) / np.asarray(scale, np.float64)
    np.testing.assert_allclose(found, expected, atol=1e-5)
