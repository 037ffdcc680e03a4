"""Light from infinitely far away, in one direction."""

from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import normalize
from jaxdr.scene.color import as_rgb, magnitude
from jaxdr.scene.lights.base import DeltaLight, check_direction, vector


@checked
class DirectionalLight(DeltaLight):
    """Parallel light that travels along `direction`, like the sun's.

    `direction` may have any length but zero. `irradiance` is RGB, in W / m^2 on a plane across the direction. Raises
    ValueError for a direction of zero length, and for another shape of either.
    """

    direction: Float[Array, "*n 3"]
    irradiance: Float[Array, "*n 3"]
    infinite = True

    def __init__(self, direction: ArrayLike, irradiance: ArrayLike = 1.0):
        self.direction = vector(direction, "DirectionalLight: direction")
        self.irradiance = as_rgb(irradiance, "DirectionalLight: irradiance")

    def check_together(self):
        check_direction(self.direction, "DirectionalLight: direction")

    def place(self):
        return -normalize(self.direction)

    def borders(self):
        return None

    def intensity_in(self, direction):
        del direction
        return self.irradiance

    def power(self, radius):
        # As an environment of the same mean radiance, irradiance / 4 pi; see `emitter_choice`.
        return 0.25 * radius**2 * magnitude(self.irradiance)
