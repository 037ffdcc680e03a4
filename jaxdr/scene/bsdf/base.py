"""The interface of a BSDF, in the local frame of a surface point (z along the shading normal).

All directions point away from the surface. A BSDF is written for points with a leading batch shape. When its methods
are called, its fields have one row for every point: they are gathered by shape, and textures are looked up. Choices,
such as a distribution, are static fields.
"""

import abc
import functools
import operator
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxdr.argument_kinds import checked
from jaxdr.geometry.vector import from_components, z_of
from jaxdr.scene.ranges import Parametric


class DeltaSample(NamedTuple):
    """One delta lobe of a BSDF: all light of one direction `wo` (unit), scattered into one direction.

    `weight` (RGB, no unit) is the radiance that leaves towards wi over that which arrives from `wo`. `probability` is
    that of choosing this lobe. It is zero where no delta lobe is chosen; then `wo` and `weight` mean nothing. `wo` and
    `weight` are differentiable in wi and in the fields. The estimate is weight / probability, with the probability
    detached.
    """

    wo: Float[Array, "*n 3"]
    weight: Float[Array, "*n 3"]
    probability: Float[Array, "*n"]


class Rim(NamedTuple):
    """A bound of the sampled directions wo: `axis` · wo > `least`. The axis need not have unit length."""

    axis: Float[Array, "*n 3"]
    least: Float[Array, "*n"]


