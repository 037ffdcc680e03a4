"""The interface of a BSDF, in the local frame of a surface point (z along the shading normal).

All directions point away from the surface. A BSDF is written for points with a leading batch shape: fields carry
one row for every point when its methods are called (`Scene` gathers them by shape).
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class BSDF(eqx.Module):
    """Bidirectional scattering distribution function of one surface."""

    @abc.abstractmethod
    def eval(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """f_s(wi, wo) |cos wo|, RGB; `wi` towards the previous vertex, `wo` the sampled side. Unit: 1/sr."""

    @abc.abstractmethod
    def pdf(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Density of `sample` at `wo`, solid angle measure (1/sr)."""

    @abc.abstractmethod
    def sample(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit direction `wo` drawn from `pdf`."""

    def lobe_width(self, wi: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Angle (radians) over which `eval` and `pdf` change little around a sampled direction; at most 1.

        A matter of noise alone: how far from sampled directions line sampling looks for silhouettes.
        """
        return jnp.ones_like(wi[..., 0])


class TwoSided(eqx.Module):
    """Adapter: the BSDF acts alike on both sides of the surface. Parameter names pass through it."""

    bsdf: BSDF

    def __check_init__(self):
        if isinstance(self.bsdf, TwoSided):
            raise ValueError("TwoSided: the BSDF inside is two-sided already")


def both_above(wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
    """Whether both directions are on the side of the normal."""
    return (wi[..., 2] > 0) & (wo[..., 2] > 0)
