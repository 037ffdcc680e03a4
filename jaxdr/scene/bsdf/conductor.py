"""Smooth metal, which reflects as a mirror."""

import math

import equinox as eqx
import jax.numpy as jnp

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import z_of
from jaxdr.scene.bsdf.base import DeltaBSDF, DeltaSample, mirror
from jaxdr.scene.bsdf.fresnel import fresnel_conductor
from jaxdr.scene.bsdf.parameters import Color, Value, color, complex_index
from jaxdr.scene.ranges import ranged


@checked
class Conductor(DeltaBSDF):
    """A perfectly smooth metal with complex index `eta` - i `k` (RGB); black from behind.

    Give the name of a `material` ("Au", "Al", …), or `eta` and `k`. With neither it is a perfect mirror.
    `specular_reflectance` (RGB in [0, 1]) scales the reflection.

    Raises ValueError for an unknown material, for `eta` without `k`, and for values out of range.
    """

    eta: Color = eqx.field(metadata=ranged(0.0, math.inf))
    k: Color = eqx.field(metadata=ranged(0.0, math.inf))
    specular_reflectance: Color = eqx.field(metadata=ranged(0.0, 1.0))

    def __init__(
        self,
        material: str | None = None,
        *,
        eta: Value | None = None,
        k: Value | None = None,
        specular_reflectance: Value = 1.0,
    ):
        self.eta, self.k = complex_index(material, eta, k, "Conductor")
        self.specular_reflectance = color(specular_reflectance, "Conductor: specular_reflectance")

    def sample_delta(self, wi, u):
        above = z_of(wi) > 0
        reflectance = fresnel_conductor(jnp.abs(z_of(wi)), self.eta, self.k)
        weight = jnp.where(above[..., None], self.specular_reflectance * reflectance, 0.0)
        return DeltaSample(mirror(wi), weight, jnp.where(above, 1.0, 0.0).astype(wi.dtype))
