"""Splatting: values at arbitrary film points are added to the pixels whose reconstruction filter covers them."""

import math

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from jaxdr.geometry.vector import scale
from jaxdr.scene.film import Film


def splat(
    film: Film, points: Float[Array, "n 2"], values: Float[Array, "n 3"], moving: bool = False
) -> Float[Array, "H W 3"]:
    """Image of the rendered window: each value is weighted with the filter density (per square pixel) around its point.

    The points are detached unless `moving`. The choice of the pixels that they reach is always detached.
    """
    x0, y0, width, height = film.window
    points = points if moving else stop_gradient(points)
    span = math.ceil(2 * film.filter.radius)
    first = jnp.floor(stop_gradient(points) - film.filter.radius + 0.5)  # lowest pixel whose filter can reach the point
    offsets = jnp.stack(jnp.meshgrid(jnp.arange(span), jnp.arange(span), indexing="ij"), -1).reshape(-1, 2)
    pixel = first[:, None] + offsets[None].astype(points.dtype)
    weight = film.filter.pdf(points[:, None] - pixel - 0.5)
    column, row = (pixel - jnp.asarray([x0, y0], points.dtype)).astype(jnp.int32).transpose(2, 0, 1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = jnp.where(inside, row * width + column, width * height)
    contributions = scale(values[:, None], weight).reshape(-1, 3)
    image = jnp.zeros((width * height, 3), values.dtype).at[index.reshape(-1)].add(contributions, mode="drop")
    return image.reshape(height, width, 3)
