"""Lambertian reflection."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxdr.argument_kinds import checked
from jaxdr.arrays import on_host
from jaxdr.callers_line import warn
from jaxdr.geometry.vector import scale, z_of
from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.bsdf.parameters import Color, Value, color
from jaxdr.scene.ranges import ranged
from jaxdr.scene.sampling import cosine_hemisphere
from jaxdr.scene.textures import Texture


@checked
class Diffuse(BSDF):
    """Lambertian reflection; black from behind.

    `reflectance` is RGB; a number means grey. It is in [0, 1] for a surface that conserves energy; a warning tells of
    more. Raises ValueError for values that are negative or not finite.
    """

    reflectance: Color = eqx.field(metadata=ranged(0.0, math.inf))

    def __init__(self, reflectance: Value = 0.5):
        self.reflectance = color(reflectance, "Diffuse: reflectance")
        values = None if isinstance(self.reflectance, Texture) else on_host(self.reflectance)
        if isinstance(values, np.ndarray) and values.max() > 1:
            got = values.tolist()
            warn(f"jaxdr: Diffuse: reflectance is {got}; above 1 a surface sends out more light than it gets")

    def eval(self, wi, wo):
        cosine = jnp.where(both_above(wi, wo), z_of(wo), 0.0)
        return scale(self.reflectance, cosine / math.pi)

    def pdf(self, wi, wo):
        return jnp.where(both_above(wi, wo), z_of(wo), 0.0) / math.pi

    def sample(self, wi, u):
        return cosine_hemisphere(u)
