"""The interface of a BSDF, in the local frame of a surface point (z along the shading normal).

All directions point away from the surface. A BSDF is written for points with a leading batch shape: fields carry
one row for every point when its methods are called (they are gathered by shape, and textures looked up). Choices are
static fields.
"""

import abc
import functools
import operator
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import from_components, z_of


class DeltaSample(NamedTuple):
    """One delta lobe of a BSDF: all light of one direction `wo` (unit), scattered into one direction.

    `weight` (RGB, no unit) is the radiance that leaves towards wi over that which arrives from `wo`; `probability` that
    this lobe is chosen, zero where the rest of the BSDF is (then `wo` and `weight` mean nothing). `wo` and `weight` are
    differentiable in wi and in the fields; the estimate is weight / probability, with the probability detached.
    """

    wo: Float[Array, "*n 3"]
    weight: Float[Array, "*n 3"]
    probability: Float[Array, "*n"]


class Rim(NamedTuple):
    """Where the directions end that are sampled: `axis` · wo > `least`. The axis needs no length."""

    axis: Float[Array, "*n 3"]
    least: Float[Array, "*n"]


class BSDF(eqx.Module):
    """Bidirectional scattering distribution function of one surface.

    `transmissive`: it tells the inside (wi.z < 0) from the outside and scatters through the surface; else it is black
    from behind. `tangential`: the x axis has to be along increasing u (the texture coordinate); else it may be any
    tangent. `inside`: the BSDFs that an `Adapter` is made of; only such may have any.
    """

    transmissive: ClassVar[bool] = False
    tangential: ClassVar[bool] = False
    inside: ClassVar[tuple["BSDF", ...]] = ()

    def __check_init__(self):
        if _bsdfs_in(self) and not isinstance(self, Adapter):
            raise TypeError(f"{type(self).__name__} holds a BSDF: make it a subclass of jaxdr.scene.bsdf.Adapter")

    @property
    def delta(self) -> bool:
        """Whether it has delta lobes, as those with a `sample_delta` do.

        `eval` and `pdf` leave them out, and `pdf` integrates to the probability that `sample_delta` chooses none of
        them, or to less where sampling fails.
        """
        return type(self).sample_delta is not BSDF.sample_delta

    @abc.abstractmethod
    def eval(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """f_s(wi, wo) |cos wo|, RGB; `wi` towards the previous vertex, `wo` the sampled side. Unit: 1/sr.

        For radiance that arrives from `wo`, as a path from the camera meets it: what is refracted is scaled by the
        squared ratio of indices (Veach 1997, 5.2).
        """

    @abc.abstractmethod
    def pdf(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Density of `sample` at `wo`, solid angle measure (1/sr)."""

    @abc.abstractmethod
    def sample(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit direction `wo` drawn from `pdf`; the zero vector, whose `pdf` is zero, where a sampler fails.

        Where `sample_delta` chooses a delta lobe for the same `u`, the direction means nothing.
        """

    def sample_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses, if it chooses one; for models with `delta`."""
        return no_delta(wi)

    def adjoint_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses for light that arrives from `wi`, as a path from an emitter meets it.

        Direction and probability are those of `sample_delta`. `weight` is the radiance that leaves towards `wo` over
        that which arrives from `wi`, times the solid angle at `wo` over that at `wi` which it comes from: of mirrors
        the same, and what is refracted is not scaled by the squared ratio of indices but by that of the cosines
        (Veach 1997, 5.2).
        """
        return self.sample_delta(wi, u)

    def delta_reverses(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
        """Whether `sample_delta` from `wo` can choose the delta lobe back to `wi`, where it chose `wo` from `wi`."""
        return jnp.ones(wi.shape[:-1], bool)

    def lobe_width(self, wi: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Angle (radians) over which `eval` and `pdf` change little around a sampled direction; at most 1.

        A matter of noise alone: how far from sampled directions line sampling looks for silhouettes. A model with
        several lobes gives the narrowest. Delta lobes don't count.
        """
        return jnp.ones(wi.shape[:-1], wi.dtype)

    def rims(self, wi: Float[Array, "*n 3"]) -> tuple[Rim, Rim]:
        """Bounds of the directions beyond the surface for which `pdf` is positive; for models that are `transmissive`.

        Both hold as well as the horizon. At the first the density goes to zero, about linearly (a matter of noise
        alone); at the second it may jump. Where there is more density than they say, light is lost. By default there
        is nothing but the horizon.
        """
        z = z_of(wi)
        zero = jnp.zeros_like(z)
        far = from_components(zero, zero, -jnp.sign(z))
        return Rim(far, zero), Rim(jnp.zeros_like(wi), -jnp.ones_like(z))


class DeltaBSDF(BSDF):
    """A BSDF of delta lobes alone."""

    def eval(self, wi, wo):
        return jnp.zeros_like(wo)

    def pdf(self, wi, wo):
        return jnp.zeros(wo.shape[:-1], wo.dtype)

    def sample(self, wi, u):
        return jnp.zeros_like(wi)

    @abc.abstractmethod
    def sample_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses."""


class Adapter(BSDF):
    """A BSDF made of others, such as the one in a mask or both of a blend. What is not said here has to be written."""

    @property
    def inside(self) -> tuple[BSDF, ...]:
        """The BSDFs that it is made of."""
        return tuple(_bsdfs_in(self))

    @property
    def transmissive(self) -> bool:
        return any(bsdf.transmissive for bsdf in self.inside)

    @property
    def delta(self) -> bool:
        return any(bsdf.delta for bsdf in self.inside)

    @property
    def tangential(self) -> bool:
        return any(bsdf.tangential for bsdf in self.inside)

    @abc.abstractmethod
    def sample_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses, if it chooses one."""

    @abc.abstractmethod
    def adjoint_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The same for light that arrives from `wi`."""

    def delta_reverses(self, wi, wo):
        reverses = [bsdf.delta_reverses(wi, wo) for bsdf in self.inside if bsdf.delta]
        return functools.reduce(operator.and_, reverses, jnp.ones(wi.shape[:-1], bool))

    def lobe_width(self, wi):
        return functools.reduce(jnp.minimum, [bsdf.lobe_width(wi) for bsdf in self.inside])


def _bsdfs_in(model: BSDF) -> list[BSDF]:
    """Those in the fields of a model, but not those inside of them."""
    leaves = jax.tree.leaves(model, is_leaf=lambda part: isinstance(part, BSDF) and part is not model)
    return [leaf for leaf in leaves if isinstance(leaf, BSDF)]


def only_delta(bsdf: BSDF) -> bool:
    """Whether a BSDF, with those inside it, has delta lobes alone."""
    return isinstance(bsdf, DeltaBSDF) or (bool(bsdf.inside) and bsdf.delta and all(map(only_delta, bsdf.inside)))


def has_lobe(bsdf: BSDF) -> bool:
    """Whether a BSDF, or one inside it, has a lobe that may be narrow and is no delta lobe: it says how wide."""
    if bsdf.inside:
        return any(map(has_lobe, bsdf.inside))
    return type(bsdf).lobe_width is not BSDF.lobe_width


def spreads_through(bsdf: BSDF) -> bool:
    """Whether a BSDF scatters light through the surface into more than single directions."""
    if bsdf.inside:
        return any(map(spreads_through, bsdf.inside))
    return bsdf.transmissive and not only_delta(bsdf)


class TwoSided(eqx.Module):
    """Adapter: the BSDF acts alike on both sides of the surface. It does not appear in names of parameters.

    Raises ValueError for a BSDF that lets light through, or is two-sided already.
    """

    bsdf: BSDF

    def __check_init__(self):
        if isinstance(self.bsdf, TwoSided):
            raise ValueError("TwoSided: the BSDF inside is two-sided already")
        if self.bsdf.transmissive:
            raise ValueError(f"TwoSided: {type(self.bsdf).__name__} lets light through and has two sides of its own")


def both_above(wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
    """Whether both directions are on the side of the normal."""
    return (z_of(wi) > 0) & (z_of(wo) > 0)


def mirror(wi: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """`wi` mirrored at the normal."""
    return wi * jnp.asarray([-1.0, -1.0, 1.0], wi.dtype)


def no_delta(wi: Float[Array, "*n 3"]) -> DeltaSample:
    """No delta lobe chosen."""
    return DeltaSample(wi, jnp.zeros_like(wi), jnp.zeros(wi.shape[:-1], wi.dtype))
