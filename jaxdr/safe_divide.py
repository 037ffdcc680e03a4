"""Divisions that are safe to differentiate: where there is nothing to divide by, nothing is divided."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float


def safe_divide(
    a: Float[ArrayLike, "*#n"],
    b: Float[ArrayLike, "*#n"],
    valid: Bool[ArrayLike, "*#n"] | None = None,
    otherwise: Float[ArrayLike, "*#n"] | None = None,
) -> Float[Array, "*n"]:
    """a / b where `valid`, which left out is where b is not zero; elsewhere `otherwise`, which left out is a.

    What is guarded is the divisor. Behind a guarded quotient alone, gradients are zero times infinity: not a number.
    """
    valid = jnp.not_equal(b, 0) if valid is None else valid
    quotient = jnp.divide(a, jnp.where(valid, b, 1.0))
    return quotient if otherwise is None else jnp.where(valid, quotient, otherwise)


def nonzero(b: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
    """`b`, with 1 in place of 0: a divisor that several divisions share."""
    return jnp.where(jnp.equal(b, 0), 1.0, b)
