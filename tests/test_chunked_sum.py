"""Derivatives of sums over chunks: those of the plain sum, in every mode and under every transformation."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.chunked_sum import chunked_derivative, dependent

OUT = jax.ShapeDtypeStruct((3,), jnp.float32)
X, Y = jnp.asarray([0.3, -0.2, 0.9]), jnp.asarray(1.3)


class Wave(NamedTuple):
    """A term; equal ones compute the same."""

    power: int

    def __call__(self, at, fixed, index):
        x, y = at
        return jnp.sin(x * (index + 1)) * y**self.power + fixed["shift"] * x


def plain(x, y, shift, chunks):
    return sum(Wave(2)([x, y], {"shift": shift}, i) for i in range(chunks))


def total(chunks):
    """The same sum as a function with a rule for its derivative, as images are."""

    @jax.custom_jvp
    def function(x, y, shift):
        return plain(x, y, shift, chunks)

    @function.defjvp
    def _(primals, tangents):
        x, y, shift = primals
        moved = [jnp.asarray(t) for t in tangents[:2]]
        return function(*primals), chunked_derivative(Wave(2), chunks, [x, y], moved, {"shift": shift}, OUT)

    return function


@pytest.mark.parametrize("chunks", [1, 4])
@pytest.mark.parametrize("outer", [lambda f: f, jax.jit], ids=["plain", "jit"])
def test_modes(chunks, outer):
    found, expected = total(chunks), lambda x, y, shift: plain(x, y, shift, chunks)
    for mode in (jax.jacfwd, jax.jacrev):
        for one, two in zip(
            outer(mode(found, argnums=(0, 1)))(X, Y, 0.5), mode(expected, argnums=(0, 1))(X, Y, 0.5), strict=True
        ):
            np.testing.assert_allclose(one, two, rtol=1e-5, atol=1e-6)


def test_batches_of_every_operand():
    shifts, xs = jnp.asarray([0.5, -1.0]), jnp.stack([X, 2 * X])

    def gradient(function):
        return jax.grad(lambda x, y, shift: (function(x, y, shift) ** 2).sum(), argnums=(0, 1))

    cases = [((None, None, 0), (X, Y, shifts)), ((0, None, 0), (xs, Y, shifts)), ((0, None, None), (xs, Y, 0.5))]
    for axes, arguments in cases:
        expected = jax.vmap(gradient(lambda *a: plain(*a, 3)), axes)(*arguments)
        for batched in (jax.vmap(gradient(total(3)), axes), jax.jit(jax.vmap(gradient(total(3)), axes))):
            for one, two in zip(batched(*arguments), expected, strict=True):
                np.testing.assert_allclose(one, two, rtol=1e-5, atol=1e-5)
    # A gradient of a mean over a batch, and batches of batches.
    mean = jax.grad(lambda x: jax.vmap(lambda s: total(3)(x, Y, s))(shifts).sum())(X)
    np.testing.assert_allclose(mean, jax.grad(lambda x: sum(plain(x, Y, s, 3) for s in shifts).sum())(X), rtol=1e-5)
    twice = jax.vmap(lambda x: jax.vmap(lambda s: gradient(total(3))(x, Y, s)[0])(shifts))(xs)
    expected = jax.vmap(lambda x: jax.vmap(lambda s: gradient(lambda *a: plain(*a, 3))(x, Y, s)[0])(shifts))(xs)
    np.testing.assert_allclose(twice, expected, rtol=1e-5, atol=1e-5)


def test_second_derivatives_raise():
    for mode in (jax.jacfwd, jax.jacrev):
        for inner in (jax.jacfwd, jax.jacrev):
            with pytest.raises(NotImplementedError, match="first derivatives only"):
                mode(inner(lambda x: total(2)(x, Y, 0.5).sum()))(X)


def test_what_depends_on_what():
    def function(at):
        x, y = at
        inner = jax.jit(lambda a, b: (a * 2, b + 1))(x, jnp.ones(3))
        return [x + 1, jax.lax.stop_gradient(x) * 2, *inner, y.astype(int).astype(float), jnp.ones(2)]

    assert dependent(function, (X, Y)) == (True, False, True, False, False, False)
