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


LOSSES = {
    "l1": lambda image, target, mask: losses.l1(image, target, mask),
    "l2": lambda image, target, mask: losses.l2(image, target, mask),
    "two_key_l2": lambda image, target, mask: losses.two_key_l2(image, 0.5 * image, target, mask),
}


@pytest.mark.parametrize("what", [jnp.nan, jnp.inf, -jnp.inf, 1e30])
@pytest.mark.parametrize("trailing", [False, True])
@pytest.mark.parametrize("name", LOSSES)
def test_masked_pixels_do_not_count_whatever_is_in_them(name, trailing, what):
    mask = jnp.ones((4, 5)).at[1, 2].set(0.0)
    mask = mask[..., None] if trailing else mask
    loss = jax.value_and_grad(LOSSES[name], argnums=(0, 1, 2))
    value, (by_image, by_target, by_mask) = loss(A, T, mask)
    bad = T.at[1, 2, 0].set(what)
    for arguments in ((A, bad, mask), (bad, A, mask)):
        found, gradients = loss(*arguments)
        assert all(jnp.isfinite(x).all() for x in (found, *gradients[:2]))
        assert (gradients[0][1, 2] == 0).all() and (gradients[1][1, 2] == 0).all()
        if arguments[1] is bad:
            np.testing.assert_allclose(found, value, rtol=1e-6)
            np.testing.assert_allclose(gradients[0], by_image, rtol=1e-6)
            np.testing.assert_allclose(gradients[1], by_target, rtol=1e-6)
    assert by_mask[1, 2] != 0  # the derivative by a mask that is zero


@pytest.mark.parametrize("mask", [None, jnp.full((4, 5), 0.5), jnp.full((4, 5), jnp.nan)])
@pytest.mark.parametrize("name", LOSSES)
def test_what_is_not_finite_shows_elsewhere(name, mask):
    for image, target in ((A, T.at[1, 2, 0].set(jnp.nan)), (A.at[1, 2, 0].set(jnp.nan), T)):
        value, gradient = jax.value_and_grad(LOSSES[name])(image, target, mask)
        assert not jnp.isfinite(value) and (name == "l1" or not jnp.isfinite(gradient[1, 2, 0]))


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
    with pytest.raises(ValueError, match=r"l2: mask must be floats of shape \[H, W, \.\.\.\], or None"):
        losses.l2(A, T, jnp.ones(4))
