"""Keys inside of a rendering: numbers are spread evenly and independent, and all of JAX's functions take the keys."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxdr.transport.keys import fixed_key, inner_key


def numbers(keys, count):
    """Uniform numbers [keys, count]."""
    return np.asarray(jax.vmap(lambda key: jax.random.uniform(key, (count,)))(keys))


def derivations(key):
    """Families of 4096 keys that a program might derive from one."""
    count = jnp.arange(4096)
    return {
        "split": jax.random.split(key, 4096),
        "fold_in": jax.vmap(lambda i: jax.random.fold_in(key, i))(count),
        "split of fold_in": jax.vmap(lambda i: jax.random.split(jax.random.fold_in(key, i))[1])(count),
        "split of split": jax.vmap(lambda key: jax.random.split(key)[0])(jax.random.split(key, 4096)),
    }


@pytest.mark.parametrize("family", ["split", "fold_in", "split of fold_in", "split of split"])
def test_numbers_of_many_keys_are_even_and_independent(family):
    drawn = numbers(derivations(inner_key(jax.random.key(5)))[family], 9)
    for column in drawn.T:  # the same place in every key
        assert stats.kstest(column, "uniform").pvalue > 1e-4
    correlations = np.corrcoef(drawn.T) - np.eye(9)
    assert np.abs(correlations).max() < 5.0 / np.sqrt(len(drawn))
    neighbours = [np.corrcoef(column[1:], column[:-1])[0, 1] for column in drawn.T]
    assert np.abs(neighbours).max() < 5.0 / np.sqrt(len(drawn))


def test_all_bits_of_one_key_are_fair():
    words = np.asarray(jax.random.bits(inner_key(jax.random.key(1)), (1 << 17,), jnp.uint32))
    ones = np.unpackbits(words.view(np.uint8).reshape(-1, 4), axis=1).mean(0)
    assert np.abs(ones - 0.5).max() < 5.0 * 0.5 / np.sqrt(len(words))
    pairs, *_ = np.histogram2d(*(words.reshape(-1, 2).T / 2.0**32), bins=32, range=[[0, 1]] * 2)
    assert stats.chisquare(pairs.ravel()).pvalue > 1e-4


def test_keys_and_purposes_have_numbers_of_their_own():
    key = inner_key(jax.random.key(0))
    found = [key, *jax.random.split(key, 4), *(jax.random.fold_in(key, i) for i in range(4))]
    words = {tuple(np.asarray(jax.random.key_data(k)).tolist()) for k in found}
    bits = {int(jax.random.bits(k)) for k in found}
    assert len(words) == len(bits) == len(found)


def test_any_key_makes_one_and_those_made_here_stay():
    for key in (jax.random.key(7), jax.random.PRNGKey(7), jax.random.key(7, impl="rbg")):
        made = inner_key(key)
        assert jax.random.key_impl(made) == jax.random.key_impl(fixed_key(0))
        assert inner_key(made) is made
    assert jnp.array_equal(jax.random.key_data(fixed_key(3)), jax.random.key_data(fixed_key(3)))


def test_jit_and_vmap_change_no_number():
    keys = jax.vmap(inner_key)(jax.random.split(jax.random.key(2), 3))

    def draw(key):
        a, b = jax.random.split(key)
        return (
            jax.random.bits(a, (5,)),
            jax.random.bits(b, (2, 3), jnp.uint8),
            jax.random.uniform(jax.random.fold_in(a, 3)),
        )

    one_by_one = jax.tree.map(lambda *x: jnp.stack(x), *(draw(key) for key in keys))
    for ours, expected in zip(jax.jit(jax.vmap(draw))(keys), one_by_one, strict=True):
        np.testing.assert_array_equal(ours, expected)


def test_a_key_s_ancestors_are_not_computed_again_in_every_kernel():
    """A chain of twelve derivations: its kernels compute no more than each derivation once."""

    def chain(key):
        for number in range(12):
            key = jax.random.fold_in(jax.random.split(key)[1], number)
        return jax.random.uniform(key, (8,))

    text = jax.jit(chain).lower(inner_key(jax.random.key(0))).compile().as_text()
    assert text.count(" multiply(") < 24 * 40
