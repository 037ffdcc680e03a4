"""A BSDF with a delta lobe, in one file: a mirror that stretches what is seen in it. See docs/write_a_bsdf.md."""

import jax.numpy as jnp

import jaxdr as jd
from jaxdr.geometry.vector import components, from_components, normalize, z_of
from jaxdr.scene.bsdf.base import DeltaSample
from jaxdr.scene.bsdf.parameters import Number, Value, number


class StretchedMirror(jd.DeltaBSDF):
    """Light leaves as from a mirror, but with `stretch` times the slope; black from behind."""

    stretch: Number

    def __init__(self, stretch: Value = 1.0):
        self.stretch = number(stretch, "StretchedMirror: stretch", 0.1, 10.0)

    def sample_delta(self, wi, u):
        """The direction that light towards `wi` comes from, the share of it, and the probability of this lobe."""
        above = z_of(wi) > 0
        x, y, z = components(wi)
        wo = normalize(from_components(-self.stretch * x, -self.stretch * y, z))
        return DeltaSample(wo, jnp.where(above[..., None], jnp.ones_like(wi), 0.0), above.astype(wi.dtype))
