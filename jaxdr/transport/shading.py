"""BSDFs of a packed scene, at surface points."""

from collections.abc import Callable, Sequence
from functools import cached_property, reduce
from operator import or_
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import Frame, components, dot, from_components, orthonormal_basis, scale, z_of
from jaxdr.scene.bsdf.base import BSDF, DeltaSample, Rim, both_above, no_delta, only_delta, spreads_through
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave
from jaxdr.transport.texturing import bsdfs_at, tangents_along_u

HORIZON = 1e-6  # about 8 float32 roundings of the largest coordinate


class SampledSide(NamedTuple):
    """Bounds of sampled directions on one side of a surface, in its frame. Directions are within all bounds.

    Near the bound `first` the density is about in proportion to the distance from it.
    """

    first: Rim
    horizon: Rim
    second: Rim


class _Sampler(NamedTuple):
    """The BSDFs, their frame, and the direction `wi` in this frame."""

    groups: Sequence[tuple[BSDF, Bool[Array, " N"]]]
    frame: Frame
    wi: Float[Array, "N 3"]


def _either(condition: Bool[Array, " N"], one: Rim, two: Rim) -> Rim:
    """Row by row, one or the other."""
    return Rim(jnp.where(condition[:, None], one.axis, two.axis), jnp.where(condition, one.least, two.least))


class Materials(NamedTuple):
    """The materials of N points: whether they are two-sided, and (BSDF, which points have it) for every group."""

    two_sided: Bool[Array, " N"]
    groups: Sequence[tuple[BSDF, Bool[Array, " N"]]]


