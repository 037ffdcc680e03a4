"""The interface of textures: values that vary over a surface, in place of a constant of a BSDF or an emitter.

The path tracer looks up the values where it meets a surface. BSDFs are evaluated with these values, and never see a
texture.
"""

import abc
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int
from numpy.typing import ArrayLike

from jaxdr.arrays import as_array, broadcast, on_host
from jaxdr.geometry.vector import components, from_components, transform
from jaxdr.scene.ranges import Parametric, floats


class TexturePoint(NamedTuple):
    """N points on surfaces, as textures see them. `uv` and `barycentric` are differentiable where points slide.

    - `uv`: texture coordinates, (0, 0) at the lower left of an image. None in scenes whose textures use none.
    - `barycentric`: coordinates in the face.
    - `vertices`: rows of the corners of the face in the vertices of its own mesh.
    - `face`: row of the face in the faces of its own mesh. Only where a texture of the scene uses it.
    - `axes`: dp/du · x, dp/dv · x and dp/dv · y of the position p, in the frame of the surface, whose x axis is along
      increasing u. They are zero where the UVs define no directions. Only where a texture of the scene `uses_slopes`.
    """

    uv: Float[Array, "N 2"] | None
    barycentric: Float[Array, "N 3"]
    vertices: Int[Array, "N 3"]
    face: Int[Array, " N"] | None = None
    axes: Float[Array, "N 3"] | None = None


class Texture(Parametric, eqx.Module):
    """Values over a surface, one number or RGB at each point. The base class of textures.

    - `uses_uv`: whether it needs texture coordinates. If not, it has one row of data for every vertex or, with
      `uses_faces`, for every face.
    - `uses_slopes`: whether it needs the lengths on the surface that u and v stand for.
    """

    uses_uv: ClassVar[bool] = True
    uses_faces: ClassVar[bool] = False
    uses_slopes: ClassVar[bool] = False

    @property
    def parts(self) -> tuple["Texture", ...]:
        """The textures that it is made of; only itself if it is not made of others."""
        return (self,)

    @property
    @abc.abstractmethod
    def continuous(self) -> bool:
        """Whether values are continuous inside each face. If they are not, derivatives miss the motion of the jumps."""

    @abc.abstractmethod
    def data(self) -> tuple[Float[Array, "..."], ...]:
        """The arrays whose values are looked up and mixed. Their last axis has 1 channel (a number) or 3 (RGB)."""

    @abc.abstractmethod
    def lookup(self, row: Int[Array, " N"], point: TexturePoint) -> Float[Array, "N C"]:
        """Values at points. All arrays of this texture have a leading axis; `row` is the index along it, by point."""

    def fitted(self, channels: int, name: str) -> "Texture":
        """The texture with 1 or 3 channels: numbers become grey. Raises ValueError where RGB would become a number."""
        data = self.data()
        if all(array.shape[-1] == channels for array in data):
            return self
        if channels == 1:
            raise ValueError(f"{name} must be a number at every point, and the texture has RGB; give one channel of it")
        grey = [broadcast(array, (*array.shape[:-1], channels)) for array in data]
        return eqx.tree_at(lambda texture: texture.data(), self, tuple(grey))

    def extremes(self) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]] | None:
        """(lowest, highest) value of each channel, or bounds of these; None if an array is traced."""
        if any(isinstance(array, Tracer) for array in self.data()):
            return None
        rows = np.concatenate([np.asarray(array).reshape(-1, array.shape[-1]) for array in self.data()])
        return rows.min(0), rows.max(0)

    def check_range(self, name: str, low: float, high: float) -> None:
        """Raises ValueError, with the parameter's name, if a value is outside of [low, high]. Traced ones pass."""
        if (known := self.extremes()) is None:
            return
        least, most = float(known[0].min()), float(known[1].max())
        lowest, highest = (float(np.asarray(limit, known[0].dtype)) for limit in (low, high))
        if not (lowest <= least and most <= highest and np.isfinite(most)):
            expected = f"in [{low:g}, {high:g}]" if np.isfinite(high) else f"at least {low:g}"
            raise ValueError(f"{name} must be {expected}, and the texture has values from {least:g} to {most:g}")

    def times(self, factor: ArrayLike) -> "Texture":
        """The texture with all its values multiplied by a number, or by one factor for each channel."""
        scaled = tuple(as_array(on_host(array) * np.asarray(factor, array.dtype)) for array in self.data())
        return eqx.tree_at(lambda texture: texture.data(), self, scaled)

    def values(self, row: Int[Array, " N"], point: TexturePoint) -> Float[Array, "N *C"]:
        """The values that take the place of the texture at every point: numbers [N] or RGB [N, 3]."""
        found = self.lookup(row, point)
        return components(found)[0] if found.shape[-1] == 1 else found


def textures_in(tree: Any) -> list[tuple[str, Texture]]:
    """All textures in a pytree, with the names of the fields that lead to them, joined by dots."""
    leaves = jax.tree_util.tree_leaves_with_path(tree, is_leaf=lambda leaf: isinstance(leaf, Texture))
    return [(jax.tree_util.keystr(path, simple=True, separator="."), x) for path, x in leaves if isinstance(x, Texture)]


def channels_last(value: ArrayLike, name: str, axes: int) -> Float[Array, "..."]:
    """A float array with `axes` axes and then one for 1 or 3 channels, which a number may leave out.

    Raises ValueError, with the parameter's name, for another shape, and for integers unless `axes` is 0.
    """
    array = as_array(floats(value, name) if axes else value, None)
    if not jnp.issubdtype(array.dtype, jnp.floating) and axes:
        raise ValueError(f"{name} must be floats, linear, got {array.dtype}")
    array = on_host(as_array(array))
    if array.ndim == axes:
        array = array[..., None]
    if array.ndim != axes + 1 or array.shape[-1] not in (1, 3) or 0 in array.shape:
        raise ValueError(f"{name} must have 1 or 3 channels at {axes} indices, got shape {array.shape}")
    return as_array(array)


class ImageTexture(Texture):
    """A texture in the plane of an image.

    `to_uv` [2, 3] is an affine map of the UVs: (u', v') = `to_uv` @ (u, v, 1). None leaves them as they are.
    """

    to_uv: eqx.AbstractVar[Float[Array, "*k 2 3"] | None]

    def image_point(self, row: Int[Array, " N"], point: TexturePoint) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """Coordinates in the image, (0, 0) at its top left and (1, 1) at its lower right, before any wrapping."""
        assert point.uv is not None
        u, v = components(point.uv)
        if self.to_uv is not None:
            u, v = components(transform(self.to_uv[row], from_components(u, v, jnp.ones_like(u))))
        return u, 1.0 - v


def affine(to_uv: ArrayLike | None, name: str) -> Float[Array, "2 3"] | None:
    """An affine map of the plane [2, 3], from that shape or from [3, 3] with the last row 0 0 1.

    Raises ValueError for another shape or another last row.
    """
    if to_uv is None:
        return None
    matrix = on_host(as_array(to_uv))
    if matrix.shape == (3, 3) and not isinstance(matrix, Tracer) and matrix[2].tolist() != [0, 0, 1]:
        raise ValueError(f"{name}: the last row of to_uv must be 0 0 1, got {matrix[2].tolist()}")
    if matrix.shape not in ((2, 3), (3, 3)):
        raise ValueError(f"{name}: to_uv must have shape [2, 3] or [3, 3], got {list(matrix.shape)}")
    return as_array(matrix[:2])
