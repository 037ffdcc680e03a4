"""RGB: parameters, luminance, and magnitude."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.arrays import as_numbers, broadcast
from jaxdr.geometry.vector import components

LUMINANCE = (0.2126, 0.7152, 0.0722)


def luminance(rgb: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Luminance of linear RGB (Rec. 709 primaries)."""
    red, green, blue = (share * part for share, part in zip(LUMINANCE, components(rgb), strict=True))
    return red + green + blue


def magnitude(rgb: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Luminance of the absolute values: what a sampling weight made of RGB is in proportion to.

    It is never negative, and zero for black only. Luminance is neither where a parameter is below zero.
    """
    return luminance(jnp.abs(rgb))


def as_rgb(value, name: str) -> Float[Array, "3"]:
    """RGB from one number or three numbers. Raises ValueError, with the parameter's name, for any other shape."""
    array = as_numbers(value, name)
    if array.shape not in ((), (1,), (3,)):
        raise ValueError(f"{name} must be a number or three numbers (RGB), got shape {array.shape}")
    return broadcast(array, (3,))
