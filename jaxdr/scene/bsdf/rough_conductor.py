"""Rough metal: microfacet reflection."""

import math

import equinox as eqx
import jax.numpy as jnp

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import scale
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.bsdf.fresnel import fresnel_conductor
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS, Alpha, along_and_across, mirrored_width, reflect, reflection
from jaxdr.scene.bsdf.parameters import (
    ALPHA,
    Color,
    Number,
    Value,
    color,
    complex_index,
    distribution_name,
    number,
    optional_number,
)
from jaxdr.scene.ranges import ranged


@checked
class RoughConductor(BSDF):
    """Rough metal: microfacets that are small mirrors (Walter et al. 2007, Eq. 20); black from behind.

    - `alpha`: roughness of the facets, the same in all directions.
    - `alpha_v`: if given, `alpha` is the roughness along increasing u, and `alpha_v` the one across. Such a surface
      needs UVs.
    - `distribution`: that of the facets, "ggx" or "beckmann".
    - `material`, `eta`, `k`, `specular_reflectance`: those of `Conductor`.

    Light scattered between facets is lost, as in Mitsuba 3. Raises ValueError as `Conductor` does, and for an unknown
    distribution.
    """

    alpha: Number = eqx.field(metadata=ranged(*ALPHA))
    eta: Color = eqx.field(metadata=ranged(0.0, math.inf))
    k: Color = eqx.field(metadata=ranged(0.0, math.inf))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    alpha_v: Number | None = eqx.field(metadata=ranged(*ALPHA))
    distribution: str = eqx.field(static=True)

    def __init__(
        self,
        alpha: Value = 0.1,
        material: str | None = None,
        *,
        eta: Value | None = None,
        k: Value | None = None,
        specular_reflectance: Value = 1.0,
        distribution: str = "ggx",
        alpha_v: Value | None = None,
    ):
        self.alpha = number(alpha, "RoughConductor: alpha")
        self.eta, self.k = complex_index(material, eta, k, "RoughConductor")
        self.specular_reflectance = color(specular_reflectance, "RoughConductor: specular_reflectance")
        self.alpha_v = optional_number(alpha_v, "RoughConductor: alpha_v")
        self.distribution = distribution_name(distribution, "RoughConductor")

    @property
    def tangential(self) -> bool:
        return self.alpha_v is not None

    def eval(self, wi, wo):
        facets = reflection(self.distribution, self._facets(), wi, wo, both_above(wi, wo))
        fresnel = fresnel_conductor(facets.cosine, self.eta, self.k)
        return scale(self.specular_reflectance * fresnel, facets.value)

    def pdf(self, wi, wo):
        return reflection(self.distribution, self._facets(), wi, wo, both_above(wi, wo)).pdf

    def sample(self, wi, u):
        return reflect(wi, DISTRIBUTIONS[self.distribution].sample(wi, self._facets(), u))

    def lobe_width(self, wi):
        return jnp.broadcast_to(mirrored_width(self._facets()), wi.shape[:-1])

    def _facets(self) -> Alpha:
        return along_and_across(self.alpha, self.alpha_v)
