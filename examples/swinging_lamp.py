"""A light without area, in one file: a bulb on a swinging rod. Explained in docs/write_a_light.md."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

import jaxdr as jd
from jaxdr.arrays import as_array
from jaxdr.geometry.vector import from_components, scale
from jaxdr.scene.color import as_rgb, luminance
from jaxdr.scene.lights.base import vector


class SwingingLamp(jd.DeltaLight):
    """RGB `intensity` (W / sr) from the end of a rod of `length` below `pivot`, turned by `angle` towards +x."""

    pivot: Float[Array, "*n 3"]
    length: Float[Array, "*n"]
    angle: Float[Array, "*n"]
    intensity: Float[Array, "*n 3"]

    def __init__(self, pivot, length=1.0, angle=0.0, intensity=1.0):
        self.pivot = vector(pivot, "SwingingLamp: pivot")
        self.length, self.angle = as_array(length), as_array(angle)
        self.intensity = as_rgb(intensity, "SwingingLamp: intensity")

    def place(self):
        """The point it shines from. Shadows move with every parameter that this depends on."""
        along = from_components(jnp.sin(self.angle), jnp.zeros_like(self.angle), -jnp.cos(self.angle))
        return self.pivot + scale(along, self.length)

    def borders(self):
        """None: it shines in all directions, so its light ends nowhere."""
        return None

    def intensity_in(self, direction):
        """The intensity, which is the same in all directions."""
        del direction
        return self.intensity

    def power(self, radius):
        """Luminance of its power."""
        del radius
        return 4.0 * math.pi * jnp.maximum(luminance(self.intensity), 0.0)
