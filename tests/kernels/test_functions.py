"""Elementary functions over all exponents, in units in the last place of float32."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxdr.kernels import fused

LEAST = np.float32(1.18e-38)  # smaller numbers may count as zero
FUNCTIONS = {
    "exp": (lax.exp, np.exp, 2.0),
    "exp2": (lax.exp2, np.exp2, 2.0),
    "log": (lax.log, np.log, 2.0),
    "log1p": (lax.log1p, np.log1p, 2.0),
    "expm1": (lax.expm1, np.expm1, 2.0),
    "sin": (lax.sin, np.sin, 2.0),
    "cos": (lax.cos, np.cos, 2.0),
    "tan": (lax.tan, np.tan, 2.0),
    "tanh": (lax.tanh, np.tanh, 3.0),
    "asin": (lax.asin, np.arcsin, 2.0),
    "acos": (lax.acos, np.arccos, 2.0),
    "atan": (lax.atan, np.arctan, 2.0),
    "cbrt": (lax.cbrt, np.cbrt, 2.0),
    "logistic": (lax.logistic, lambda x: 1 / (1 + np.exp(-x)), 4.0),
}


def numbers() -> np.ndarray:
    """All exponents and both signs, and more of those near 1."""
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, 200_000, np.uint32).view(np.float32)
    near = (rng.normal(size=200_000) * np.exp(rng.normal(size=200_000) * 3)).astype(np.float32)
    return np.concatenate([bits[np.isfinite(bits)], near, np.arange(-200, 200, dtype=np.float32)])


@pytest.mark.parametrize("name", FUNCTIONS)
def test_units_in_the_last_place(name):
    function, exact, allowed = FUNCTIONS[name]
    x = numbers()
    with np.errstate(all="ignore"):
        expected = exact(x.astype(np.float64))
        rounded = expected.astype(np.float32)
    found = np.asarray(jax.jit(fused(function))(jnp.asarray(x)))
    special = ~np.isfinite(rounded) & (np.abs(x) >= LEAST)
    np.testing.assert_array_equal(found[special], rounded[special])
    ordinary = np.isfinite(rounded) & (np.abs(x) >= LEAST) & (np.abs(expected) >= LEAST)
    unit = np.spacing(np.abs(rounded[ordinary]))
    off = np.abs(found[ordinary] - expected[ordinary]) / unit
    worst = off.argmax()
    assert off[worst] <= allowed, f"{name}({x[ordinary][worst]}) is off by {off[worst]} units"
