"""A pane of glass without thickness."""

import jax.numpy as jnp

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import components, scale, z_of
from jaxdr.scene.bsdf.base import DeltaSample, mirror
from jaxdr.scene.bsdf.dielectric import SmoothInterface
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric


@checked
class ThinDielectric(SmoothInterface):
    """A thin pane of glass: it reflects, and lets the rest go straight on.

    It stands for two parallel interfaces at the same place. If one of them reflects the share R, the pane reflects
    2 R / (1 + R): all orders of internal reflection are summed. Parameters and errors are those of `Dielectric`.
    """

    def sample_delta(self, wi, u):
        single = fresnel_dielectric(jnp.abs(z_of(wi)), self.eta).reflectance
        reflectance = 2.0 * single / (1.0 + single)
        reflected = components(u)[0] < reflectance
        probability = jnp.where(reflected, reflectance, 1.0 - reflectance)
        colour = jnp.where(reflected[..., None], self.specular_reflectance, self.specular_transmittance)
        wo = jnp.where(reflected[..., None], mirror(wi), -wi)
        return DeltaSample(wo, scale(colour, probability), probability)
