"""Rows of tables: on a GPU from several copies, with the same values and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import gather
from jaxdr.geometry.gather import rows_of


@pytest.fixture(params=["cpu", "gpu"])
def kind(request, monkeypatch):
    monkeypatch.setattr(gather, "at_once", lambda cpu, gpu: {"cpu": cpu, "gpu": gpu}[request.param])
    return request.param


@pytest.mark.parametrize("rows, columns, count, corners", [(7, (3,), 9000, 3), (5, (), 5000, 0), (4, (2, 3), 100, 2)])
def test_values_and_derivatives(kind, rows, columns, count, corners):
    key = jax.random.split(jax.random.key(rows), 3)
    table = jax.random.normal(key[0], (rows, *columns))
    # -1 stands for "none" at some callers, which do not use its row.
    index = jax.random.randint(key[1], (count, corners) if corners else (count,), -1, rows)
    found = rows_of(table, index)
    np.testing.assert_array_equal(found, table[index])
    cotangent = jax.random.normal(key[2], found.shape)
    by_rows = jax.vjp(lambda t: rows_of(t, index), table)[1](cotangent)[0]
    expected = np.zeros(table.shape)
    np.add.at(expected, np.asarray(index), np.asarray(cotangent, float))
    np.testing.assert_allclose(by_rows, expected, atol=1e-4 * count**0.5)
    forward = jax.jvp(lambda t: rows_of(t, index), (table,), (table + 1.0,))[1]
    np.testing.assert_array_equal(forward, (table + 1.0)[index])


def test_when_there_are_copies(kind):
    """Where a GPU would wait, and not for tables that are large or looked up a few times."""

    def largest_table(rows, count):
        index = jnp.zeros(count, jnp.int32)
        program = jax.make_jaxpr(lambda t: rows_of(t, index))(jnp.zeros((rows, 3)))
        shapes = [v.aval.shape for equation in program.eqns for v in equation.outvars]
        return max(shape[0] for shape in shapes if shape[1:] == (3,))

    many = 10_000
    assert largest_table(100, many) == (many if kind == "cpu" else max(many, 100 * gather.COPIES))
    assert largest_table(1_000, many) == (many if kind == "cpu" else 1_000 * gather.COPIES)
    assert largest_table(gather.MOST_NUMBERS, 5_000) == 5_000
    assert largest_table(1_000, 8) == 8
