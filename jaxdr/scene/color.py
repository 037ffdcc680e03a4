"""RGB parameters."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def as_rgb(value, name: str) -> Float[Array, "3"]:
    """An RGB triple from a number or three numbers; ValueError names the parameter otherwise."""
    array = jnp.asarray(value, float)
    if array.shape not in ((), (1,), (3,)):
        raise ValueError(f"{name} must be a number or three numbers (RGB), got shape {array.shape}")
    return jnp.broadcast_to(array, (3,))
