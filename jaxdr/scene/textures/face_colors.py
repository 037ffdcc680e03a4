"""One value a face."""

from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.scene.textures.base import Texture, channels_last


class FaceColors(Texture):
    """`colors` [F] or [F, C] (C = 1 or 3) of a mesh's F faces, each the same all over its face."""

    colors: Float[Array, "*k F C"]
    uses_uv = False
    uses_faces = True

    def __init__(self, colors: ArrayLike):
        self.colors = channels_last(colors, "FaceColors: colors [F, C]", 1)

    @property
    def continuous(self) -> bool:
        return True

    def data(self):
        return (self.colors,)

    def lookup(self, row, point):
        assert point.face is not None
        return self.colors[row, point.face]
