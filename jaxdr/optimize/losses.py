"""Losses between images [H, W, 3]: means over all pixels and channels. A mask weights pixels: [H, W] or [H, W, 1].

Where a mask is zero nothing counts, not even NaN or infinity. Elsewhere they show in the loss and in its derivative.
"""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.argument_kinds import checked


@checked
def l1(
    image: Float[Array, "H W 3"], target: Float[Array, "H W 3"], mask: Float[Array, "H W *c"] | None = None
) -> Float[Array, ""]:
    """Mean absolute difference."""
    return _mean("l1", lambda a, t: jnp.abs(a - t), mask, image, target)


@checked
def l2(
    image: Float[Array, "H W 3"], target: Float[Array, "H W 3"], mask: Float[Array, "H W *c"] | None = None
) -> Float[Array, ""]:
    """Mean squared difference. Noise in the image adds its variance to the expectation; see `two_key_l2`."""
    return _mean("l2", lambda a, t: (a - t) ** 2, mask, image, target)


@checked
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
    return _mean("two_key_l2", lambda a, b, t: (a - t) * (b - t), mask, image_a, image_b, target)


@checked
def without(ignored: Bool[Array, "H W *c"], *images: Float[Array, "H W C"]) -> list[Float[Array, "H W C"]]:
    """The images with zeros where pixels are `ignored`.

    It comes before all arithmetic: zero times NaN is NaN, and so is the derivative of what is left out afterwards.
    """
    for image in images:
        if jnp.shape(image)[:2] != ignored.shape[:2]:
            shapes = f"{jnp.shape(image)}, ignored {ignored.shape}"
            raise ValueError(f"without: one of images has shape {shapes}; they must agree")
    return [jnp.where(ignored.reshape(*image.shape[:-1], -1), 0.0, image) for image in images]


def _mean(caller, error, mask, *images):
    *shown, target = images
    for image in shown:
        # Broadcasting [H, W] against [H, W, 3] would be silent and wrong.
        if jnp.shape(image) != jnp.shape(target):
            raise ValueError(
                f"{caller}: image has shape {jnp.shape(image)}, target {jnp.shape(target)}; they must agree"
            )
    if mask is None:
        return jnp.mean(error(*images))
    images = [jnp.asarray(image) for image in images]
    shape, dtype = images[0].shape, jnp.result_type(*images)
    mask = jnp.asarray(mask, dtype)
    if mask.shape not in (shape[:-1], (*shape[:-1], 1)):
        raise ValueError(f"{caller}: mask has shape {mask.shape}, expected {shape[:-1]} or {(*shape[:-1], 1)}")
    mask = mask.reshape(*shape[:-1], 1)
    # Where the error is finite it stays: it is the derivative by the mask.
    ignored = (mask == 0) & ~jnp.isfinite(stop_gradient(error(*images)))
    return jnp.mean(error(*without(ignored, *images)) * mask)
