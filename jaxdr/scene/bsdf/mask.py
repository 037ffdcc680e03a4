"""Holes in a surface."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import scale
from jaxdr.scene.bsdf.base import BSDF, Adapter, DeltaSample, TwoSided
from jaxdr.scene.bsdf.parameters import Number, Value, number
from jaxdr.scene.ranges import ranged
from jaxdr.scene.sampling import choose, lobe_probability


@checked
class Mask(Adapter):
    """A surface with holes: the BSDF acts on the share `opacity`; through the rest light goes straight on.

    `opacity` is in [0, 1], and may be a texture. Both sides have the holes. For a two-sided BSDF write
    `TwoSided(Mask(opacity, bsdf))`. Holes are sampled with probability 1 - opacity, but at least 5 % and at most 95 %:
    the derivative by the opacity needs both.

    Raises ValueError for a two-sided BSDF inside, and values out of range.
    """

    opacity: Number = eqx.field(metadata=ranged(0.0, 1.0))
    bsdf: BSDF
    delta: ClassVar[bool] = True

    def __init__(self, opacity: Value, bsdf: BSDF | TwoSided):
        if not isinstance(bsdf, BSDF):
            inside = type(bsdf).__name__
            raise ValueError(f"Mask: bsdf can't be a {inside}; a two-sided one is TwoSided(Mask(opacity, bsdf))")
        self.opacity = number(opacity, "Mask: opacity")
        self.bsdf = bsdf

    def eval(self, wi, wo):
        return scale(self.bsdf.eval(wi, wo), self.opacity)

    def pdf(self, wi, wo):
        return (1.0 - self._hole_probability()) * self.bsdf.pdf(wi, wo)

    def sample(self, wi, u):
        return self.bsdf.sample(wi, choose(u, self._hole_probability())[1])

    def sample_delta(self, wi, u):
        return self._through_or(self.bsdf.sample_delta, wi, u)

    def adjoint_delta(self, wi, u):
        return self._through_or(self.bsdf.adjoint_delta, wi, u)

    def _through_or(self, sample: Callable[..., DeltaSample], wi, u) -> DeltaSample:
        """The delta lobe of a hole, or one of the BSDF inside."""
        chosen = self._hole_probability()
        hole, left = choose(u, chosen)
        inside = sample(wi, left)
        wo = jnp.where(hole[..., None], -wi, inside.wo)
        weight = jnp.where(hole[..., None], 1.0, inside.weight)
        share = jnp.where(hole, 1.0 - self.opacity, self.opacity)
        probability = jnp.where(hole, chosen, (1.0 - chosen) * inside.probability)
        return DeltaSample(wo, scale(weight, share), probability)

    def _hole_probability(self):
        return lobe_probability(1.0 - self.opacity, self.opacity)

    def rims(self, wi):
        return self.bsdf.rims(wi)
