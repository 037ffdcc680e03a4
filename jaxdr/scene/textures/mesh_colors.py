"""Textures with one value for every vertex, or for every face, of a mesh."""

from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import interpolate
from jaxdr.scene.textures.base import Texture, channels_last


class MeshColors(Texture):
    """`colors` [n] or [n, C] (C = 1 or 3), in the order of the vertices or of the faces of a mesh."""

    colors: Float[Array, "*k n C"]
    uses_uv = False

    def __init__(self, colors: ArrayLike):
        self.colors = channels_last(colors, f"{type(self).__name__}: colors [n, C]", 1)

    @property
    def continuous(self) -> bool:
        return True

    def data(self):
        return (self.colors,)


@checked
class VertexColors(MeshColors):
    """A colour for each vertex, interpolated over the faces: `colors` [V] or [V, C] (C = 1 or 3), linear floats.

    Raises ValueError for another shape. V is the number of vertices of the mesh, which `Scene` checks.
    """

    def __init__(self, colors: ArrayLike):
        super().__init__(colors)

    def lookup(self, row, point):
        return interpolate(self.colors[row[:, None], point.vertices], point.barycentric)


@checked
class FaceColors(MeshColors):
    """A colour for each face, constant over the face: `colors` [F] or [F, C] (C = 1 or 3), linear floats.

    Raises ValueError for another shape. F is the number of faces of the mesh, which `Scene` checks.
    """

    uses_faces = True

    def __init__(self, colors: ArrayLike):
        super().__init__(colors)

    def lookup(self, row, point):
        assert point.face is not None
        return self.colors[row, point.face]
