"""Rough plastic: a diffuse base below a rough dielectric coat."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import scale, z_of
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.bsdf.coat import HIGHEST_ETA, internal_reflectance, transmittance
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS, SMOOTHEST, mirrored_width, reflect, reflection
from jaxdr.scene.bsdf.parameters import (
    ALPHA,
    Color,
    Index,
    Number,
    Value,
    color,
    distribution_name,
    number,
    relative_index,
)
from jaxdr.scene.bsdf.plastic import coat_probability, coated
from jaxdr.scene.ranges import at_least, ranged, within
from jaxdr.scene.sampling import choose, cosine_hemisphere


@checked
class RoughPlastic(BSDF):
    """A diffuse base under a rough clear coat; black from behind (Mitsuba 3's `roughplastic`).

    `alpha` and `distribution` are those of `RoughConductor`, for the coat. int_ior / ext_ior is in [1, 2.5]. The other
    parameters are those of `Plastic`. The shares of light that the coat lets in, lets out and reflects back inside are
    integrals over its facets (`jaxdr.scene.bsdf.coat`). Mitsuba's own integrals are 2 % off for small alpha.

    Raises ValueError as `Plastic` does, and for an unknown distribution.
    """

    diffuse_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    alpha: Number = eqx.field(metadata=ranged(*ALPHA))
    eta: Float[Array, "*n"] = eqx.field(metadata=ranged(1.0, HIGHEST_ETA))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    distribution: str = eqx.field(static=True)
    nonlinear: bool = eqx.field(static=True)

    def __init__(
        self,
        diffuse_reflectance: Value = 0.5,
        alpha: Value = 0.1,
        int_ior: Index = "polypropylene",
        ext_ior: Index = "air",
        *,
        specular_reflectance: Value = 1.0,
        distribution: str = "ggx",
        nonlinear: bool = False,
    ):
        self.diffuse_reflectance = color(diffuse_reflectance, "RoughPlastic: diffuse_reflectance")
        self.alpha = number(alpha, "RoughPlastic: alpha")
        self.eta = relative_index(int_ior, ext_ior, "RoughPlastic", 1.0, HIGHEST_ETA)
        self.specular_reflectance = color(specular_reflectance, "RoughPlastic: specular_reflectance")
        self.distribution = distribution_name(distribution, "RoughPlastic")
        self.nonlinear = nonlinear

    def eval(self, wi, wo):
        above = both_above(wi, wo)
        facets = reflection(self.distribution, self._facets(), wi, wo, above)
        coat = fresnel_dielectric(facets.cosine, self._index()).reflectance * facets.value
        leaving = 1.0 - internal_reflectance(self.distribution, self._facets(), self._index())
        base = coated(self.diffuse_reflectance, leaving, self.nonlinear)
        share = self._transmittance(wi) * self._transmittance(wo) * z_of(wo) / (math.pi * self._index() * self._index())
        return scale(self.specular_reflectance, coat) + scale(base, jnp.where(above, share, 0.0))

    def pdf(self, wi, wo):
        above, chance = both_above(wi, wo), self._coat_probability(wi)
        facets = reflection(self.distribution, self._facets(), wi, wo, above)
        return chance * facets.pdf + (1.0 - chance) * jnp.where(above, z_of(wo), 0.0) / math.pi

    def sample(self, wi, u):
        facets, left = choose(u, self._coat_probability(wi))
        mirrored = reflect(wi, DISTRIBUTIONS[self.distribution].sample(wi, self._facets(), left))
        return jnp.where(facets[..., None], mirrored, cosine_hemisphere(left))

    def lobe_width(self, wi):
        """The width of the coat's lobe, whatever share of the light it reflects."""
        return jnp.broadcast_to(mirrored_width(self._facets()), wi.shape[:-1])

    def _facets(self) -> Float[Array, "*n"]:
        return at_least(self.alpha, SMOOTHEST)

    def _index(self) -> Float[Array, "*n"]:
        """The index within the tables of the coat, also for traced values."""
        return within(self.eta, 1.0, HIGHEST_ETA)

    def _transmittance(self, w) -> Float[Array, "*n"]:
        return transmittance(self.distribution, self._facets(), self._index(), jnp.abs(z_of(w)))

    def _coat_probability(self, wi) -> Float[Array, "*n"]:
        reflected = 1.0 - self._transmittance(wi)
        return coat_probability(reflected, self.specular_reflectance, self.diffuse_reflectance)
