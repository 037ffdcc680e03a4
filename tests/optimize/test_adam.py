"""adam_uniform against the published update, written out in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxdr.optimize.adam import adam_uniform


def reference(x, gradients, learning_rate, b1, b2, eps):
    m, n = np.zeros_like(x), np.zeros_like(x)
    for t, g in enumerate(gradients, start=1):
        m = b1 * m + (1 - b1) * g
        n = b2 * n + (1 - b2) * g**2
        x = x - learning_rate(t - 1) * (m / (1 - b1**t)) / (np.sqrt((n / (1 - b2**t)).max()) + eps)
    return x


@pytest.mark.parametrize("schedule", [False, True])
def test_follows_the_published_update(schedule):
    rate = optax.exponential_decay(0.1, 1, 0.5) if schedule else 0.1
    optimizer = adam_uniform(rate, b1=0.8, b2=0.95, eps=1e-6)
    rng = np.random.default_rng(0)
    x = {"a": rng.normal(size=(4, 3)), "b": rng.normal(size=(2,))}
    gradients = [{"a": rng.normal(size=(4, 3)), "b": 100 * rng.normal(size=(2,))} for _ in range(5)]

    y = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), x)
    state = optimizer.init(y)
    step = jax.jit(optimizer.update)
    for g in gradients:
        updates, state = step(jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), g), state)
        y = optax.apply_updates(y, updates)

    for name in x:
        expected = reference(
            x[name], [g[name] for g in gradients], lambda t: 0.1 * 0.5**t if schedule else 0.1, 0.8, 0.95, 1e-6
        )
        np.testing.assert_allclose(y[name], expected, rtol=1e-5)


def test_small_components_stay_small():
    # Plain Adam would move both components by the learning rate.
    optimizer = adam_uniform(1.0)
    gradient = jnp.array([1.0, 1e-3])
    updates, _ = optimizer.update(gradient, optimizer.init(gradient))
    np.testing.assert_allclose(updates, [-1.0, -1e-3], rtol=1e-5)


def test_a_zero_gradient_moves_nothing():
    optimizer = adam_uniform(1.0)
    updates, _ = optimizer.update(jnp.zeros(3), optimizer.init(jnp.zeros(3)))
    np.testing.assert_array_equal(updates, np.zeros(3))


@pytest.mark.parametrize("options", [dict(b1=1.0), dict(b2=-0.1), dict(eps=-1.0)])
def test_rejects_bad_constants(options):
    with pytest.raises(ValueError, match="adam_uniform: need"):
        adam_uniform(0.1, **options)
