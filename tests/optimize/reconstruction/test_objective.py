"""Losses of a reconstruction: values, robustness, noise, priors."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxdr.images import from_srgb
from jaxdr.optimize.reconstruction.config import Priors
from jaxdr.optimize.reconstruction.objective import (
    DARK,
    OUTLIER,
    Expected,
    Photograph,
    huber,
    picture_loss,
    prior_loss,
    tone_weight,
)
from jaxdr.optimize.reconstruction.sky import solid_angles
from jaxdr.optimize.reconstruction.unknowns import Unknowns
from jaxdr.views.rendering import Layers

STILL = jnp.zeros(3)


def layers(color, alpha, behind=0.0) -> Layers:
    """Parts of a picture whose object, over black, has a colour."""
    shape = (4, 5, 3)
    behind = jnp.full(shape, behind)
    alpha = jnp.full(shape[:2], alpha)
    return Layers(jnp.full(shape, color) + (1 - alpha)[..., None] * behind, alpha, behind)


def photograph(color, alpha=1.0, trust=1.0) -> Photograph:
    alpha = None if alpha is None else jnp.full((4, 5), alpha)
    return Photograph(jnp.full((4, 5, 3), color), alpha, jnp.full((4, 5), trust), jnp.int32(0), jnp.ones((4, 5)))


def test_small_differences_count_as_encoded_ones_and_what_is_behind_does_not():
    near = from_srgb(np.full(3, 0.5))[0]
    other = from_srgb(np.full(3, 0.51))[0]
    for behind in (0.0, 0.7):
        loss = picture_loss(layers(other, 1.0, behind), STILL, photograph(near), 0.0)
        np.testing.assert_allclose(loss, 0.01**2, rtol=0.03)
        half = picture_loss(layers(0.5 * near, 0.5, behind), STILL, photograph(0.5 * near, 0.5), 1.0)
        np.testing.assert_allclose(half, 0.0, atol=1e-10)


def test_coverage_counts_by_its_weight():
    loss = picture_loss(layers(0.2, 0.75), STILL, photograph(0.2, 1.0), 2.0)
    np.testing.assert_allclose(loss, 2 * 0.25**2, rtol=1e-5)
    # Without a mask the whole picture counts, and coverage does not.
    loss = picture_loss(layers(0.0, 0.5, 0.4), STILL, photograph(0.2, None), 2.0)
    np.testing.assert_allclose(loss, 0.0, atol=1e-10)


def test_colours_that_nobody_knows_do_not_count_even_if_they_are_not_numbers():
    known = photograph(0.2)
    trust = known.trust.at[1, 2].set(0.0)
    bad = known.color.at[1, 2].set(jnp.nan)

    def loss(color, full):
        return picture_loss(layers(0.5, 1.0)._replace(full=full), STILL, known._replace(color=color, trust=trust), 1.0)

    full = layers(0.5, 1.0).full
    expected = loss(known.color, full)
    for arguments in ((bad, full), (known.color, full.at[1, 2].set(jnp.nan))):
        value, gradients = jax.value_and_grad(loss, argnums=(0, 1))(*arguments)
        np.testing.assert_allclose(value, expected, rtol=1e-6)
        assert all(jnp.isfinite(gradient).all() for gradient in gradients)
    assert jnp.isnan(loss(known.color.at[0, 0].set(jnp.nan), full)) and jnp.isnan(loss(known.color, full * jnp.nan))


def test_colours_that_nobody_knows_do_not_count():
    assert picture_loss(layers(0.5, 1.0), STILL, photograph(0.2, trust=0.0), 1.0) == 0


def test_where_a_photograph_is_clipped_the_rendering_may_be_brighter():
    assert picture_loss(layers(3.0, 1.0), STILL, photograph(1.0), 0.0) == 0
    assert picture_loss(layers(0.9, 1.0), STILL, photograph(1.0), 0.0) > 0


def test_outliers_count_by_their_size_and_exposure_scales_the_rendering():
    np.testing.assert_allclose(huber(jnp.array([-1.0, 0.1]), OUTLIER), [2 * OUTLIER - OUTLIER**2, 0.01], rtol=1e-5)
    loss = picture_loss(layers(0.1, 1.0), jnp.full(3, jnp.log(2.0)), photograph(0.2), 0.0)
    np.testing.assert_allclose(loss, 0.0, atol=1e-10)


def test_noise_does_not_move_the_minimum():
    # Mean gradient by a common factor on noisy renderings: zero where their mean is the photograph. A loss of encoded
    # values would be pulled away by several per cent.
    color, spread = 0.2, 0.1
    noise = jax.random.normal(jax.random.key(0), (2000, 4, 5, 3))
    shown = color + spread * noise / tone_weight(jnp.float32(color))

    def mean_loss(factor):
        def one(image):
            return picture_loss(
                Layers(factor * image, jnp.ones((4, 5)), jnp.zeros((4, 5, 3))), STILL, photograph(color), 0.0
            )

        # Of independent factors: the derivative of another picture.
        return jax.vmap(one)(shown).mean()

    def unbiased(factor):
        def one(image, other):
            cotangent = jax.grad(
                lambda full: picture_loss(
                    Layers(full, jnp.ones((4, 5)), jnp.zeros((4, 5, 3))), STILL, photograph(color), 0.0
                )
            )(factor * image)
            return (cotangent * other).sum()

        return jax.vmap(one)(shown, jnp.roll(shown, 1, axis=0)).mean()

    shared, independent = float(jax.grad(mean_loss)(1.0)), float(unbiased(1.0))
    curvature = 2 * (color * float(tone_weight(jnp.float32(color)))) ** 2
    # Huber's ends cost little; the same picture in both factors costs spread² / (color slope)².
    assert abs(independent) < 0.02 * curvature
    assert shared > 0.03 * curvature


def expected(weight=0.0, radiance=1.0, clipped=0.0) -> Expected:
    pairs = jnp.asarray([[0, 1], [1, 2]], jnp.int32)
    full = jnp.ones((3, 4))
    return Expected(
        pairs,
        jnp.asarray(solid_angles(3), float),
        jnp.full((3, 4, 3), radiance),
        weight * full,
        clipped * full,
    )


def unknowns(**changes) -> Unknowns:
    values = {
        "vertices": jnp.zeros((3, 3)),
        "albedo": jnp.zeros((3, 3)),
        "roughness": jnp.zeros((3, 1)),
        "light": jnp.zeros((3, 4, 3)),
        "exposure": jnp.zeros((2, 3)),
        "cameras": jnp.zeros((2, 6)),
    }
    return Unknowns(**(values | changes))


def test_every_prior_is_zero_where_it_should_and_only_its_own_weight_counts():
    alone = dict.fromkeys(("mask", "albedo", "light", "white", "background", "cameras"), 0.0)
    breaking = {
        "albedo": (unknowns(albedo=jnp.arange(9.0).reshape(3, 3)), expected()),
        "light": (unknowns(light=jnp.arange(12.0).reshape(3, 4, 1) * jnp.ones(3)), expected()),
        "white": (unknowns(light=jnp.zeros((3, 4, 3)).at[..., 0].set(1.0)), expected()),
        "background": (unknowns(light=jnp.ones((3, 4, 3))), expected(weight=1.0)),
        "cameras": (unknowns(cameras=jnp.ones((2, 6))), expected()),
    }
    for name, (values, known) in breaking.items():
        weights = Priors(**(alone | {name: 1.0}))
        assert prior_loss(values, known, weights) > 0.01, name
        assert prior_loss(values, known, dataclasses.replace(weights, **{name: 0.0})) == 0
        np.testing.assert_allclose(prior_loss(unknowns(), expected(weight=1.0), weights), 0, atol=1e-10)


def test_a_clipped_background_is_a_lower_bound():
    only = Priors(0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    clipped = expected(weight=1.0, clipped=1.0)
    np.testing.assert_allclose(prior_loss(unknowns(light=jnp.ones((3, 4, 3))), clipped, only), 0)
    assert prior_loss(unknowns(light=-jnp.ones((3, 4, 3))), clipped, only) > 0.01


def test_dark_pixels_weigh_no_more_than_those_at_the_limit():
    assert tone_weight(jnp.float32(0.0)) == tone_weight(jnp.float32(DARK))
