"""Signal to noise of gradients against what was put into them."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.optimize.signal import signal_to_noise


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
