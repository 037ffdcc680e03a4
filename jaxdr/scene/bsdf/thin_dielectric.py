"""A pane of glass without thickness."""

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.scene.bsdf.base import DeltaBSDF, DeltaSample, mirror
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric
from jaxdr.scene.bsdf.parameters import relative_index, rgb


class ThinDielectric(DeltaBSDF):
    """Two parallel smooth interfaces with nothing between them: a mirror, and light that goes straight through.

    With the reflectance R of one, 2 R / (1 + R) is reflected, all orders of internal reflection summed. Parameters are
    those of `Dielectric`.
    """

    eta: Float[Array, "*n"]
    specular_reflectance: Float[Array, "*n 3"]
    specular_transmittance: Float[Array, "*n 3"]
    transmissive = True

    def __init__(
        self,
        int_ior: ArrayLike | str = "bk7",
        ext_ior: ArrayLike | str = "air",
        *,
        specular_reflectance: ArrayLike = 1.0,
        specular_transmittance: ArrayLike = 1.0,
    ):
        self.eta = relative_index(int_ior, ext_ior, "ThinDielectric")
        self.specular_reflectance = rgb(specular_reflectance, "ThinDielectric: specular_reflectance")
        self.specular_transmittance = rgb(specular_transmittance, "ThinDielectric: specular_transmittance")

    def sample_delta(self, wi, u):
        single = fresnel_dielectric(jnp.abs(wi[..., 2]), self.eta).reflectance
        reflectance = 2.0 * single / (1.0 + single)
        reflected = u[..., 0] < reflectance
        probability = jnp.where(reflected, reflectance, 1.0 - reflectance)
        colour = jnp.where(reflected[..., None], self.specular_reflectance, self.specular_transmittance)
        wo = jnp.where(reflected[..., None], mirror(wi), -wi)
        return DeltaSample(wo, colour * probability[..., None], probability)
