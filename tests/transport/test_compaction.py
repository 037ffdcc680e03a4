"""Rows that count, beside `jnp.nonzero`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.transport.compaction import kept_rows, rows_where


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("size, fill_value", [(None, 0), (40, 97), (200, 5)])
def test_as_nonzero(share, size, fill_value):
    mask = jax.random.uniform(jax.random.key(0), (97,)) < share
    expected = jnp.nonzero(mask, size=size or 97, fill_value=fill_value)[0]
    np.testing.assert_array_equal(rows_where(mask, size, fill_value), expected)


def test_all_rows_are_kept_where_there_is_room():
    mask = jax.random.uniform(jax.random.key(0), (97,)) < 0.3
    rows, kept, weight = kept_rows(mask, 50, jax.random.key(1))
    assert kept == mask.sum() and weight == 1.0 and rows.shape == (50,)
    np.testing.assert_array_equal(rows[:kept], jnp.nonzero(mask)[0])


def test_every_row_is_kept_with_the_same_chance():
    """Twenty of 61 rows: each is kept in a share 20 / 61 of the calls, and counts 61 / 20 times."""
    mask = jax.random.permutation(jax.random.key(0), jnp.arange(97)) < 61

    def counts(key):
        rows, kept, weight = kept_rows(mask, 20, key)
        return jnp.zeros(97).at[rows].add(jnp.where(jnp.arange(20) < kept, weight, 0.0))

    calls = 4096
    mean = jax.vmap(counts)(jax.random.split(jax.random.key(1), calls)).mean(0)
    error = (61 / 20 - 1) ** 0.5 / calls**0.5
    np.testing.assert_allclose(mean, mask.astype(float), atol=5 * error)
