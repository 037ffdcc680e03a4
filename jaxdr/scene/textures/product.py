"""The product of two textures."""

import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.scene.textures.base import Texture


@checked
class Product(Texture):
    """The product of two textures at every point, such as an image and the colours of vertices."""

    first: Texture
    second: Texture

    @property
    def uses_uv(self) -> bool:
        return self.first.uses_uv or self.second.uses_uv

    @property
    def uses_faces(self) -> bool:
        return self.first.uses_faces or self.second.uses_faces

    @property
    def uses_slopes(self) -> bool:
        return self.first.uses_slopes or self.second.uses_slopes

    @property
    def parts(self):
        return self.first.parts + self.second.parts

    @property
    def continuous(self) -> bool:
        return self.first.continuous and self.second.continuous

    def data(self):
        return self.first.data() + self.second.data()

    def extremes(self):
        one, two = self.first.extremes(), self.second.extremes()
        if one is None or two is None:
            return None
        (a, b), (c, d) = one, two
        ends = np.stack(np.broadcast_arrays(a * c, a * d, b * c, b * d))
        return ends.min(0), ends.max(0)

    def lookup(self, row, point):
        return self.first.lookup(row, point) * self.second.lookup(row, point)

    def times(self, factor):
        return Product(self.first.times(factor), self.second)
