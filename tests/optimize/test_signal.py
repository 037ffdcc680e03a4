"""Signal to noise of gradients against what was put into them."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize.signal import no_signal, signal_to_noise


def test_ratio_of_known_signal_and_noise():
    rng = np.random.default_rng(0)
    for ratio in (0.25, 1.0, 9.0):
        signal = rng.normal(size=(1000, 3)) * ratio**0.5  # power over that of the noise
        a, b = (jnp.asarray(signal + rng.normal(size=signal.shape)) for _ in range(2))
        assert signal_to_noise(a, b) == pytest.approx(ratio, rel=0.15)


def test_noise_alone_and_opposites():
    a, b = np.random.default_rng(1).normal(size=(2, 1000, 3))
    assert abs(signal_to_noise(jnp.asarray(a), jnp.asarray(b))) < 0.1
    assert signal_to_noise(jnp.asarray(a), jnp.asarray(-a)) == pytest.approx(-0.5)
    assert signal_to_noise(jnp.asarray(a), jnp.asarray(a)) == np.inf


def test_rounds_compare_means_over_all_views():
    one, other = jnp.full((4, 3), 1.0), jnp.full((4, 3), 3.0)
    signal, ratio = no_signal(one).observed(one, 1).observed(other, 3).closed()
    assert ratio is None and int(signal.views) == 0  # the first round has none before it
    np.testing.assert_allclose(signal.previous, 2.5)  # a mean over views, not over steps
    _, ratio = signal.observed(one, 2).closed()
    assert ratio == pytest.approx(signal_to_noise(jnp.full((4, 3), 2.5), one))
