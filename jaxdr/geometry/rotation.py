"""Rotations as vectors: axis times angle."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def rotation_matrix(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation about a vector by its length in radians (Rodrigues); differentiable at zero, too."""
    squared = vector @ vector
    small = squared < 1e-6
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    first = jnp.where(small, 1.0 - squared / 6, jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - squared / 24, (1.0 - jnp.cos(angle)) / safe)
    x, y, z = vector
    zero = jnp.zeros_like(x)
    cross = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    return jnp.eye(3, dtype=vector.dtype) + first * cross + second * (cross @ cross)
