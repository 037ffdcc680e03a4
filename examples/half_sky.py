"""An environment, in one file: a sky that is bright on one side. Explained in docs/write_a_light.md."""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

import jaxdr as jd
from jaxdr.arrays import as_array
from jaxdr.geometry.vector import components
from jaxdr.scene.color import as_rgb
from jaxdr.scene.emitters import UniformDirections


class HalfSky(jd.Environment):
    """`radiance` from the directions on the +x side of a plane through the z axis; the plane is turned by `azimuth`."""

    radiance: Float[Array, "3"]
    azimuth: Float[Array, ""]
    uniform = False

    def __init__(self, radiance=1.0, azimuth=0.0):
        self.radiance = as_rgb(radiance, "HalfSky: radiance")
        self.azimuth = as_array(azimuth)

    def eval(self, direction):
        """RGB radiance from unit world directions."""
        x, y, _ = components(direction)
        bright = jnp.cos(self.azimuth) * x + jnp.sin(self.azimuth) * y > 0
        return jnp.where(bright[..., None], self.radiance, 0.0)

    def sampler(self):
        """The sampler of directions: all are equally likely."""
        return UniformDirections(0.5 * stop_gradient(self.radiance))

    def turn(self):
        """The identity, with the derivative of the rotation about z that turns the sky."""
        angle = self.azimuth - stop_gradient(self.azimuth)
        about_z = jnp.asarray([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], angle.dtype)
        return jnp.eye(3, dtype=angle.dtype) + angle * about_z
