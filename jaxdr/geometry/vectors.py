"""Small differentiable vector functions that stay finite at degenerate input."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float


def unit_or_zero(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Vector scaled to length one; a zero vector stays zero, with zero derivative.

    The largest component is divided out first, so lengths whose square would underflow or overflow are no special case.
    The scale is detached: the result does not depend on it.
    """
    size = jnp.max(jnp.abs(vector), axis=-1, keepdims=True)
    is_zero = size == 0
    # A guarded input, not a guarded output: where() around sqrt(0) would still differentiate to NaN.
    scaled = jnp.where(is_zero, 1.0, vector / lax.stop_gradient(jnp.where(is_zero, 1.0, size)))
    return jnp.where(is_zero, 0.0, scaled / jnp.sqrt(jnp.sum(scaled * scaled, axis=-1, keepdims=True)))
