"""The interface of a BSDF, in the local frame of a surface point (z along the shading normal).

All directions point away from the surface. A BSDF is written for points with a leading batch shape: fields carry
one row for every point when its methods are called (`Scene` gathers them by shape).
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import normalize


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

    def turn(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """`wo` (detached) as it turns with the lobe when `wi` moves: `wo` in value, its derivative a rotation.

        By default the lobe stays where it is in the surface's frame. A rotation has the Jacobian one; whichever it is,
        a narrow lobe that is held fixed by it (`LineSampling.attached`) has the same derivative, with more noise where
        it does not follow. Of the BSDF's own parameters it is a constant.
        """
        return wo


class TwoSided(eqx.Module):
    """Adapter: the BSDF acts alike on both sides of the surface. Parameter names pass through it."""

    bsdf: BSDF

    def __check_init__(self):
        if isinstance(self.bsdf, TwoSided):
            raise ValueError("TwoSided: the BSDF inside is two-sided already")


def both_above(wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
    """Whether both directions are on the side of the normal."""
    return (wi[..., 2] > 0) & (wo[..., 2] > 0)


def turn_with_reflection(wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """`BSDF.turn` of lobes around the mirror direction: the least rotation that takes that along, to first order."""
    mirror = wi * jnp.asarray([-1.0, -1.0, 1.0], wi.dtype)
    axis = jnp.cross(stop_gradient(mirror), mirror)
    return normalize(wo + jnp.cross(axis, wo))
