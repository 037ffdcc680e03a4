"""Random chords through the far ends of path segments, and the weights of boundary points on them.

A chord has a centre c of density p(c) and an angle phi, uniform in [0, pi). The chords that cross a piece dl of a
boundary curve have their centres in a strip of area |sin(phi - phi_l)| dl dt (Cauchy-Crofton). So for any kernel k
whose integral over the chord through the boundary point mu is one,

    integral of f V dl  =  E_{c, phi} [ sum over crossings mu of  f(mu) V(mu) (pi / 2) k(c) / p(c) ].
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.emitter_planes import chord_inside
from jaxdr.boundary.shared.sampled_arcs import on_same_side, place, sampled_arc
from jaxdr.geometry.queries import UNBOUNDED
from jaxdr.geometry.vector import cross, dot, normalize, orthonormal_basis, scale, z_of
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import sample_emitting_surface
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.shading import Scatterer


class Chords(NamedTuple):
    """M chords from `first` to `last`, with the centre at the fraction `centre`; detached.

    `group` is as in `queries.sector_crossings`. Only `useful` chords are searched.
    """

    first: Float[Array, "M 3"]
    last: Float[Array, "M 3"]
    centre: Float[Array, " M"]
    group: Int[Array, " M"]
    useful: Bool[Array, " M"]

    def plane(self, apex: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
        """Unit normals of the sectors that the chords span with `apex`."""
        across = cross(self.first - apex, self.last - apex)
        return normalize(jnp.where(self.useful[:, None], across, 1.0))

    def in_sight(self, scatterer: Scatterer, centre: Float[Array, "M 3"], reach: Float[Array, " M"]) -> "Chords":
        """Only chords with a part above the horizon stay useful; all of them where light goes through the surface.

        For geodesic chords, within the angle `reach` (radians) of unit directions `centre`.
        """
        rises = scatterer.cosine(centre) * jnp.sign(z_of(scatterer.wi)) > -jnp.sin(reach)
        through = scatterer.spreads_through()
        return self._replace(useful=self.useful & (rises if through is None else rises | through))


def random_across(axis: Float[Array, "M 3"], u: Float[Array, " M"]) -> Float[Array, "M 3"]:
    """Unit vectors perpendicular to unit `axis` vectors; their angle is pi `u`, for `u` uniform in [0, 1)."""
    s, t = orthonormal_basis(axis)
    angle = math.pi * u
    return scale(s, jnp.cos(angle)) + scale(t, jnp.sin(angle))


class EmitterChords(NamedTuple):
    """Whole chords of emitters around `centre`, of density `pdf` (per area); `length` is the length on the emitter.

    For surfaces that scatter to both sides, chords end in the surface's plane: `part` is the length on the centre's
    side.
    """

    chords: Chords
    centre: SurfacePoint
    pdf: Float[Array, " M"]
    length: Float[Array, " M"]
    part: Float[Array, " M"] | None = None

    def weight(self) -> Float[Array, " M"]:
        """(pi / 2) k / p; zero where there is no chord."""
        return emitter_weight(self.pdf, self.length if self.part is None else self.part)


def emitter_chords(
    packed: PackedScene,
    group: Int[Array, " F"],
    apex: Float[Array, "M 3"],
    u: Float[Array, "M 3"],
    horizon: Float[Array, "M 3"] | None = None,
) -> EmitterChords:
    """Whole chords of emitters, in area measure: k = 1 / length, so that the weight does not depend on the centre.

    `horizon`, if given: normals of the planes through the apexes in which chords end, zero for those that do not.
    """
    sample, pdf = sample_emitting_surface(packed, u[:, :2])
    point, normal = stop_gradient(sample.position), stop_gradient(sample.normal)
    direction = random_across(normal, u[:, 2])
    first, last, length = chord_inside(packed, group, sample.face, point, direction)
    useful = (length > 0) & (pdf > 0) & (dot(apex - point, normal) > 0)
    part = None
    if horizon is not None:
        height, rise = dot(horizon, point - apex), dot(horizon, direction)
        ends = rise != 0
        meets = safe_divide(-height, rise, ends)
        low = jnp.where(ends & (meets < 0), meets, -jnp.inf)
        high = jnp.where(ends & (meets > 0), meets, jnp.inf)
        first, last, part = chord_inside(packed, group, sample.face, point, direction, low, high)
        useful &= part > 0
    whole = jnp.where(useful, last - first, 1.0)
    chords = Chords(
        first=point + scale(direction, first),
        last=point + scale(direction, last),
        centre=-first / whole,
        group=group[sample.face],
        useful=useful,
    )
    return EmitterChords(chords, sample, pdf, length, part)


def emitter_weight(pdf: Float[Array, " M"], length: Float[Array, " M"]) -> Float[Array, " M"]:
    """(pi / 2) k / p of whole chords of emitters; zero where there is none."""
    density = pdf * length
    return safe_divide(0.5 * math.pi, density, otherwise=0.0)


def emitter_rate(
    pdf: Float[Array, " M"],
    length: Float[Array, " M"],
    apex: Float[Array, "M 3"],
    point: Float[Array, "M 3"],
    normal: Float[Array, "M 3"],
    plane: Float[Array, "M 3"],
) -> Float[Array, " M"]:
    """Density with which a whole chord of an emitter crosses a boundary at `point`, in the plane with normal `plane`.

    The measure is |sin| dl dphi on the sphere of directions around the apex: length of the curve, angle of the plane,
    and the sine of the angle between both (1 / radian^2). On the emitter the density is pdf x length / pi. A linear map
    M takes the sphere to the emitter. Its determinant is d^2 / cos, and it stretches the chord by m. So |sin| dl dphi
    on the emitter is det(M)^2 / m^3 times that on the sphere.
    """
    distance2, slope, usable, towards = _slope(apex, point, normal)
    stretch2 = 1.0 + _tilt(normal, slope, cross(plane, towards)) ** 2
    area = distance2 / slope
    return jnp.where(usable, pdf * length / math.pi * area**2 / (distance2 * stretch2) ** 1.5, 0.0)


def angle_ratio(
    apex: Float[Array, "M 3"],
    point: Float[Array, "M 3"],
    normal: Float[Array, "M 3"],
    plane: Float[Array, "M 3"],
    tangent: Float[Array, "M 3"],
) -> Float[Array, " M"]:
    """|sin(phi - phi_l)| dphi on an emitter's plane over that on the sphere of directions around the apex.

    phi is the angle of a chord through `point`, in the plane with normal `plane`. phi_l is the angle of the boundary,
    which is the image of a line along `tangent`. The ratio is det(M)^2 / (m^3 l), with the names of `emitter_rate`; M
    stretches the boundary by l. It is positive.
    """
    _, slope, _, towards = _slope(apex, point, normal)
    seen = normalize(tangent - scale(towards, dot(tangent, towards)))
    chord2 = 1.0 + _tilt(normal, slope, cross(plane, towards)) ** 2
    boundary2 = 1.0 + _tilt(normal, slope, seen) ** 2
    return 1.0 / (slope**2 * chord2**1.5 * boundary2**0.5)


def _slope(apex, point, normal):
    """(squared distance, cosine at an emitter's point, whether the cosine is usable, unit direction to the point)."""
    offset = point - apex
    distance2 = dot(offset, offset)
    distance2 = jnp.where(distance2 > 0, distance2, 1.0)
    towards = normalize(offset)
    slope = dot(normal, towards)
    usable = slope != 0
    return distance2, jnp.where(usable, slope, 1.0), usable, towards


def _tilt(normal, slope, along):
    """Slope of the emitter along directions on the sphere: M stretches them by distance x sqrt(1 + tilt^2)."""
    return dot(normal, along) / slope


class LobeChords(NamedTuple):
    """Geodesic chords around directions from the BSDF: `centre` directions with density `pdf` (solid angle).

    Their half-length is `reach` (radians). They lie in planes with the unit normals `plane`.
    """

    centre: Float[Array, "M 3"]
    pdf: Float[Array, " M"]
    plane: Float[Array, "M 3"]
    reach: Float[Array, " M"]

    def chords(self, apex: Float[Array, "M 3"], far: Float[Array, ""]) -> Chords:
        """Chords for the search, of unbounded sectors; `far` is a distance larger than the scene."""
        ahead = scale(self.centre, far * jnp.cos(self.reach))
        aside = scale(cross(self.plane, self.centre), far * jnp.sin(self.reach))
        return Chords(
            first=apex + (ahead - aside),
            last=apex + (ahead + aside),
            centre=jnp.full_like(self.pdf, 0.5),
            group=jnp.full(self.pdf.shape, UNBOUNDED),
            useful=self.pdf > 0,
        )


def lobe_chords(scatterer: Scatterer, width: Float[Array, " M"], u: Float[Array, "M 3"]) -> LobeChords:
    """Chords in solid angle, of half-length `width` (radians), around BSDF-sampled directions."""
    centre = scatterer.sample(u[:, :2])
    return LobeChords(centre, scatterer.sampled_pdf(centre, u[:, :2]), random_across(centre, u[:, 2]), width)


def lobe_weight(scatterer: Scatterer, chords: LobeChords, boundary: Float[Array, "M 3"]) -> Float[Array, " M"]:
    """(pi / 2) k / p for boundary points in unit directions `boundary`, which the chords cross.

    k is proportional to the cosine at the sampled direction. This cancels the 1 / cosine in f / p near the horizon,
    below which nothing is sampled. k is normalised over the arc of centres whose chords reach the boundary point. On
    surfaces that scatter to both sides k is proportional to a function that is zero where p is; see `sampled_arc`.
    """
    if scatterer.spreads_through() is not None:
        return _two_sided_weight(scatterer, chords, boundary)
    mass = _arc(scatterer, chords.reach, chords.plane, boundary)
    height = scatterer.cosine(chords.centre)
    counts = (mass > 0) & (chords.pdf > 0) & (height * scatterer.cosine(boundary) > 0)
    return safe_divide(0.5 * math.pi * jnp.abs(height), mass * chords.pdf, counts, 0.0)


def lobe_rate(
    scatterer: Scatterer, reach: Float[Array, " M"], plane: Float[Array, "M 3"], boundary: Float[Array, "M 3"]
) -> Float[Array, " M"]:
    """The same as `emitter_rate` for a geodesic chord, approximately.

    It is exact where the density of centres is proportional to the kernel. An approximation suffices: only MIS weights,
    which add up to one, depend on it.
    """
    if scatterer.spreads_through() is not None:
        arc = sampled_arc(scatterer, boundary, normalize(cross(plane, boundary)), reach)
        height, mass = arc.at(jnp.zeros_like(reach)), arc.integral()
    else:
        height = jnp.abs(scatterer.cosine(boundary))
        mass = _arc(scatterer, reach, plane, boundary)
    usable = (height > 0) & (mass > 0)
    return jnp.where(usable, scatterer.pdf(boundary) * mass / (math.pi * jnp.where(usable, height, 1.0)), 0.0)


def _two_sided_weight(scatterer: Scatterer, chords: LobeChords, boundary: Float[Array, "M 3"]):
    """`lobe_weight` if some surfaces scatter to both sides."""
    along = normalize(cross(chords.plane, boundary))
    arc = sampled_arc(scatterer, boundary, along, chords.reach)
    if scatterer.smooth:  # else the horizon is that of the face
        low, high = on_same_side(scatterer, boundary, along, chords.centre, arc.low, arc.high)
        arc = arc._replace(low=low, high=high)
    t = place(boundary, along, chords.centre)
    kernel, mass = arc.at(t), arc.integral()
    counts = (mass > 0) & (kernel > 0) & (chords.pdf > 0) & arc.contains(t)
    return safe_divide(0.5 * math.pi * kernel, mass * chords.pdf, counts, 0.0)


def _arc(scatterer: Scatterer, reach, plane, boundary) -> Float[Array, " M"]:
    """Integral of the cosine over the arc of centres whose chords reach `boundary`, on its side of the horizon.

    `boundary` lies in the plane with normal `plane`.
    """
    height = scatterer.cosine(boundary)
    side = jnp.sign(height)
    along = normalize(cross(plane, boundary))
    a, b = jnp.abs(height), side * scatterer.cosine(along)
    horizon = jnp.arctan2(b, a)  # a cos t + b sin t > 0 within 90 degrees of it
    low, high = jnp.maximum(-reach, horizon - 0.5 * jnp.pi), jnp.minimum(reach, horizon + 0.5 * jnp.pi)
    there = (a > 0) & (high > low)
    mass = a * (jnp.sin(high) - jnp.sin(low)) - b * (jnp.cos(high) - jnp.cos(low))
    return jnp.where(there, mass, 0.0)
