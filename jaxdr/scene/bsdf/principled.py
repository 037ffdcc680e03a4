"""The reflecting part of Disney's principled model, with the parameters that glTF's materials carry."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry.vector import from_components, scale, z_of
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric, schlick_weight
from jaxdr.scene.bsdf.microfacet import DISTRIBUTIONS, mirrored_width, reflect, reflection
from jaxdr.scene.bsdf.parameters import Color, Number, Value, number, rgb
from jaxdr.scene.sampling import choose, cosine_hemisphere

SHARPEST = 1e-3  # alpha, as in Mitsuba


class Principled(BSDF):
    """The material of glTF files (Burley 2012, as Mitsuba 3's `principled`); black from behind.

    What is not metal has the exact Fresnel term. `base_color` (RGB), `metallic`, `roughness` and `specular` are in [0,
    1]. Mitsuba's other parameters are zero here. The facets are GGX with alpha = roughness^2, at least 0.001. At normal
    incidence 0.08 x `specular` is reflected: the default 0.5 gives glTF's 4 %. Where `specular` is exactly zero its
    derivative is taken as zero, since that of the index is infinite.
    """

    base_color: Color
    metallic: Number
    roughness: Number
    specular: Number

    def __init__(
        self,
        base_color: Value = 0.5,
        metallic: Value = 0.0,
        roughness: Value = 0.5,
        specular: Value = 0.5,
    ):
        self.base_color = rgb(base_color, "Principled: base_color")
        self.metallic = number(metallic, "Principled: metallic", 0.0, 1.0)
        self.roughness = number(roughness, "Principled: roughness", 0.0, 1.0)
        self.specular = number(specular, "Principled: specular", 0.0, 1.0)

    def eval(self, wi, wo):
        above = both_above(wi, wo)
        facets = reflection("ggx", self._alpha(), wi, wo, above)
        dielectric = fresnel_dielectric(facets.cosine, self._eta()).reflectance
        metal = self.base_color + scale(1.0 - self.base_color, schlick_weight(facets.cosine))
        grey = (1.0 - self.metallic) * dielectric
        fresnel = scale(metal, self.metallic) + from_components(grey, grey, grey)
        # Burley 2012, 5.3: a diffuse lobe with retro-reflection, by the factor 1 + `extreme` at grazing angles.
        extreme = 2.0 * self.roughness * facets.cosine * facets.cosine - 0.5
        diffuse = (1.0 + extreme * schlick_weight(z_of(wi))) * (1.0 + extreme * schlick_weight(z_of(wo)))
        diffuse = jnp.where(above, (1.0 - self.metallic) * diffuse * z_of(wo) / math.pi, 0.0)
        return scale(fresnel, facets.value) + scale(self.base_color, diffuse)

    def pdf(self, wi, wo):
        above, chance = both_above(wi, wo), self._facet_probability()
        facets = reflection("ggx", self._alpha(), wi, wo, above)
        return chance * facets.pdf + (1.0 - chance) * jnp.where(above, z_of(wo), 0.0) / math.pi

    def sample(self, wi, u):
        facets, left = choose(u, jnp.broadcast_to(self._facet_probability(), wi.shape[:-1]))
        mirrored = reflect(wi, DISTRIBUTIONS["ggx"].sample(wi, self._alpha(), left))
        return jnp.where(facets[..., None], mirrored, cosine_hemisphere(left))

    def lobe_width(self, wi):
        """Of the facets, whatever share of the light they reflect."""
        return jnp.broadcast_to(mirrored_width(self._alpha()), wi.shape[:-1])

    def _alpha(self) -> Float[Array, "*n"]:
        return jnp.maximum(self.roughness * self.roughness, SHARPEST)

    def _eta(self) -> Float[Array, "*n"]:
        amplitude = 0.08 * self.specular
        positive = amplitude > 0
        return 2.0 / (1.0 - jnp.where(positive, jnp.sqrt(jnp.where(positive, amplitude, 1.0)), 0.0)) - 1.0

    def _facet_probability(self) -> Float[Array, "*n"]:
        return 1.0 / (2.0 - self.metallic)
