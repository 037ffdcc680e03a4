"""Light from a point, the same in all directions."""

import math

from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.scene.color import as_rgb, magnitude
from jaxdr.scene.lights.base import DeltaLight, vector


@checked
class PointLight(DeltaLight):
    """A point that shines equally in all directions.

    - `position` [3]: world space, scene units.
    - `intensity`: RGB, W / sr; a number means grey.

    Raises ValueError for another shape of either, and for numbers that are not finite.
    """

    position: Float[Array, "*n 3"]
    intensity: Float[Array, "*n 3"]

    def __init__(self, position: ArrayLike, intensity: ArrayLike = 1.0):
        self.position = vector(position, "PointLight: position")
        self.intensity = as_rgb(intensity, "PointLight: intensity")

    def place(self):
        return self.position

    def borders(self):
        return None

    def intensity_in(self, direction):
        del direction
        return self.intensity

    def power(self, radius):
        del radius
        return 4.0 * math.pi * magnitude(self.intensity)
