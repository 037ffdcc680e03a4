"""Lambertian reflection."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.scene.bsdf.base import BSDF, both_above
from jaxdr.scene.color import as_rgb
from jaxdr.scene.sampling import cosine_hemisphere


class Diffuse(BSDF):
    """Lambertian reflection with RGB `reflectance` (a number means grey); black from behind."""

    reflectance: Float[Array, "*n 3"]

    def __init__(self, reflectance: ArrayLike = 0.5):
        self.reflectance = as_rgb(reflectance, "Diffuse: reflectance")

    def eval(self, wi, wo):
        cosine = jnp.where(both_above(wi, wo), wo[..., 2], 0.0)
        return self.reflectance * (cosine / math.pi)[..., None]

    def pdf(self, wi, wo):
        return jnp.where(both_above(wi, wo), wo[..., 2], 0.0) / math.pi

    def sample(self, wi, u):
        return cosine_hemisphere(u)
