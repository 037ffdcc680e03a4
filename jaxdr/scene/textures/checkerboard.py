"""A checkerboard of two colours."""

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import broadcast
from jaxdr.scene.textures.base import ImageTexture, affine, channels_last


@checked
class Checkerboard(ImageTexture):
    """A checkerboard of two by two fields over UVs in [0, 1]^2, repeated beyond (Mitsuba 3's `checkerboard`).

    `color0` is at the upper left and lower right, `color1` at the other two. Each is a number or RGB. `to_uv` [2, 3] or
    [3, 3] maps the UVs first. Raises ValueError for another shape.
    """

    color0: Float[Array, "*k C"]
    color1: Float[Array, "*k C"]
    to_uv: Float[Array, "*k 2 3"] | None

    def __init__(self, color0: ArrayLike = 0.4, color1: ArrayLike = 0.2, *, to_uv: ArrayLike | None = None):
        colors = [channels_last(c, f"Checkerboard: color{i}", 0) for i, c in enumerate((color0, color1))]
        channels = max(color.shape[0] for color in colors)
        self.color0, self.color1 = (broadcast(color, (channels,)) for color in colors)
        self.to_uv = affine(to_uv, "Checkerboard")

    @property
    def continuous(self) -> bool:
        return False

    def data(self):
        return self.color0, self.color1

    def lookup(self, row, point):
        second_column, second_row = (x - jnp.floor(x) > 0.5 for x in self.image_point(row, point))
        return jnp.where((second_column == second_row)[:, None], self.color0[row], self.color1[row])
