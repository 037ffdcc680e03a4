"""Losses between images [H, W, 3]: means over all pixels and channels. A mask weights pixels: [H, W] or [H, W, 1]."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def l1(
    image: Float[Array, "H W 3"], target: Float[Array, "H W 3"], mask: Float[Array, "H W *c"] | None = None
) -> Float[Array, ""]:
    """Mean absolute difference."""
    return _mean(jnp.abs(_difference(image, target)), mask)


def l2(
    image: Float[Array, "H W 3"], target: Float[Array, "H W 3"], mask: Float[Array, "H W *c"] | None = None
) -> Float[Array, ""]:
    """Mean squared difference. Noise in the image adds its variance to the expectation; see `two_key_l2`."""
    return _mean(_difference(image, target) ** 2, mask)


def two_key_l2(
    image_a: Float[Array, "H W 3"],
    image_b: Float[Array, "H W 3"],
    target: Float[Array, "H W 3"],
    mask: Float[Array, "H W *c"] | None = None,
) -> Float[Array, ""]:
    """Unbiased squared difference, mean of (a - t)(b - t), from two renderings with independent keys.

    The expectation of the product of independent factors is the product of the expectations, so neither the
    loss nor its gradient depends on the number of samples. Single values can be negative.
    """
    return _mean(_difference(image_a, target) * _difference(image_b, target), mask)


def _difference(image, target):
    # Broadcasting [H, W] against [H, W, 3] would be silent and wrong.
    if jnp.shape(image) != jnp.shape(target):
        raise ValueError(f"loss: image has shape {jnp.shape(image)}, target {jnp.shape(target)}; they must agree")
    return image - target


def _mean(error, mask):
    if mask is None:
        return jnp.mean(error)
    mask = jnp.asarray(mask, error.dtype)
    if mask.shape not in (error.shape[:-1], (*error.shape[:-1], 1)):
        raise ValueError(f"loss: mask has shape {mask.shape}, expected {error.shape[:-1]} or {(*error.shape[:-1], 1)}")
    return jnp.mean(error * mask.reshape(*error.shape[:-1], 1))
