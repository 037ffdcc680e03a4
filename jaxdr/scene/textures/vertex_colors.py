"""One value a vertex."""

from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.geometry.vector import interpolate
from jaxdr.scene.textures.base import Texture, channels_last


class VertexColors(Texture):
    """`colors` [V] or [V, C] (C = 1 or 3) of a mesh's V vertices, interpolated over its faces."""

    colors: Float[Array, "*k V C"]
    uses_uv = False

    def __init__(self, colors: ArrayLike):
        self.colors = channels_last(colors, "VertexColors: colors [V, C]", 1)

    @property
    def continuous(self) -> bool:
        return True

    def data(self):
        return (self.colors,)

    def lookup(self, row, point):
        return interpolate(self.colors[row[:, None], point.vertices], point.barycentric)
