"""A texture of heights over a surface, which is looked up as slopes."""

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.geometry.vector import components, from_components
from jaxdr.scene.textures.base import Texture
from jaxdr.scene.textures.bitmap import Bitmap, PixelTexture


class Heights(PixelTexture):
    """A bilinear image [H, W, 1] of heights. A look-up gives their slopes along the x and the y axis of the surface.

    A slope is the difference of the heights half a texel away to both sides. It is continuous.
    """

    uses_slopes = True

    def __init__(self, pixels: ArrayLike, *, wrap: str | tuple[str, str] = "repeat", to_uv: ArrayLike | None = None):
        super().__init__(pixels, "bilinear", wrap, to_uv)

    @staticmethod
    def of(texture: Texture, name: str) -> "Heights":
        """The same image as heights. Raises ValueError, with the parameter's name, unless it has slopes everywhere."""
        if not isinstance(texture, Bitmap) or not texture.continuous:
            raise ValueError(f"{name} must be a bilinear Bitmap: other heights have steps or no slope")
        if texture.pixels.shape[-1] != 1:
            raise ValueError(f"{name} must have one channel, and the texture has RGB")
        return Heights(texture.pixels, wrap=texture.wrap, to_uv=texture.to_uv)

    def lookup(self, row, point):
        """Slopes [N, 2]: change of height per length on the surface (scene units)."""
        assert point.axes is not None
        height, width = self.pixels.shape[-3:-1]
        across, down = self.image_point(row, point)
        x, y = across * width, down * height
        along_x, along_y = (
            components(self.bilinear(row, x + a, y + b) - self.bilinear(row, x - a, y - b))[0] * size
            for a, b, size in ((0.5, 0.0, width), (0.0, 0.5, height))
        )
        if self.to_uv is None:
            by_u, by_v = along_x, -along_y
        else:
            (a, b, _), (c, d, _) = (components(line) for line in _lines(self.to_uv[row]))
            by_u, by_v = a * along_x - c * along_y, b * along_x - d * along_y
        # dp/du = (a, 0) and dp/dv = (b, c) in the axes: the gradient g has g · dp/du = by_u and g · dp/dv = by_v.
        a, b, c = components(point.axes)
        known = (a != 0) & (c != 0)
        first = by_u / jnp.where(known, a, 1.0)
        second = (by_v - b * first) / jnp.where(known, c, 1.0)
        return from_components(jnp.where(known, first, 0.0), jnp.where(known, second, 0.0))


def _lines(matrix: Float[Array, "N 2 3"]) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """The first and the second rows of matrices."""
    return matrix[:, 0], matrix[:, 1]
