"""Programs of a run: one for images of several numbers of samples."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.optimize.phase import in_pieces


def test_images_of_more_samples_are_means_of_one_program():
    traced = []

    def image(mesh, to_world, key, spp):
        traced.append(spp)
        return mesh + to_world + jax.random.normal(key, (4000,)) / jnp.sqrt(spp)

    whole, key = in_pieces(image, (64, 16)), jax.random.key(3)
    found = whole(jnp.ones(4000), 1.0, key, 64)
    few = whole(jnp.ones(4000), 1.0, key, 16)
    assert traced == [16]  # one program
    np.testing.assert_allclose(found.mean(), 2, atol=5 / 8 / np.sqrt(4000))
    np.testing.assert_allclose(found.std(), 1 / 8, rtol=5 / np.sqrt(2 * 4000))  # independent pieces
    np.testing.assert_allclose(few.std(), 1 / 4, rtol=5 / np.sqrt(2 * 4000))


def test_a_number_of_samples_that_is_no_multiple_has_its_own_program():
    traced = []

    def image(mesh, to_world, key, spp):
        traced.append(spp)
        return jnp.full(3, spp)

    whole = in_pieces(image, (64, 48))
    assert (whole(0, 0, jax.random.key(0), 64) == 64).all()
    assert (whole(0, 0, jax.random.key(0), 48) == 48).all()
    assert traced == [64, 48]
