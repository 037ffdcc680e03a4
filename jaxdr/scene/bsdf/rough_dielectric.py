"""Rough glass: microfacet reflection and refraction."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import dot, scale, z_of
from jaxdr.scene.bsdf.base import BSDF, Rim
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric, index
from jaxdr.scene.bsdf.microfacet import (
    DISTRIBUTIONS,
    Alpha,
    along_and_across,
    mirrored_width,
    narrowest,
    reflect,
    reflection,
    refract,
    transmission,
)
from jaxdr.scene.bsdf.parameters import (
    ALPHA,
    ETA,
    Color,
    Index,
    Number,
    Value,
    color,
    distribution_name,
    number,
    optional_number,
    relative_index,
)
from jaxdr.scene.ranges import ranged
from jaxdr.scene.sampling import choose, lobe_probability

CLOSEST = 1e-3  # of an index to 1: half vectors of closer ones are rounding
# Uniform numbers of a few facets, whose reflectance decides how often reflection is chosen. By symmetry half the range
# of the second number is enough.
PILOTS = np.stack(np.meshgrid([1 / 6, 3 / 6, 5 / 6], [1 / 8, 3 / 8]), -1).reshape(-1, 2)


@checked
class RoughDielectric(BSDF):
    """Frosted glass: microfacets that reflect and refract (Walter et al. 2007, Eq. 20 and 21).

    `alpha`, `alpha_v` and `distribution` are those of `RoughConductor`, the other parameters those of `Dielectric`.
    Light is scattered on both sides. Refracted radiance is scaled by the squared ratio of indices. A ratio within 0.001
    of 1 counts as 0.999 or 1.001, with derivative zero.

    Raises ValueError as these two do, and for equal indices inside and outside.
    """

    alpha: Number = eqx.field(metadata=ranged(*ALPHA))
    eta: Float[Array, "*n"] = eqx.field(metadata=ranged(*ETA))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    specular_transmittance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    alpha_v: Number | None = eqx.field(metadata=ranged(*ALPHA))
    distribution: str = eqx.field(static=True)
    transmissive = True

    def __init__(
        self,
        alpha: Value = 0.1,
        int_ior: Index = "bk7",
        ext_ior: Index = "air",
        *,
        specular_reflectance: Value = 1.0,
        specular_transmittance: Value = 1.0,
        distribution: str = "ggx",
        alpha_v: Value | None = None,
    ):
        self.alpha = number(alpha, "RoughDielectric: alpha")
        self.eta = relative_index(int_ior, ext_ior, "RoughDielectric")
        self.specular_reflectance = color(specular_reflectance, "RoughDielectric: specular_reflectance")
        self.specular_transmittance = color(specular_transmittance, "RoughDielectric: specular_transmittance")
        self.alpha_v = optional_number(alpha_v, "RoughDielectric: alpha_v")
        self.distribution = distribution_name(distribution, "RoughDielectric")

    def check_together(self):
        if not isinstance(self.eta, Tracer) and np.any(np.asarray(self.eta) == 1):
            raise ValueError("RoughDielectric: int_ior and ext_ior must differ; between equal media no facet refracts")

    @property
    def tangential(self) -> bool:
        return self.alpha_v is not None

    def eval(self, wi, wo):
        wi, wo, eta = self._seen_from_above(wi, wo)
        facets = reflection(self.distribution, self._facets(), wi, wo, (z_of(wi) > 0) & (z_of(wo) > 0))
        reflected = fresnel_dielectric(facets.cosine, eta).reflectance * facets.value
        transmitted = transmission(self.distribution, self._facets(), wi, wo, eta).value
        colours = self.specular_reflectance, self.specular_transmittance
        return scale(colours[0], reflected) + scale(colours[1], transmitted)

    def pdf(self, wi, wo):
        wi, wo, eta = self._seen_from_above(wi, wo)
        chance = self._reflection_probability(wi, eta)
        facets = reflection(self.distribution, self._facets(), wi, wo, (z_of(wi) > 0) & (z_of(wo) > 0))
        return chance * facets.pdf + (1.0 - chance) * transmission(self.distribution, self._facets(), wi, wo, eta).pdf

    def sample(self, wi, u):
        side = jnp.where(z_of(wi) < 0, -1.0, 1.0).astype(wi.dtype)
        wi, _, eta = self._seen_from_above(wi, wi)
        reflects, left = choose(u, self._reflection_probability(wi, eta))
        m = DISTRIBUTIONS[self.distribution].sample(wi, self._facets(), left)
        mirrored = reflect(wi, m)
        refracted, passes = refract(wi, m, eta)
        # A facet may send light to the wrong side of the surface. Such a sample fails: `pdf` does not count it.
        valid = jnp.where(reflects, z_of(mirrored) > 0, passes & (z_of(refracted) < 0))
        wo = scale(jnp.where(reflects[..., None], mirrored, refracted), side)
        return jnp.where(valid[..., None], wo, 0.0)

    def lobe_width(self, wi):
        """The width of the narrower lobe. Turning a facet turns refracted light by |1 - eta_i / eta_t| as much."""
        eta = self._index()
        relative = jnp.where(z_of(wi) > 0, 1.0 / eta, eta)
        alpha = self._facets()
        return jnp.minimum(mirrored_width(alpha), narrowest(alpha) * jnp.abs(1.0 - relative))

    def rims(self, wi):
        return refraction_rims(wi, self._index())

    def _index(self) -> Float[Array, "*n"]:
        """The relative index. No facet refracts between equal media, so one that is closer to 1 is the closest one."""
        eta = index(self.eta)
        closest = jnp.where(eta < 1, 1.0 - CLOSEST, 1.0 + CLOSEST).astype(eta.dtype)
        return jnp.where(jnp.abs(eta - 1.0) < CLOSEST, closest, eta)

    def _facets(self) -> Alpha:
        return along_and_across(self.alpha, self.alpha_v)

    def _seen_from_above(self, wi, wo):
        """(wi, wo, index beyond the surface over that on wi's side); both directions are negated where wi is below."""
        below, eta = z_of(wi) < 0, self._index()
        side = jnp.where(below, -1.0, 1.0).astype(wi.dtype)
        return scale(wi, side), scale(wo, side), jnp.where(below, 1.0 / eta, eta)

    def _reflection_probability(self, wi, eta) -> Float[Array, "*n"]:
        return reflection_probability(self._facets(), wi, eta)


def reflection_probability(alpha: Alpha, wi: Float[Array, "*n 3"], eta: Float[Array, "*#n"]) -> Float[Array, "*n"]:
    """Mean Fresnel reflectance of a few visible facets, kept away from 0 and 1. It need not be exact: GGX is enough."""
    pilots = jnp.asarray(PILOTS, wi.dtype)
    above = (z_of(wi) > 0)[..., None]  # the zero vector and grazing directions see no facets
    wi = jnp.where(above, wi, jnp.asarray([0.0, 0.0, 1.0], wi.dtype))[..., None, :]
    m = DISTRIBUTIONS["ggx"].sample(wi, jax.tree.map(lambda a: a[..., None], alpha), pilots)
    mean = fresnel_dielectric(jnp.abs(dot(wi, m)), eta[..., None]).reflectance.mean(-1)
    return lobe_probability(mean, 1.0 - mean)  # all pilots may reflect totally where other facets don't


def refraction_rims(wi: Float[Array, "*n 3"], eta: Float[Array, "*#n"]) -> tuple[Rim, Rim]:
    """Bounds of the directions that facets refract to (`BSDF.rims`); `eta` is the index inside over the one outside.

    The first bound is a cone around -wi: on it facets are seen edge-on from one side. Beyond the second bound facets
    would have to face down.
    """
    side = jnp.where(z_of(wi) < 0, -1.0, 1.0).astype(wi.dtype)
    eta = jnp.where(z_of(wi) < 0, 1.0 / eta, eta)
    # By Snell's law the normal of a facet is along ± (wi + eta wo), with minus where eta wo is the longer of the two.
    sign = jnp.where(eta > 1, -1.0, 1.0).astype(wi.dtype)
    up = scale(jnp.asarray([0.0, 0.0, 1.0], wi.dtype), side * sign)
    return Rim(-wi, jnp.minimum(eta, 1.0 / eta)), Rim(up, -sign * jnp.abs(z_of(wi)) / eta)
