"""`jaxdr.jit`: as `jax.jit`, with XLA's options where it has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import compilation


@pytest.fixture
def options(monkeypatch):
    """What is found out about XLA is found out anew, before and after."""
    compilation.compiler_options.cache_clear()
    yield monkeypatch
    compilation.compiler_options.cache_clear()


def test_static_arguments_and_derivatives_inside():
    def slope(x, n):
        return jax.grad(lambda x: (x**n).sum())(x)

    found = jd.jit(slope, static_argnums=1)(jnp.arange(3.0), 3)
    np.testing.assert_allclose(found, [0.0, 3.0, 12.0])


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="options are the CPU's")
def test_this_version_of_xla_knows_the_options():
    known = compilation.compiler_options("cpu")
    if jax.__version_info__ < (0, 11):
        assert known == compilation.CPU_OPTIONS
    else:
        assert list(known) == ["xla_cpu_experimental_ynn_fusion_type"]


def test_no_options_elsewhere():
    assert compilation.compiler_options("gpu") is None


def test_a_version_that_does_not_know_them(options):
    known = dict([list(compilation.CPU_OPTIONS.items())[-1]])  # all versions know the last one
    options.setattr(compilation, "CPU_OPTIONS", {"xla_cpu_no_such_option": True})
    assert compilation.compiler_options("cpu") is None
    assert jd.jit(lambda x: x + 1)(1.0) == 2.0
    compilation.compiler_options.cache_clear()
    options.setattr(compilation, "CPU_OPTIONS", known | {"xla_cpu_no_such_option": True})
    assert compilation.compiler_options("cpu") == known


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="options are the CPU's")
def test_inside_of_another_transformation():
    """JAX refuses it, or from 0.12 on does it."""
    slope = jax.grad(jd.jit(lambda x: x**2))
    if jax.__version_info__ >= (0, 12):
        assert slope(1.0) == 2.0
    else:
        with pytest.raises(ValueError, match="top-level"):
            slope(1.0)


def test_what_a_jitted_function_closes_over_is_not_folded():
    table = jnp.arange(1000.0)
    program = jax.jit(lambda i: jnp.cumsum(compilation.unfolded(table))[i]).lower(3).compile().as_text()
    folded = jax.jit(lambda i: jnp.cumsum(table)[i]).lower(3).compile().as_text()
    assert "reduce-window" in program and "reduce-window" not in folded
    slope = jax.jit(jax.grad(lambda x: (compilation.unfolded(x) ** 2).sum()))
    np.testing.assert_array_equal(slope(table), 2 * table)
