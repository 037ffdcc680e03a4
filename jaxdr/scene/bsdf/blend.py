"""A mixture of two BSDFs."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import scale
from jaxdr.scene.bsdf.base import BSDF, Adapter, DeltaSample, TwoSided, both_above
from jaxdr.scene.bsdf.normal_map import TurnedNormal
from jaxdr.scene.bsdf.parameters import Number, Value, number
from jaxdr.scene.ranges import ranged
from jaxdr.scene.sampling import choose, lobe_probability


@checked
class Blend(Adapter):
    """A mixture of two BSDFs: 1 - `weight` of the `first` and `weight` of the `second` (Mitsuba 3's `blendbsdf`).

    `weight` is in [0, 1], and may be a texture. For two-sided BSDFs write `TwoSided(Blend(weight, first, second))`. A
    BSDF that lets light through can be mixed with one that is black from behind.

    Raises ValueError for two-sided BSDFs inside, and for two mirrors or smooth glasses of which one has a normal map.
    """

    weight: Number = eqx.field(metadata=ranged(0.0, 1.0))
    first: BSDF
    second: BSDF

    def __init__(self, weight: Value, first: BSDF | TwoSided, second: BSDF | TwoSided):
        for name, bsdf in (("first", first), ("second", second)):
            if not isinstance(bsdf, BSDF):
                inside = type(bsdf).__name__
                raise ValueError(
                    f"Blend: {name} can't be a {inside}; two-sided ones are TwoSided(Blend(weight, first, second))"
                )
            setattr(self, name, bsdf)
        if self.first.delta and self.second.delta and (_turns(self.first) or _turns(self.second)):
            # `delta_reverses` would have to know which of the two lobes a direction belongs to.
            raise ValueError(
                "Blend: two mirrors or smooth glasses can't have normal or bump maps of their own; put the map around "
                "the Blend"
            )
        self.weight = number(weight, "Blend: weight")

    def eval(self, wi, wo):
        return scale(self.first.eval(wi, wo), 1.0 - self.weight) + scale(self.second.eval(wi, wo), self.weight)

    def pdf(self, wi, wo):
        second = self._chance()
        return (1.0 - second) * self.first.pdf(wi, wo) + second * self.second.pdf(wi, wo)

    def sample(self, wi, u):
        second, left = choose(u, self._chance())
        one, two = self._sample(self.first, wi, left), self._sample(self.second, wi, left)
        return jnp.where(second[..., None], two, one)

    def _sample(self, bsdf: BSDF, wi, u):
        """A direction drawn from one of the two; the zero vector where that one is black but the other may not be."""
        wo = bsdf.sample(wi, u)
        if bsdf.transmissive or not self.transmissive:
            return wo
        return jnp.where(both_above(wi, wo)[..., None], wo, 0.0)

    def sample_delta(self, wi, u):
        return self._either(wi, u, lambda bsdf: bsdf.sample_delta)

    def adjoint_delta(self, wi, u):
        return self._either(wi, u, lambda bsdf: bsdf.adjoint_delta)

    def _either(self, wi, u, method: Callable[[BSDF], Callable[..., DeltaSample]]) -> DeltaSample:
        """A delta lobe of the BSDF that `u` chooses."""
        chosen = self._chance()
        second, left = choose(u, chosen)
        one, two = method(self.first)(wi, left), method(self.second)(wi, left)
        wo = jnp.where(second[..., None], two.wo, one.wo)
        weight = jnp.where(second[..., None], scale(two.weight, self.weight), scale(one.weight, 1.0 - self.weight))
        probability = jnp.where(second, chosen * two.probability, (1.0 - chosen) * one.probability)
        return DeltaSample(wo, weight, probability)

    def _chance(self):
        """Probability of sampling the second."""
        return lobe_probability(self.weight, 1.0 - self.weight)


def _turns(bsdf: BSDF) -> bool:
    """Whether a BSDF, or one inside it, turns normals."""
    return isinstance(bsdf, TurnedNormal) or any(map(_turns, bsdf.inside))
