"""Rows that count, beside `jnp.nonzero`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.transport.compaction import rows_where


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("size, fill_value", [(None, 0), (40, 97), (200, 5)])
def test_as_nonzero(share, size, fill_value):
    mask = jax.random.uniform(jax.random.key(0), (97,)) < share
    expected = jnp.nonzero(mask, size=size or 97, fill_value=fill_value)[0]
    np.testing.assert_array_equal(rows_where(mask, size, fill_value), expected)
