"""Light from a point into a cone."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array, on_host
from jaxdr.geometry.vector import Frame, components, cross, dot, from_components, normalize, orthonormal_basis, scale
from jaxdr.scene.color import as_rgb, magnitude
from jaxdr.scene.lights.base import DeltaLight, check_direction, vector
from jaxdr.scene.lights.projector import bilinear
from jaxdr.scene.ranges import floats, ranged, within

LEAST_ANGLE = 1e-3  # degrees: a cone has to have directions
WIDEST = 0.499 * math.pi  # of a cone with a texture, whose screen has no end at a right angle


class Cone(DeltaLight):
    """The base class of lights that shine into a cone. Its parameters are those of `SpotLight`."""

    position: Float[Array, "*n 3"]
    direction: Float[Array, "*n 3"]
    intensity: Float[Array, "*n 3"]
    cutoff_angle: Float[Array, "*n"] = eqx.field(metadata=ranged(0.0, 180.0, unit="degrees"))
    beam_width: Float[Array, "*n"] = eqx.field(metadata=ranged(0.0, 180.0, unit="degrees"))

    def __init__(self, position, direction, intensity, cutoff_angle, beam_width):
        kind = type(self).__name__
        self.position = vector(position, f"{kind}: position")
        self.direction = vector(direction, f"{kind}: direction")
        self.intensity = as_rgb(intensity, f"{kind}: intensity")
        self.cutoff_angle = as_array(cutoff_angle)
        self.beam_width = as_array(0.75 * on_host(self.cutoff_angle) if beam_width is None else beam_width)
        for name in ("cutoff_angle", "beam_width"):
            if getattr(self, name).shape != ():
                raise ValueError(f"{kind}: {name} must be a number (degrees)")

    def check_together(self):
        kind = type(self).__name__
        check_direction(self.direction, f"{kind}: direction")
        if not any(isinstance(angle, Tracer) for angle in (self.cutoff_angle, self.beam_width)):
            beam, cutoff = float(self.beam_width), float(self.cutoff_angle)
            if not 0 <= beam < cutoff <= 180:
                raise ValueError(
                    f"{kind}: need 0 <= beam_width < cutoff_angle <= 180 (degrees), got {beam:g} and {cutoff:g}"
                )

    def place(self):
        return self.position

    def borders(self):
        return None

    def within(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """RGB intensity (W / sr) of the cone without a texture."""
        cutoff, beam = self._angles()
        cosine = dot(direction, normalize(self.direction))
        within, lit = cosine >= jnp.cos(beam), cosine > jnp.cos(cutoff)
        fades = lit & ~within
        angle = jnp.arccos(jnp.where(fades, jnp.clip(cosine, -1.0, 1.0), 0.0))
        width = jnp.where(cutoff > beam, cutoff - beam, 1.0)
        share = jnp.where(fades, (cutoff - angle) / width, jnp.where(within, 1.0, 0.0))
        return scale(self.intensity, share)

    def power(self, radius):
        del radius
        cutoff, beam = map(jnp.cos, self._angles())
        return 2.0 * math.pi * (1.0 - 0.5 * (cutoff + beam)) * magnitude(self.intensity)

    def sample(self, u):
        axis = stop_gradient(normalize(self.direction))
        # `height` is 1 - cos, which is accurate for narrow cones.
        first, second = components(u)
        height = first * self._opening()
        radius, angle = jnp.sqrt(height * (2.0 - height)), 2.0 * math.pi * second
        s, t = orthonormal_basis(axis)
        local = from_components(radius * jnp.cos(angle), radius * jnp.sin(angle), 1.0 - height)
        return Frame(s, t, axis).to_world(local)

    def pdf(self, direction):
        axis, opening = stop_gradient(normalize(self.direction)), self._opening()
        inside = dot(stop_gradient(direction), axis) > 1.0 - opening
        return jnp.where(inside, 1.0 / (2.0 * math.pi * opening), 0.0)

    def _opening(self) -> Float[Array, "*n"]:
        """1 - cos of the cutoff angle, detached."""
        return 2.0 * jnp.sin(0.5 * stop_gradient(self._angles()[0])) ** 2

    def _angles(self) -> tuple[Float[Array, "*n"], Float[Array, "*n"]]:
        """(cutoff angle, beam width), radians; for traced values the nearest that are allowed."""
        cutoff = within(self.cutoff_angle, LEAST_ANGLE, 180.0)
        return jnp.deg2rad(cutoff), jnp.deg2rad(within(self.beam_width, 0.0, cutoff))


@checked
class SpotLight(Cone):
    """A cone of light from `position` along `direction` (of any length), with RGB `intensity` (W / sr).

    The intensity is full within `beam_width` of the axis (degrees; default: 3/4 of the cutoff angle). From there it
    falls linearly with the angle, to zero at `cutoff_angle`, as in Mitsuba.

    Raises ValueError unless 0 <= beam_width < cutoff_angle <= 180, and for a direction of zero length.
    """

    def __init__(
        self,
        position: ArrayLike,
        direction: ArrayLike,
        intensity: ArrayLike = 1.0,
        cutoff_angle: ArrayLike = 20.0,
        beam_width: ArrayLike | None = None,
    ):
        super().__init__(position, direction, intensity, cutoff_angle, beam_width)

    def intensity_in(self, direction):
        return self.within(direction)


@checked
class TexturedSpotLight(Cone):
    """A spot light whose intensity is multiplied by an image [H, W, 3], as by a slide in front of it.

    - `texture` [H, W, 3]: linear RGB. Values are interpolated between texel centres, and repeat beyond the image.
    - `up` [3], of any length: says how the image is turned. The frame has z along `direction`, y along the part of `up`
      across the direction, and x so that it is right-handed.
    - The other parameters are those of `SpotLight`, with a cutoff angle below 90 degrees.

    Think of a screen across the axis. The cone meets it in a circle, and the image fills the square around that circle.
    The top row of the image is at negative y of the frame.

    Raises ValueError for an image that is not RGB, for a wider cone, and for an `up` along the direction.
    """

    texture: Float[Array, "H W 3"]
    up: Float[Array, "3"]
    stackable = False

    def __init__(
        self,
        position: ArrayLike,
        direction: ArrayLike,
        texture: ArrayLike,
        up: ArrayLike,
        intensity: ArrayLike = 1.0,
        cutoff_angle: ArrayLike = 20.0,
        beam_width: ArrayLike | None = None,
    ):
        super().__init__(position, direction, intensity, cutoff_angle, beam_width)
        self.texture = as_array(floats(texture, "TexturedSpotLight: texture"))
        self.up = vector(up, "TexturedSpotLight: up")
        if self.texture.ndim != 3 or self.texture.shape[2] != 3 or not self.texture.size:
            raise ValueError(f"TexturedSpotLight: texture must be an RGB image [H, W, 3], got {self.texture.shape}")

    def check_together(self):
        super().check_together()
        if not isinstance(self.cutoff_angle, Tracer) and float(self.cutoff_angle) >= 90:
            raise ValueError(f"TexturedSpotLight: cutoff_angle must be below 90, got {float(self.cutoff_angle):g}")
        if not any(isinstance(axis, Tracer) for axis in (self.up, self.direction)):
            if not np.any(np.cross(np.asarray(self.up), np.asarray(self.direction))):
                raise ValueError("TexturedSpotLight: up must not be along the direction")

    def intensity_in(self, direction):
        height, width, _ = self.texture.shape
        z = normalize(self.direction)
        x = normalize(cross(self.up, z))
        across, down, ahead = dot(direction, x), dot(direction, cross(z, x)), dot(direction, z)
        lit = ahead > 0
        reach = 2.0 * jnp.where(lit, ahead, 1.0) * jnp.tan(jnp.minimum(self._angles()[0], WIDEST))
        column, row = (
            (0.5 + jnp.where(lit, part, 0.0) / reach) * size for part, size in ((across, width), (down, height))
        )
        return self.within(direction) * bilinear(self.texture, from_components(column, row), "repeat")

    def power(self, radius):
        return super().power(radius) * magnitude(self.texture).mean()
