"""Divisions that are safe to differentiate where the divisor is zero."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float


def safe_divide(
    a: Float[ArrayLike, "*#n"],
    b: Float[ArrayLike, "*#n"],
    valid: Bool[ArrayLike, "*#n"] | None = None,
    otherwise: Float[ArrayLike, "*#n"] | None = None,
) -> Float[Array, "*n"]:
    """a / b where `valid` (default: where b is not zero), elsewhere `otherwise` (default: a).

    The divisor is replaced, not only the quotient. Else gradients would be zero times infinity, which is NaN.
    """
    valid = jnp.not_equal(b, 0) if valid is None else valid
    quotient = jnp.divide(a, jnp.where(valid, b, 1.0))
    return quotient if otherwise is None else jnp.where(valid, quotient, otherwise)


def nonzero(b: Float[ArrayLike, "*n"]) -> Float[Array, "*n"]:
    """`b` with 1 instead of 0, as a divisor for several divisions."""
    return jnp.where(jnp.equal(b, 0), 1.0, b)
