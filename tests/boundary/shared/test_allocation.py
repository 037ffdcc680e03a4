"""Where chords go: expected numbers are kept on average and exactly spread, and every pixel keeps its floor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.boundary.shared.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.shared.blocks import sum_over_blocks

BOUNCES, PIXELS, SAMPLES = 2, 6, 5


def test_expected_numbers_are_kept_on_average():
    expected = jnp.asarray(np.random.default_rng(0).uniform(0, 2, (BOUNCES, PIXELS, SAMPLES)), jnp.float32)
    expected = expected.at[0, 1].set(0.0)
    room = capacity(round(float(expected.sum())), PIXELS)

    def count(key):
        vertex, inverse = allocate(expected, room, key)
        slot = jnp.where(vertex >= 0, vertex, expected.size)
        numbers = jnp.zeros(expected.size).at[slot].add(1.0, mode="drop")
        wrong = jnp.where(vertex >= 0, inverse * expected.reshape(-1)[jnp.maximum(vertex, 0)] - 1, 0.0)
        return numbers, jnp.abs(wrong).max()

    keys = 4000
    numbers, wrong = jax.jit(jax.vmap(count))(jax.random.split(jax.random.key(0), keys))
    assert np.max(wrong) < 1e-5
    flat = np.asarray(expected).reshape(-1)
    deviation = np.sqrt(np.maximum(flat % 1 * (1 - flat % 1), 1e-6) / keys)
    assert np.all(np.abs(numbers.mean(0) - flat) < 5 * deviation + 1e-4)
    assert np.all(np.abs(np.asarray(numbers) - flat) < 1 + 1e-4), "rounded to a neighbouring whole number"
    per_pixel = np.asarray(numbers).reshape(keys, BOUNCES, PIXELS, SAMPLES).sum((1, 3))
    assert np.all(np.abs(per_pixel - np.asarray(expected).sum((0, 2))) < 1 + 1e-3), "a pixel's chords are spread evenly"


def test_shares_add_up():
    importance = jnp.asarray(np.random.default_rng(1).uniform(size=(1, 4, 3)), jnp.float32)
    assert float(shares(importance, 7.5).sum()) == pytest.approx(7.5, rel=1e-5)
    assert not np.any(shares(jnp.zeros((1, 4, 3)), 7.5))


def test_importance_is_high_where_the_pilot_found_something():
    height, width, floor = 9, 11, 0.2
    score = jnp.zeros(height * width).at[4 * width + 5].set(3.0)
    pixel = jnp.arange(height * width)
    found = np.asarray(pixel_importance(score, pixel, jnp.ones(height * width, bool), (height, width), floor))
    found = found.reshape(height, width)
    assert found.argmax() == 4 * width + 5
    assert found[4, 4] > 2 * found[0, 0] > 0, "neighbours share what is found"
    assert found.min() >= 0.99 * floor * (found.mean() / (1 + floor))
    nothing = pixel_importance(jnp.zeros(4), jnp.arange(4), jnp.ones(4, bool), (2, 2), floor)
    np.testing.assert_array_equal(nothing, 1.0)


@pytest.mark.parametrize("used", [0, 1, 7, 40, 50])
def test_blocks_sum_what_is_used(used):
    """Forward and reverse mode, and under vmap."""
    table = jnp.asarray(np.random.default_rng(2).normal(size=(50, 3)), jnp.float32)

    def total(x, used):
        def part(block, number):
            return (jnp.where((number < used)[:, None], block, 0.0) ** 2 * x).sum(0)

        return sum_over_blocks(part, table, used)

    x, count = jnp.asarray([1.0, -2.0, 0.5]), jnp.int32(used)
    exact = (np.asarray(table)[:used] ** 2).sum(0)
    np.testing.assert_allclose(total(x, count), exact * x, rtol=1e-5)
    pushed = jax.jvp(lambda x: total(x, count), (x,), (jnp.ones(3),))[1]
    pulled = jax.grad(lambda x: total(x, count).sum())(x)
    np.testing.assert_allclose(pushed, exact, rtol=1e-5)
    np.testing.assert_allclose(pulled, exact, rtol=1e-5)
    both = jax.vmap(lambda x: total(x, count))(jnp.stack([x, 2 * x]))
    np.testing.assert_allclose(both, np.stack([exact * x, 2 * exact * x]), rtol=1e-5)
