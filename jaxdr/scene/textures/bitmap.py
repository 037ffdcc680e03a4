"""Images on surfaces."""

import os

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import scale
from jaxdr.images import load_image
from jaxdr.scene.textures.base import ImageTexture, affine, channels_last

FILTERS = ("bilinear", "nearest")
WRAPS = ("repeat", "mirror", "clamp")


class PixelTexture(ImageTexture):
    """The base class of textures made of pixels. Its parameters are those of `Bitmap`."""

    pixels: Float[Array, "*k H W C"]
    to_uv: Float[Array, "*k 2 3"] | None
    filter: str = eqx.field(static=True)
    wrap: str | tuple[str, str] = eqx.field(static=True)

    def __init__(
        self,
        pixels: ArrayLike,
        filter: str,
        wrap: str | tuple[str, str],
        to_uv: ArrayLike | None,
    ):
        if filter not in FILTERS:
            raise ValueError(f"Bitmap: filter must be one of {', '.join(FILTERS)}; got {filter!r}")
        wraps = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap)
        if len(wraps) != 2 or not set(wraps) <= set(WRAPS):
            count = "one" if isinstance(wrap, str) else "two, for u and v,"
            raise ValueError(f"Bitmap: wrap must be {count} of {', '.join(WRAPS)}; got {wrap!r}")
        self.pixels = channels_last(pixels, "Bitmap: pixels [H, W, C]", 2)
        self.to_uv = affine(to_uv, "Bitmap")
        self.filter = filter
        self.wrap = wrap if isinstance(wrap, str) else wraps

    @property
    def continuous(self) -> bool:
        return self.filter == "bilinear"

    def data(self):
        return (self.pixels,)

    def bilinear(self, row: Int[Array, " N"], x: Float[Array, " N"], y: Float[Array, " N"]) -> Float[Array, "N C"]:
        """Values at points of the image, in pixels from its top left."""
        x, y = x - 0.5, y - 0.5
        left, top = jnp.floor(x), jnp.floor(y)
        right, below = x - left, y - top
        upper = scale(self._pixel(row, left, top), 1.0 - right) + scale(self._pixel(row, left + 1, top), right)
        lower = scale(self._pixel(row, left, top + 1), 1.0 - right) + scale(self._pixel(row, left + 1, top + 1), right)
        return scale(upper, 1.0 - below) + scale(lower, below)

    def _pixel(self, row, x, y) -> Float[Array, "N C"]:
        height, width = self.pixels.shape[-3:-1]
        along_u, along_v = (self.wrap, self.wrap) if isinstance(self.wrap, str) else self.wrap
        return self.pixels[row, _wrapped(y, height, along_v), _wrapped(x, width, along_u)]


@checked
class Bitmap(PixelTexture):
    """An image, `pixels` [H, W] or [H, W, C] (C = 1 or 3; linear floats, the top row first), over UVs in [0, 1]^2.

    Values belong to the centres of pixels, as in Mitsuba 3's `bitmap`.

    - `filter`: "bilinear" interpolates. "nearest" takes the value of the nearest pixel, so that values jump inside
      faces.
    - `wrap`: how the image goes on outside of [0, 1]^2: "repeat", "mirror" or "clamp", or a pair of these for u and v.
    - `to_uv` [2, 3] or [3, 3]: maps the UVs before the image is looked up.

    Raises ValueError for another shape, for integers (`Bitmap.from_file` reads images), and for an unknown `filter` or
    `wrap`.
    """

    def __init__(
        self,
        pixels: ArrayLike,
        *,
        filter: str = "bilinear",
        wrap: str | tuple[str, str] = "repeat",
        to_uv: ArrayLike | None = None,
    ):
        super().__init__(pixels, filter, wrap, to_uv)

    @classmethod
    def from_file(
        cls, path: str | os.PathLike, *, raw: bool = False, channel: int | None = None, **settings
    ) -> "Bitmap":
        """The texture of an image file that `load_image` reads; `settings` are those of `Bitmap`.

        PNG and JPEG files hold sRGB, which is made linear. That is right for colours. For roughness, opacity and
        normals `raw` leaves the numbers as they are. `channel` takes a single channel (0 red … 3 alpha); without it,
        alpha is dropped. Raises ValueError, with the file's name, for a file that can't be read or has no such channel.
        """
        image = load_image(path, raw=raw)
        wrong = np.argwhere(~np.isfinite(image).all(-1))
        if len(wrong):
            row, column = wrong[0]
            raise ValueError(f"{path}: pixels are not finite, the first in row {row}, column {column}; mend the image")
        if channel is None:
            return cls(image[..., :3], **settings)
        if not 0 <= channel < image.shape[-1]:
            raise ValueError(f"{path}: there is no channel {channel}; the image has {image.shape[-1]}")
        return cls(image[..., channel], **settings)

    def lookup(self, row, point):
        height, width = self.pixels.shape[-3:-1]
        across, down = self.image_point(row, point)
        x, y = across * width, down * height
        if self.filter == "nearest":
            return self._pixel(row, jnp.floor(x), jnp.floor(y))
        return self.bilinear(row, x, y)


def _wrapped(index, size: int, wrap: str):
    """The row or column of the image for any index, also one beyond its borders."""
    index = index.astype(jnp.int32)
    if wrap == "clamp":
        return jnp.clip(index, 0, size - 1)
    if wrap == "repeat":
        return jnp.mod(index, size)
    there_and_back = jnp.mod(index, 2 * size)
    return jnp.minimum(there_and_back, 2 * size - 1 - there_and_back)
