"""Smooth glass, which reflects as a mirror and refracts."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import components, from_components, scale, z_of
from jaxdr.scene.bsdf.base import DeltaBSDF, DeltaSample, mirror
from jaxdr.scene.bsdf.fresnel import Interface, fresnel_dielectric
from jaxdr.scene.bsdf.parameters import ETA, Color, Index, Value, color, relative_index
from jaxdr.scene.ranges import ranged


class SmoothInterface(DeltaBSDF):
    """Parameters of smooth dielectrics, which have one delta lobe on either side. The normal points to the outside.

    `eta` = int_ior / ext_ior; each of the two is a number or a name ("bk7", "water", …). `specular_reflectance` and
    `specular_transmittance` (RGB in [0, 1]) scale the two lobes.
    """

    eta: Float[Array, "*n"] = eqx.field(metadata=ranged(*ETA))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    specular_transmittance: Color = eqx.field(metadata=ranged(0.0, 1.0))
    transmissive = True

    def __init__(
        self,
        int_ior: Index = "bk7",
        ext_ior: Index = "air",
        *,
        specular_reflectance: Value = 1.0,
        specular_transmittance: Value = 1.0,
    ):
        model = type(self).__name__
        self.eta = relative_index(int_ior, ext_ior, model)
        self.specular_reflectance = color(specular_reflectance, f"{model}: specular_reflectance")
        self.specular_transmittance = color(specular_transmittance, f"{model}: specular_transmittance")


@checked
class Dielectric(SmoothInterface):
    """Smooth glass or water: it reflects and refracts. The normal points to the outside.

    `eta` = int_ior / ext_ior, the index inside over the one outside. Each is a number or a name ("bk7", "water", …).
    `specular_reflectance` and `specular_transmittance` (RGB in [0, 1]) scale the two parts. Refracted radiance is
    scaled by the squared ratio of indices.

    Raises ValueError for an unknown name, a texture as an index, and values out of range.
    """

    def sample_delta(self, wi, u):
        interface = fresnel_dielectric(z_of(wi), self.eta)
        reflectance, eta_ti = interface.reflectance, interface.eta_ti
        return self._lobe(wi, u, interface, (1.0 - reflectance) * eta_ti * eta_ti)

    def adjoint_delta(self, wi, u):
        interface = fresnel_dielectric(z_of(wi), self.eta)
        passes = interface.cos_t > 0
        cosines = jnp.abs(z_of(wi)) / jnp.where(passes, interface.cos_t, 1.0)
        return self._lobe(wi, u, interface, jnp.where(passes, (1.0 - interface.reflectance) * cosines, 0.0))

    def _lobe(self, wi, u, interface: Interface, transmitted: Float[Array, "*n"]) -> DeltaSample:
        """The lobe that `u` chooses; `transmitted` is the weight of the refracted one."""
        reflectance, eta_ti = interface.reflectance, interface.eta_ti
        reflected = components(u)[0] < reflectance
        x, y, z = components(wi)
        refracted = from_components(-eta_ti * x, -eta_ti * y, -jnp.sign(z) * interface.cos_t)
        weight = jnp.where(
            reflected[..., None],
            scale(self.specular_reflectance, reflectance),
            scale(self.specular_transmittance, transmitted),
        )
        wo = jnp.where(reflected[..., None], mirror(wi), refracted)
        return DeltaSample(wo, weight, jnp.where(reflected, reflectance, 1.0 - reflectance))