class Scatterer:
    """The BSDFs at N surface points for the directions `wi` towards the previous vertex (world space).

    Two-sided surfaces are turned to the side of `wi`, by the geometric normal. If an interpolated normal faces away
    from a visible surface, `wi` is mirrored into the hemisphere of that normal. Otherwise a black fringe would border
    silhouettes, and would move over the faces without any edge.

    `materials`: those of the points, if known.
    """

    def __init__(
        self, packed: PackedScene, point: SurfacePoint, wi: Float[Array, "N 3"], materials: Materials | None = None
    ):
        if materials is None:
            shape = packed.face_shape[point.face]
            materials = Materials(packed.two_sided[shape], bsdfs_at(packed, point, shape))
        self._packed, self.point, self._materials = packed, point, materials
        self.groups, self.smooth = materials.groups, packed.normals is not None
        behind = stop_gradient(dot(point.normal, wi)) < 0
        turned = behind & materials.two_sided
        flip = jnp.where(turned, -1.0, 1.0).astype(wi.dtype)
        self.normal = scale(point.normal, flip)
        normal = self.normal if packed.normals is None else scale(point.shading_normal, flip)
        s, t = tangents_along_u(packed, point) if packed.tangential else orthonormal_basis(normal)
        self.frame = Frame(s, t, normal)
        self.wi, self._mirrored = self.frame.to_local(wi), None
        if packed.normals is not None:
            x, y, z = components(self.wi)
            self._mirrored = (z < 0) != (behind & ~turned)
            self.wi = from_components(x, y, jnp.where(self._mirrored, -z, z))

    @cached_property
    def _still(self) -> "_Sampler":
        """Detached BSDFs for sampling: neither samples nor densities are differentiated."""
        return _Sampler(*stop_gradient((self.groups, self.frame, self.wi)))

    def seen_from(self, wi: Float[Array, "N 3"]) -> "Scatterer":
        """The same points for other directions `wi`."""
        return Scatterer(self._packed, self.point, wi, self._materials)

    def rows(self, pick: Callable[[Array], Array], wi: Float[Array, "M 3"]) -> "Scatterer":
        """M of the points, for directions `wi`. `pick` takes rows of arrays, so no material is looked up again."""
        return Scatterer(self._packed, jax.tree.map(pick, self.point), wi, jax.tree.map(pick, self._materials))

    def _combine(self, values) -> Array:
        """The value of the group each point belongs to."""
        if len(values) == 1:
            return values[0]
        total = jnp.zeros_like(values[0])
        for value, (_, member) in zip(values, self.groups, strict=True):
            total = total + jnp.where(member.reshape(member.shape + (1,) * (value.ndim - 1)), value, 0.0)
        return total

    def eval(self, wo: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        """f_s |cos| for world directions `wo`."""
        local = self.frame.to_local(wo)
        return self._combine([bsdf.eval(self.wi, local) for bsdf, _ in self.groups])

    def may_scatter(self, wo: Float[Array, "N 3"]) -> Bool[Array, " N"]:
        """Whether `eval` may differ from zero for some values of the BSDFs' parameters, by geometry alone; detached."""
        still = self._still
        local = still.frame.to_local(stop_gradient(wo))
        may = [
            jnp.ones(wo.shape[:1], bool) if bsdf.transmissive else both_above(still.wi, local) & (not only_delta(bsdf))
            for bsdf, _ in still.groups
        ]
        return self._combine([m.astype(wo.dtype) for m in may]) > 0

    def pdf(self, wo: Float[Array, "N 3"]) -> Float[Array, " N"]:
        """Density of `sample` (solid angle), detached."""
        still = self._still
        local = still.frame.to_local(stop_gradient(wo))
        return self._combine([bsdf.pdf(still.wi, local) for bsdf, _ in still.groups])

    def sample(self, u: Float[Array, "N 2"]) -> Float[Array, "N 3"]:
        """World directions drawn from `pdf`, detached."""
        still = self._still
        return still.frame.to_world(self._combine([bsdf.sample(still.wi, u) for bsdf, _ in still.groups]))

    def sample_delta(self, u: Float[Array, "N 2"]) -> DeltaSample:
        """The delta lobes that `u` chooses, world directions; differentiable."""
        return self._chosen([bsdf.sample_delta(self.wi, u) if bsdf.delta else None for bsdf, _ in self.groups])

    def adjoint_delta(self, u: Float[Array, "N 2"]) -> DeltaSample:
        """The same for light that arrives from `wi` and leaves towards `wo`: see `BSDF.adjoint_delta`."""
        return self._chosen([bsdf.adjoint_delta(self.wi, u) if bsdf.delta else None for bsdf, _ in self.groups])

    def _chosen(self, samples: list[DeltaSample | None]) -> DeltaSample:
        chosen = [no_delta(self.wi) if sample is None else sample for sample in samples]
        local = DeltaSample(*(self._combine(list(values)) for values in zip(*chosen, strict=True)))
        return local._replace(wo=self.frame.to_world(local.wo))

    def delta_reverses(self, onwards: "Scatterer", wo: Float[Array, "N 3"]) -> Bool[Array, " N"]:
        """Whether delta lobes from `wi` to `wo` are also lobes from `wo` to `wi`; `onwards`: this, seen from `wo`.

        They are not if an interpolated normal faces away from either direction.
        """
        local = self.frame.to_local(wo)
        found = [bsdf.delta_reverses(self.wi, local) for bsdf, _ in self.groups]
        reverses = self._combine([r.astype(wo.dtype) for r in found]) > 0
        if self._mirrored is None or onwards._mirrored is None:
            return reverses
        return reverses & ~self._mirrored & ~onwards._mirrored

    def sampled_pdf(self, wo: Float[Array, "N 3"], u: Float[Array, "N 2"]) -> Float[Array, " N"]:
        """`pdf` of the directions that `sample` drew from `u`; zero where `u` chooses a delta lobe instead."""
        pdf = self.pdf(wo)
        if not any(bsdf.delta for bsdf, _ in self.groups):
            return pdf
        return jnp.where(self.sample_delta(u).probability > 0, 0.0, pdf)

    def spreads(self) -> Bool[Array, " N"]:
        """Whether BSDFs have other lobes than delta lobes."""
        one = jnp.ones(self.wi.shape[:1], self.wi.dtype)
        return self._combine([one * (not only_delta(bsdf)) for bsdf, _ in self.groups]) > 0

    def lobe_width(self) -> Float[Array, " N"]:
        """Angle (radians) over which the BSDFs change little around sampled directions, detached."""
        still = self._still
        return self._combine([bsdf.lobe_width(still.wi) for bsdf, _ in still.groups])

    def cosine(self, w: Float[Array, "N 3"]) -> Float[Array, " N"]:
        """Component of world directions along the normal that the BSDF is evaluated for."""
        return dot(w, self.frame.z)

    def above_horizon(self, position: Float[Array, "N 3"]) -> Bool[Array, " N"]:
        """Whether positions are above the tangent planes by more than rounding.

        Edges of the surface itself are not. Their cosine is a rounding error, which would be noise after multiplication
        with the fast motion of a near edge across the view. Where light passes through the surface, positions below
        count as well.
        """
        height = self.cosine(position - stop_gradient(self.point.position)) * jnp.sign(z_of(self.wi))
        through = self.spreads_through()
        if through is not None:
            height = jnp.where(through, jnp.abs(height), height)
        return height > HORIZON * self.point.scale

    def spreads_through(self) -> Bool[Array, " N"] | None:
        """Whether BSDFs scatter light to both sides, apart from delta lobes; None if no BSDF of the scene does."""
        members = [member for bsdf, member in self.groups if spreads_through(bsdf)]
        return reduce(or_, members) if members else None

    def sampled_side(self, side: Float[Array, " N"]) -> SampledSide:
        """Bounds of sampled directions on the side of the normal (1) or the other side (-1) of the surface.

        For scenes where light goes through some surface.
        """
        zero = jnp.zeros_like(side)
        horizon = Rim(from_components(zero, zero, side), zero)
        unbounded = Rim(jnp.zeros_like(self.wi), -jnp.ones_like(side))
        beyond = side * z_of(self.wi) < 0
        first, second = [], []
        for bsdf, _ in self.groups:
            rims = bsdf.rims(self.wi) if spreads_through(bsdf) else (horizon, unbounded)
            first.append(_either(beyond, rims[0], horizon))
            second.append(_either(beyond, rims[1], unbounded))
        at_first, at_second = (
            Rim(self._combine([rim.axis for rim in rims]), self._combine([rim.least for rim in rims]))
            for rims in (first, second)
        )
        return SampledSide(at_first, horizon, at_second)

    def leave(self, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        """Origins of rays that leave the surface."""
        return leave(self.point, towards)

    def leave_scattering(self, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        """Origins of rays on the side that scatters; if both sides scatter, on the side of `towards`."""
        through = self.spreads_through()
        if through is None:
            return self.leave(self.normal)
        return self.leave(jnp.where(through[:, None], towards, self.normal))
