"""Rotations against SciPy, and their derivatives, at zero too."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxdr.geometry.rotation import rotation_matrix


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-4, 0.0, -2e-4), (0.3, -0.2, 0.7), (0.0, 3.0, 0.0)])
def test_rotation_matrix(vector):
    with jax.enable_x64():
        expected = Rotation.from_rotvec(vector).as_matrix()
        vector = jnp.asarray(vector, jnp.float64)
        np.testing.assert_allclose(rotation_matrix(vector), expected, atol=1e-12)
        derivative = jax.jacfwd(rotation_matrix)(vector)
        for k in range(3):
            step = 1e-5 * np.eye(3)[k]
            ahead, behind = (Rotation.from_rotvec(np.asarray(vector) + s * step).as_matrix() for s in (1, -1))
            np.testing.assert_allclose(derivative[..., k], (ahead - behind) / 2e-5, atol=1e-8)
        assert np.isfinite(jax.jacrev(rotation_matrix)(vector)).all()