class BSDF(Parametric, eqx.Module):
    """Bidirectional scattering distribution function of one surface.

    - `transmissive`: it tells the inside (wi.z < 0) from the outside, and may scatter light through the surface. Any
      other BSDF is black from behind.
    - `tangential`: its x axis has to be along increasing u (the texture coordinate). Otherwise it may be any tangent.
    - `inside`: the BSDFs that an `Adapter` is made of; empty for every other BSDF.

    Raises TypeError for a class that holds a BSDF and is no `Adapter`.
    """

    transmissive: ClassVar[bool] = False
    tangential: ClassVar[bool] = False
    inside: ClassVar[tuple["BSDF", ...]] = ()

    def __check_init__(self):
        if _bsdfs_in(self) and not isinstance(self, Adapter):
            raise TypeError(f"{type(self).__name__} holds a BSDF: make it a subclass of jaxdr.scene.bsdf.Adapter")

    @property
    def delta(self) -> bool:
        """Whether it has delta lobes: it has some if it defines `sample_delta`.

        `eval` and `pdf` leave them out. `pdf` integrates to the probability that `sample_delta` chooses none of them,
        or to less where sampling fails.
        """
        return type(self).sample_delta is not BSDF.sample_delta

    @abc.abstractmethod
    def eval(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """f_s(wi, wo) |cos wo|, RGB; `wi` towards the previous vertex, `wo` the sampled side. Unit: 1/sr.

        It is for radiance that arrives from `wo`, as on paths from the camera. Refracted radiance is scaled by the
        squared ratio of indices (Veach 1997, 5.2).
        """

    @abc.abstractmethod
    def pdf(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Density of `sample` at `wo`, solid angle measure (1/sr)."""

    @abc.abstractmethod
    def sample(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Unit direction `wo` drawn from `pdf`. Where sampling fails it is the zero vector, whose `pdf` is zero.

        The direction means nothing where `sample_delta` chooses a delta lobe for the same `u`.
        """

    def sample_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses, if it chooses one; for models with `delta`."""
        return no_delta(wi)

    def adjoint_delta(self, wi: Float[Array, "*n 3"], u: Float[Array, "*n 2"]) -> DeltaSample:
        """The delta lobe that `u` chooses for light that arrives from `wi`, as on paths from an emitter.

        Direction and probability are those of `sample_delta`. `weight` is the radiance that leaves towards `wo` over
        that which arrives from `wi`, times the solid angle at `wo` over the solid angle at `wi` that it comes from. For
        mirrors that is the weight of `sample_delta`. Refracted light is scaled by the ratio of the cosines, not by the
        squared ratio of indices (Veach 1997, 5.2).
        """
        return self.sample_delta(wi, u)

    def delta_reverses(self, wi: Float[Array, "*n 3"], wo: Float[Array, "*n 3"]) -> Bool[Array, "*n"]:
        """Whether `sample_delta` at `wo` can choose the delta lobe to `wi`, if at `wi` it chose the one to `wo`."""
        return jnp.ones(wi.shape[:-1], bool)

    def lobe_width(self, wi: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Angle (radians) over which `eval` and `pdf` change little around a sampled direction; at most 1.

        Line sampling looks for silhouettes within this angle of sampled directions. Only the noise depends on it. A
        model with several lobes gives the width of the narrowest. Delta lobes don't count.
        """
        return jnp.ones(wi.shape[:-1], wi.dtype)

    def rims(self, wi: Float[Array, "*n 3"]) -> tuple[Rim, Rim]:
        """Two bounds of the directions beyond the surface for which `pdf` is positive; for `transmissive` models.

        `pdf` is positive only where both bounds hold, and the horizon too. At the first bound the density goes to zero,
        about linearly; only the noise depends on that. At the second bound the density may jump. Light is lost if there
        is density outside the bounds. By default there is no bound but the horizon.
        """
        z = z_of(wi)
        zero = jnp.zeros_like(z)
        far = from_components(zero, zero, -jnp.sign(z))
        return Rim(far, zero), Rim(jnp.zeros_like(wi), -jnp.ones_like(z))


class DeltaBSDF(BSDF):
    """A BSDF that has delta lobes only."""

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
    """A BSDF made of others, such as a mask or a blend. Subclasses write the methods that are not defined here."""

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
        """The delta lobe that `u` chooses for light that arrives from `wi`, if it chooses one."""

    def delta_reverses(self, wi, wo):
        reverses = [bsdf.delta_reverses(wi, wo) for bsdf in self.inside if bsdf.delta]
        return functools.reduce(operator.and_, reverses, jnp.ones(wi.shape[:-1], bool))

    def lobe_width(self, wi):
        return functools.reduce(jnp.minimum, [bsdf.lobe_width(wi) for bsdf in self.inside])


def _bsdfs_in(model: BSDF) -> list[BSDF]:
    """The BSDFs in the fields of a model, but not those inside of these."""
    leaves = jax.tree.leaves(model, is_leaf=lambda part: isinstance(part, BSDF) and part is not model)
    return [leaf for leaf in leaves if isinstance(leaf, BSDF)]


def only_delta(bsdf: BSDF) -> bool:
    """Whether a BSDF and those inside it have delta lobes only."""
    return isinstance(bsdf, DeltaBSDF) or (bool(bsdf.inside) and bsdf.delta and all(map(only_delta, bsdf.inside)))


def has_lobe(bsdf: BSDF) -> bool:
    """Whether a BSDF, or one inside it, has a lobe that may be narrow but is no delta lobe: it defines `lobe_width`."""
    if bsdf.inside:
        return any(map(has_lobe, bsdf.inside))
    return type(bsdf).lobe_width is not BSDF.lobe_width


def spreads_through(bsdf: BSDF) -> bool:
    """Whether a BSDF scatters light through the surface into a range of directions."""
    if bsdf.inside:
        return any(map(spreads_through, bsdf.inside))
    return bsdf.transmissive and not only_delta(bsdf)


@checked
class TwoSided(eqx.Module):
    """Adapter that makes a BSDF act alike on both sides of the surface. Names of parameters do not mention it.

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
    """The mirror direction of `wi` about the normal."""
    return wi * jnp.asarray([-1.0, -1.0, 1.0], wi.dtype)


def no_delta(wi: Float[Array, "*n 3"]) -> DeltaSample:
    """What `sample_delta` returns where it chooses no delta lobe."""
    return DeltaSample(wi, jnp.zeros_like(wi), jnp.zeros(wi.shape[:-1], wi.dtype))
