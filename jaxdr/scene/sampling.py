"""Maps from uniform numbers in [0, 1)^2 to directions and triangles, with their densities."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float


def cosine_hemisphere(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Directions around +z with density cos/pi (solid angle)."""
    radius, angle = jnp.sqrt(u[..., 0]), 2 * math.pi * u[..., 1]
    z = jnp.sqrt(jnp.maximum(1.0 - u[..., 0], 0.0))
    return jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), z], -1)


def uniform_sphere(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Directions with density 1/(4 pi) (solid angle)."""
    z = 1.0 - 2.0 * u[..., 0]
    radius, angle = jnp.sqrt(jnp.maximum(1.0 - z * z, 0.0)), 2 * math.pi * u[..., 1]
    return jnp.stack([radius * jnp.cos(angle), radius * jnp.sin(angle), z], -1)


def uniform_triangle(u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
    """Barycentric coordinates, uniform in area (Heitz 2019, low distortion)."""
    x, y = u[..., 0], u[..., 1]
    upper = y > x
    b0 = jnp.where(upper, 0.5 * x, x - 0.5 * y)
    b1 = jnp.where(upper, y - 0.5 * x, 0.5 * y)
    return jnp.stack([b0, b1, 1.0 - b0 - b1], -1)
