"""Smooth plastic: a diffuse base below a smooth dielectric coat."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import components, scale, z_of
from jaxdr.scene.bsdf.base import BSDF, DeltaSample, both_above, mirror
from jaxdr.scene.bsdf.fresnel import diffuse_transmittance, fresnel_dielectric, index
from jaxdr.scene.bsdf.parameters import ETA, Color, Index, Value, color, relative_index
from jaxdr.scene.ranges import ranged
from jaxdr.scene.sampling import choose, cosine_hemisphere, lobe_probability


@checked
class Plastic(BSDF):
    """A diffuse base under a smooth clear coat; black from behind (Mitsuba 3's `plastic`).

    - `diffuse_reflectance` (RGB in [0, 1]): of the base.
    - `int_ior`, `ext_ior`: index of the coat and index outside, each a number or a name; `eta` is their ratio.
    - `specular_reflectance` (RGB in [0, 1]): scales the reflection of the coat.
    - `nonlinear`: whether the bounces between base and coat change colours. Without it, every colour gains as much by
      them as white would.

    Raises ValueError for an unknown name, and values out of range.
    """

    diffuse_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    eta: Float[Array, "*n"] = eqx.field(metadata=ranged(*ETA))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    nonlinear: bool = eqx.field(static=True)

    def __init__(
        self,
        diffuse_reflectance: Value = 0.5,
        int_ior: Index = "polypropylene",
        ext_ior: Index = "air",
        *,
        specular_reflectance: Value = 1.0,
        nonlinear: bool = False,
    ):
        self.diffuse_reflectance = color(diffuse_reflectance, "Plastic: diffuse_reflectance")
        self.eta = relative_index(int_ior, ext_ior, "Plastic")
        self.specular_reflectance = color(specular_reflectance, "Plastic: specular_reflectance")
        self.nonlinear = nonlinear

    def eval(self, wi, wo):
        above = both_above(wi, wo)
        entering, leaving = (1.0 - fresnel_dielectric(jnp.abs(z_of(w)), self.eta).reflectance for w in (wi, wo))
        eta = index(self.eta)
        base = coated(self.diffuse_reflectance, diffuse_transmittance(1.0 / eta), self.nonlinear)
        share = entering * leaving * z_of(wo) / (math.pi * eta * eta)
        return scale(base, jnp.where(above, share, 0.0))

    def pdf(self, wi, wo):
        cosine = jnp.where(both_above(wi, wo), z_of(wo), 0.0)
        return (1.0 - self._mirror_probability(wi)) * cosine / math.pi

    def sample(self, wi, u):
        return cosine_hemisphere(choose(u, self._mirror_probability(wi))[1])

    def sample_delta(self, wi, u):
        probability = self._mirror_probability(wi)
        chosen = (components(u)[0] < probability) & (z_of(wi) > 0)
        reflectance = fresnel_dielectric(jnp.abs(z_of(wi)), self.eta).reflectance
        weight = scale(self.specular_reflectance, jnp.where(chosen, reflectance, 0.0))
        return DeltaSample(mirror(wi), weight, jnp.where(chosen, probability, 0.0))

    def _mirror_probability(self, wi) -> Float[Array, "*n"]:
        reflectance = fresnel_dielectric(jnp.abs(z_of(wi)), self.eta).reflectance
        return coat_probability(reflectance, self.specular_reflectance, self.diffuse_reflectance)


def coated(base: Float[Array, "*#n 3"], leaving: Float[Array, "*#n"], nonlinear: bool) -> Float[Array, "*n 3"]:
    """Reflectance of a diffuse base with all bounces between it and a coat, which the share `leaving` gets through."""
    return base / (1.0 - base + scale(base, leaving)) if nonlinear else scale(base, 1.0 / leaving)


def coat_probability(
    reflectance: Float[Array, "*#n"], specular: Float[Array, "*#n 3"], diffuse: Float[Array, "*#n 3"]
) -> Float[Array, "*n"]:
    """Probability of sampling the coat rather than the base, in proportion to what the two reflect."""
    return lobe_probability(reflectance * jnp.abs(specular).mean(-1), (1.0 - reflectance) * jnp.abs(diffuse).mean(-1))
