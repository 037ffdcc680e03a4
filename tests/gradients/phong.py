"""A lobe around the mirror direction for tests: as narrow as one likes, and simple enough for exact numbers."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

import jaxdr as jd
from jaxdr.geometry.vector import dot, orthonormal_basis
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.base import both_above


class Phong(BSDF):
    """f_s |cos| = reflectance (n + 1) / (2 pi) cos(a)^n, a the angle to the mirror direction, `width` 1 / sqrt(n)."""

    reflectance: Float[Array, "*n 3"]
    width: Float[Array, "*n"]

    def __init__(self, width: float, reflectance=1.0):
        self.reflectance = jd.Diffuse(reflectance).reflectance
        self.width = jnp.asarray(width, self.reflectance.dtype)

    def _mirror(self, wi):
        return wi * jnp.asarray([-1.0, -1.0, 1.0], wi.dtype)

    def pdf(self, wi, wo):
        exponent = self.width**-2
        cosine = dot(self._mirror(wi), wo)
        counts = both_above(wi, wo) & (cosine > 0)
        power = jnp.where(counts, cosine, 1.0) ** exponent
        return jnp.where(counts, (exponent + 1) / (2 * math.pi) * power, 0.0)

    def eval(self, wi, wo):
        return self.reflectance * self.pdf(wi, wo)[..., None]

    def sample(self, wi, u):
        cosine = (1.0 - u[..., 0]) ** (1.0 / (self.width**-2 + 1))
        sine, angle = jnp.sqrt(jnp.maximum(1.0 - cosine**2, 0.0)), 2 * math.pi * u[..., 1]
        mirror = self._mirror(wi)
        s, t = orthonormal_basis(mirror)
        across = jnp.cos(angle)[..., None] * s + jnp.sin(angle)[..., None] * t
        return cosine[..., None] * mirror + sine[..., None] * across

    def lobe_width(self, wi):
        return jnp.broadcast_to(jnp.minimum(1.5 * self.width, 1.0), wi[..., 0].shape)
