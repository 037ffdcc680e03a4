"""Vector algebra."""

import jax
import jax.numpy as jnp
import jax.test_util
import numpy as np
import pytest

from jaxdr.geometry import vector
from jaxdr.geometry.vector import dot

ROWS = 7


def rows(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=(ROWS, *shape)).astype(np.float32)


A, B, S, TRIANGLES = rows(3), rows(3, seed=1), rows(seed=2), rows(3, 3, seed=3)
MATRIX = np.random.default_rng(4).normal(size=(3, 3)).astype(np.float32)
AXES = np.linalg.qr(rows(3, 3, seed=5))[0]
FRAME = vector.Frame(*(AXES[:, k] for k in range(3)))

# Function, arguments and what NumPy says.
CASES = {
    "components": (lambda a: jnp.stack(vector.components(a)), (A,), lambda a: a.T),
    "from_components": (lambda a, b, c: vector.from_components(a, b, c), (S, S + 1, S + 2), lambda *n: np.stack(n, -1)),
    "corners": (lambda t: jnp.stack(vector.corners(t)), (TRIANGLES,), lambda t: np.moveaxis(t, 1, 0)),
    "dot": (dot, (A, B), lambda a, b: (a * b).sum(-1)),
    "cross": (vector.cross, (A, B), np.cross),
    "scale": (vector.scale, (A, S), lambda a, s: a * s[:, None]),
    "norm": (vector.norm, (A,), lambda a: np.linalg.norm(a, axis=-1)),
    "normalize": (vector.normalize, (A,), lambda a: a / np.linalg.norm(a, axis=-1, keepdims=True)),
    "interpolate": (vector.interpolate, (TRIANGLES, B), lambda t, b: np.einsum("nkd,nk->nd", t, b)),
    "transform": (vector.transform, (MATRIX, A), lambda m, a: a @ m.T),
    "to_local": (FRAME.to_local, (A,), lambda a: np.einsum("nkd,nd->nk", AXES, a)),
    "to_world": (FRAME.to_world, (A,), lambda a: np.einsum("nkd,nk->nd", AXES, a)),
}


@pytest.mark.parametrize("name", CASES)
def test_values_are_numpys(name):
    function, arguments, expected = CASES[name]
    np.testing.assert_allclose(function(*arguments), expected(*arguments), rtol=2e-6, atol=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_finite_differences(name):
    function, arguments, _ = CASES[name]
    jax.test_util.check_grads(function, arguments, order=1, modes=("fwd", "rev"), atol=1e-2, rtol=1e-2)


@pytest.mark.parametrize("name", CASES)
def test_derivatives_pad_nothing_and_sum_over_no_coordinates(name):
    """Padding is the transpose of a slice, a sum over three that of numbers repeated; both are slow on CPUs."""
    function, arguments, _ = CASES[name]
    gradient = jax.grad(lambda *values: (function(*values) ** 2).sum(), tuple(range(len(arguments))))
    for equation in equations(jax.make_jaxpr(gradient)(*arguments).jaxpr):
        assert equation.primitive.name not in ("pad", "slice")
        if equation.primitive.name == "reduce_sum":
            summed = [equation.invars[0].aval.shape[axis] for axis in equation.params["axes"]]
            assert ROWS in summed or set(summed) == {1}, equation


def equations(jaxpr):
    """All equations of a jaxpr and of those within it."""
    for equation in jaxpr.eqns:
        yield equation
        for within in jax.tree.leaves(list(equation.params.values())):
            inner = getattr(within, "jaxpr", within)
            if hasattr(inner, "eqns"):
                yield from equations(inner)


def test_one_vector_and_many_rows():
    one, number = A[0], 2.5
    np.testing.assert_allclose(vector.scale(one, S), S[:, None] * one, rtol=1e-6)
    np.testing.assert_allclose(vector.scale(A, number), number * A, rtol=1e-6)
    np.testing.assert_allclose(vector.scale(A[:, None], rows(4)), A[:, None] * rows(4)[..., None], rtol=1e-6)
    np.testing.assert_allclose(dot(one, A), A @ one, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(vector.cross(one, A), np.cross(one, A), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(vector.transform(MATRIX, one), MATRIX @ one, rtol=1e-5)
    assert vector.from_components(1.0, S, np.zeros((2, 1), np.float32)).shape == (2, ROWS, 3)
    assert vector.normalize(one).shape == (3,) and vector.norm(one).shape == ()


def test_a_basis_is_right_handed_and_orthonormal():
    n = np.concatenate([np.asarray(vector.normalize(A)), [[0, 0, 1], [0, 0, -1]]]).astype(np.float32)
    s, t = vector.orthonormal_basis(n)
    np.testing.assert_allclose(vector.cross(s, t), n, atol=1e-6)
    np.testing.assert_allclose(dot(s, t), 0, atol=1e-6)
    np.testing.assert_allclose(vector.norm(s), 1, atol=1e-6)


@pytest.mark.parametrize("length, zero", [(0.0, True), (1e-30, True), (2e-20, True), (1e-18, False), (1.0, False)])
def test_what_counts_as_zero(length, zero):
    """The same vectors for all three functions, on all devices: those whose squared length is no normal number."""
    v = jnp.asarray([0.6, 0.0, 0.8], jnp.float32) * jnp.float32(length)
    assert bool(vector.vanishes(v)) == zero
    np.testing.assert_allclose(vector.normalize(v), np.zeros(3) if zero else [0.6, 0.0, 0.8], atol=1e-6)
    np.testing.assert_allclose(vector.norm(v), 0.0 if zero else length, rtol=1e-6)
    for function in (vector.norm, lambda v: vector.normalize(v)[2]):
        derivative = jax.grad(function)(v)
        assert np.all(np.isfinite(derivative)) and (np.all(derivative == 0) == zero)


def test_the_zero_vector_has_derivative_zero():
    for function in (vector.norm, vector.normalize):
        value, derivative = jax.jvp(function, (np.zeros((2, 3), np.float32),), (np.ones((2, 3), np.float32),))
        assert not np.any(value) and not np.any(derivative)
        assert not np.any(jax.grad(lambda a, function=function: function(a).sum())(np.zeros(3, np.float32)))


def test_dot_with_one_vector_for_many_rows_is_right_under_jit():
    """XLA's CPU compiler gets rows from 32768 on wrong if `dot` is a sum over an axis (jaxlib 0.10.2)."""
    rng = np.random.default_rng(0)
    vector, scale = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.uniform(1, 2, 36864))
    rows = jnp.asarray(rng.normal(size=(36864, 3)))
    found = jax.jit(lambda v, r, s: dot(v, r) / s)(vector, rows, scale)
    expected = np.asarray(rows, np.float64) @ np.asarray(vector, np.float64) / np.asarray(scale, np.float64)
    np.testing.assert_allclose(found, expected, atol=1e-5)
