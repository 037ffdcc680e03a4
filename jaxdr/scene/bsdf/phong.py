"""Phong's model."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import Frame, components, dot, from_components, orthonormal_basis, scale, z_of
from jaxdr.scene.bsdf.base import BSDF, both_above, mirror
from jaxdr.scene.bsdf.parameters import Color, Number, Value, color, number
from jaxdr.scene.ranges import at_least, ranged
from jaxdr.scene.sampling import choose, cosine_hemisphere, lobe_probability
from jaxdr.scene.textures import Texture


@checked
class Phong(BSDF):
    """Phong's model in its reciprocal, energy-conserving form (Lafortune and Willems 1994); black from behind.

    f_s = `diffuse_reflectance` / pi + `specular_reflectance` (n + 2) / (2 pi) cos^n a. n is the `exponent`. a is the
    angle between wo and the mirror direction of wi (Mitsuba 0.x: `phong`). At normal incidence the reflectances are the
    shares of light that the two parts reflect. At grazing angles the part of the lobe below the horizon is lost.

    Raises ValueError where the sum of the reflectances may be above 1, or for a negative exponent.
    """

    diffuse_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    exponent: Number = eqx.field(metadata=ranged(0.0, math.inf))

    def __init__(self, diffuse_reflectance: Value = 0.5, specular_reflectance: Value = 0.2, exponent: Value = 30.0):
        self.diffuse_reflectance = color(diffuse_reflectance, "Phong: diffuse_reflectance")
        self.specular_reflectance = color(specular_reflectance, "Phong: specular_reflectance")
        self.exponent = number(exponent, "Phong: exponent")

    def check_together(self):
        total = most(self.diffuse_reflectance, self.specular_reflectance)
        if total is not None and total > 1.0 + 1e-5:
            raise ValueError(
                f"Phong: diffuse_reflectance and specular_reflectance reflect up to {total:.3g} together, more than 1"
            )

    def eval(self, wi, wo):
        above = both_above(wi, wo)
        cosine = jnp.where(above, z_of(wo), 0.0)
        lobe = self._lobe(wi, wo) * (self._exponent() + 2.0) / (2.0 * math.pi)
        return scale(self.diffuse_reflectance, cosine / math.pi) + scale(self.specular_reflectance, lobe * cosine)

    def pdf(self, wi, wo):
        above, chance = both_above(wi, wo), self._lobe_probability()
        lobe = self._lobe(wi, wo) * (self._exponent() + 1.0) / (2.0 * math.pi)
        return jnp.where(above, chance * lobe + (1.0 - chance) * z_of(wo) / math.pi, 0.0)

    def sample(self, wi, u):
        lobe, left = choose(u, jnp.broadcast_to(self._lobe_probability(), wi.shape[:-1]))
        first, second = components(left)
        cosine = jnp.power(1.0 - first, 1.0 / (self._exponent() + 1.0))
        radius, angle = jnp.sqrt(jnp.maximum(1.0 - cosine * cosine, 0.0)), 2.0 * math.pi * second
        axis = mirror(wi)
        s, t = orthonormal_basis(axis)
        around = Frame(s, t, axis).to_world(from_components(radius * jnp.cos(angle), radius * jnp.sin(angle), cosine))
        wo = jnp.where(lobe[..., None], around, cosine_hemisphere(left))
        return jnp.where(both_above(wi, wo)[..., None], wo, 0.0)  # the lobe reaches below the horizon

    def lobe_width(self, wi):
        """The angle at which a narrow lobe has fallen to 1 / e."""
        return jnp.broadcast_to(jnp.minimum(jnp.sqrt(2.0 / (self._exponent() + 1.0)), 1.0), wi.shape[:-1])

    def _lobe(self, wi, wo) -> Float[Array, "*n"]:
        """cos^n a; zero beyond a right angle."""
        cosine = dot(mirror(wi), wo)
        ahead = cosine > 0
        return jnp.where(ahead, jnp.power(jnp.where(ahead, cosine, 1.0), self._exponent()), 0.0)

    def _exponent(self) -> Float[Array, "*n"]:
        """No negative one, also for traced values: the lobe would have no bound."""
        return at_least(self.exponent, 0.0)

    def _lobe_probability(self) -> Float[Array, "*n"]:
        return lobe_probability(jnp.abs(self.specular_reflectance).mean(-1), jnp.abs(self.diffuse_reflectance).mean(-1))


def most(diffuse: Color, specular: Color) -> float | None:
    """Upper bound of the sum of two reflectances at any point; None where a traced one has no value."""
    tops = [_top(color) for color in (diffuse, specular)]
    return None if tops[0] is None or tops[1] is None else float((tops[0] + tops[1]).max())


def _top(color: Color) -> Float[np.ndarray, "3"] | None:
    if isinstance(color, Texture):
        known = color.extremes()
        return None if known is None else known[1]
    return None if isinstance(color, Tracer) else np.asarray(color)
