"""Losses: values, masks, and the unbiasedness of the two-key L2."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxdr.optimize import losses

RNG = np.random.default_rng(0)
A, B, T = (jnp.asarray(RNG.random((4, 5, 3)), jnp.float32) for _ in range(3))


def test_values():
    np.testing.assert_allclose(losses.l1(A, T), np.abs(A - T).mean(), rtol=1e-6)
    np.testing.assert_allclose(losses.l2(A, T), ((A - T) ** 2).mean(), rtol=1e-6)
    np.testing.assert_allclose(losses.two_key_l2(A, B, T), ((A - T) * (B - T)).mean(), rtol=1e-6)


@pytest.mark.parametrize("trailing", [False, True])
def test_masks_weigh_pixels(trailing):
    mask = jnp.zeros((4, 5)).at[1, 2].set(1.0)
    expected = ((A - T) ** 2)[1, 2].sum() / A.size
    np.testing.assert_allclose(losses.l2(A, T, mask[..., None] if trailing else mask), expected, rtol=1e-6)


def test_two_keys_remove_the_bias_of_noise():
    # Noise of variance 1 around the target itself: l2 sees the variance, the product does not.
    noise = jax.random.normal(jax.random.key(0), (2, 100, 100, 3))
    target = jnp.ones((100, 100, 3))
    a, b = target + noise
    assert abs(losses.l2(a, target) - 1) < 0.05
    assert abs(losses.two_key_l2(a, b, target)) < 0.03


def test_gradient_of_the_two_key_loss():
    # d/dx of mean (x a - t)(x b - t)
    gradient = jax.grad(lambda x: losses.two_key_l2(x * A, x * B, T))(2.0)
    np.testing.assert_allclose(gradient, (A * (2 * B - T) + B * (2 * A - T)).mean(), rtol=1e-5)


def test_shapes_must_agree(monkeypatch):
    # As for users, whose calls no type checker guards.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match="they must agree"):
        losses.l1(A, T[:1])
    with pytest.raises(ValueError, match=r"mask has shape \(4,\)"):
        losses.l2(A, T, jnp.ones(4))
