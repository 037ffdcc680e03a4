"""Light that a narrow lobe sends to a surface: its derivative from antithetic pairs of points.

A point x sees a glossy surface at y, which reflects an emitter at z: a caustic. If x moves by dx, the half vector at y
turns by dx / |x - y|. A lobe of width alpha changes by this angle over alpha. The change is positive on one side of the
lobe and negative on the other, so the derivative is small. But a path finds one side only, so the noise grows like
1 / alpha. Here every y is paired with its mirror image y' = 2 m - y in the plane of its face; m is where a mirror would
show z to x. Let F be the contribution, and q the density with which all samplers together find (y, z), per area
squared. Then

    [ dF(y, z) + dF(y', z) ] / [ q(y, z) + q(y', z) ]

replaces dF(y, z) / q(y, z). This is antithetic sampling of positions (Zhang et al. 2021, "Antithetic sampling for Monte
Carlo differentiable rendering"). Points stay material points, so boundary terms do not change.

It has no bias: m depends on x, z and the plane only. So for every z the map from y to y' is its own inverse and keeps
areas. S = dF + dF' is the same at y and y'. So the integral of q S / (q + q') is half the integral of S, which is the
integral of dF. Whether a point is in a pair is decided alike at y and y'. A point has no partner if x does not see its
image, or if the image is on no surface in the same plane with a narrow lobe.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import cross, dot, norm, normalize, scale
from jaxdr.scene.bsdf.base import has_lobe
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted, emitter_shares, emitting_surface_pdf, light_intensity
from jaxdr.transport.interaction import SurfacePoint, intersect, material_hit
from jaxdr.transport.near_field import Footprint
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.transfer import Transfer, Vertex, transfer_to, unoccluded

NARROW = 0.5  # radians: wider lobes change slowly
FLAT = 1e-5  # sine of the angle between faces, and distance from the plane as a share of the coordinates


class Previous(NamedTuple):
    """The previous vertices x of N paths, and whether the paths left them by a lobe that is no delta lobe (`spread`).

    `seen` and `apart` are for vertices that have two forms, as in `scatter`.
    """

    vertex: Vertex
    spread: Bool[Array, " N"]
    seen: Footprint | None
    apart: Float[Array, "N 3"] | None


class Ends(NamedTuple):
    """Emitters z that may light N vertices: points, or directions where `infinite`.

    - `drawn`: whether there is one.
    - `visible`: whether its light reaches the vertex and is scattered there.
    - `light`: number of the light without area, -1 for other emitters; None if the scene has no such lights.
    """

    point: SurfacePoint
    infinite: Bool[Array, " N"]
    direction: Float[Array, "N 3"]
    visible: Bool[Array, " N"]
    drawn: Bool[Array, " N"]
    light: Int[Array, " N"] | None

    @property
    def is_delta(self) -> Bool[Array, " N"] | None:
        """Whether emitters are lights without area; None if the scene has none."""
        return None if self.light is None else self.light >= 0


def has_pairs(packed: PackedScene) -> bool:
    """Whether any surface may have a narrow lobe, apart from delta lobes."""
    return any(has_lobe(group.bsdf) for group in packed.bsdfs)


def pair_derivatives(
    packed: PackedScene,
    previous: Previous,
    at: Vertex,
    scatterer: Scatterer,
    light: tuple[Float[Array, "N 3"], Ends],
    emission: tuple[Float[Array, "N 3"], Ends],
    settings: PathSettings,
) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """(`light` of emitter sampling, `emission` of BSDF sampling): the same values, with the derivatives of pairs.

    `scatterer`: the BSDFs at the vertices `at`, which are the y of the pairs.
    """
    values = jnp.concatenate([light[0], emission[0]])
    ends = jax.tree.map(lambda *x: jnp.concatenate(x), light[1], emission[1])
    previous = jax.tree.map(_twice, previous)
    before = Scatterer(packed, previous.vertex.point, previous.vertex.wi)
    own = scatterer.rows(_twice, _twice(at.wi))
    paired, first, other = _images(packed, previous, before, own, ends, settings)

    away = jnp.where(ends.infinite[:, None], ends.direction, first.towards)
    second = transfer_to(other, ends.point, ends.infinite | ~paired, away, ends.is_delta)
    lit = paired & (stop_gradient(second.cosine) > 0) & second.scatters(other, settings.black)
    lit = unoccluded(packed, other, ends.point, ends.infinite, second.towards, lit, settings.rays)
    contribution = previous.vertex.throughput * first.value * second.value * _radiance(packed, ends, second.towards)
    contribution = jnp.where(lit[:, None], contribution, 0.0)

    arrives = stop_gradient(transfer_to(own, ends.point, ends.infinite, ends.direction))
    density = _point_pdf(before, own.point) * _emitter_pdf(packed, own, arrives, ends, ends.visible, settings.mis)
    density_there = _point_pdf(before, other.point) * _emitter_pdf(packed, other, second, ends, lit, settings.mis)
    total = density + density_there
    paired = paired & (total > 0)
    inverse = jnp.where(paired, 1.0 / jnp.where(paired, total, 1.0), 0.0)
    pairs = scale(scale(values, density) + contribution, inverse)
    moved = pairs - stop_gradient(pairs)
    values = jnp.where(paired[:, None], stop_gradient(values) + moved, values)
    found = jax.lax.split(values, (light[0].shape[0],) * 2)
    return found[0], found[1]


def _images(
    packed: PackedScene, previous: Previous, before: Scatterer, own: Scatterer, ends: Ends, settings: PathSettings
) -> tuple[Bool[Array, " N"], Transfer, Scatterer]:
    """(whether the vertices with BSDFs `own` have mirror images, the transfer to the images, the BSDFs there)."""
    image, opposite = _mirrored(stop_gradient(before.point.position), stop_gradient(own.point), ends)
    asked = ends.drawn & previous.spread & own.point.valid & opposite & (own.lobe_width() < NARROW)
    start = before.leave(image - stop_gradient(before.point.position))
    direction = normalize(jnp.where(asked[:, None], image - start, 1.0))
    there = material_hit(packed, intersect(packed, start, direction, asked, settings.rays))
    paired = asked & there.valid & _coplanar(own.point, there)
    transfer = transfer_to(before, there, ~paired, direction)
    back = -transfer.towards
    if previous.seen is not None and previous.apart is not None:
        share = previous.seen.share(stop_gradient(transfer.distance2))
        moved = scale(previous.apart - stop_gradient(previous.apart), share)
        offset = before.point.position + moved - there.position
        back = jnp.where(paired[:, None], normalize(jnp.where(paired[:, None], offset, 1.0)), back)
    other = Scatterer(packed, there, back)
    if settings.black:
        arrives = before.may_scatter(transfer.towards)  # else no path continues there
    else:
        arrives = (stop_gradient(previous.vertex.throughput * transfer.value) != 0).any(-1)
    return paired & arrives & (other.lobe_width() < NARROW), transfer, other


def _twice(x):
    return jnp.concatenate([x, x])


def _mirrored(x: Float[Array, "N 3"], y: SurfacePoint, ends: Ends):
    """(mirror images of y, whether x and z are on the same side of its plane); all detached."""
    ends = stop_gradient(ends)
    normal, height = y.normal, dot(x - y.position, y.normal)
    towards = jnp.where(ends.infinite[:, None], ends.direction, ends.point.position - y.position)
    rise = dot(towards, normal)
    opposite = height * rise > 0
    foot = x - scale(normal, height)
    along = jnp.where(ends.infinite[:, None], towards, towards + y.position - foot) - scale(normal, rise)
    whole = jnp.where(ends.infinite, rise, height + rise)
    mirror = foot + scale(along, height / jnp.where(opposite, whole, 1.0))
    return 2.0 * mirror - y.position, opposite


def _coplanar(one: SurfacePoint, two: SurfacePoint) -> Bool[Array, " N"]:
    """Whether faces are in the same plane, but for rounding."""
    one, two = stop_gradient((one, two))
    apart = jnp.abs(dot(two.position - one.position, one.normal))
    return (norm(cross(one.normal, two.normal)) < FLAT) & (apart <= FLAT * jnp.maximum(one.scale, two.scale))


def _point_pdf(scatterer: Scatterer, point: SurfacePoint) -> Float[Array, " N"]:
    """Density (per area) with which BSDF samples find points, detached."""
    offset = stop_gradient(point.position - scatterer.point.position)
    towards = normalize(offset)
    cosine = jnp.abs(dot(stop_gradient(point.normal), towards))
    return scatterer.pdf(towards) * cosine / jnp.maximum(dot(offset, offset), 1e-30)


def _radiance(packed: PackedScene, ends: Ends, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Radiance of emitters (intensity of lights without area) against the unit directions `towards` them."""
    sent = emitted(packed, ends.point, -towards)
    if ends.light is None:
        return sent
    intensity = light_intensity(packed, jnp.maximum(ends.light, 0), -towards)
    return jnp.where((ends.light >= 0)[:, None], intensity, sent)


def _emitter_pdf(packed: PackedScene, scatterer: Scatterer, arrives: Transfer, ends: Ends, visible, mis: bool):
    """Density with which vertices find emitters, by emitter sampling and, where `visible`, by BSDF sampling; detached.

    It is per area, per solid angle where `infinite`, or a probability for lights without area.
    """
    shares, found = emitter_shares(packed), jnp.zeros_like(arrives.cosine)
    if packed.has_area_emitters:
        found = shares.surfaces * emitting_surface_pdf(packed, ends.point, scatterer.point.position)
    if packed.environment is not None:
        sky = shares.environment * packed.environment_sampler.pdf(stop_gradient(ends.direction))
        found = jnp.where(ends.infinite, sky, found)
    sampled = 0.0
    if mis:
        per_angle = jnp.where(ends.infinite, 1.0, jnp.abs(arrives.cosine) / arrives.distance2)
        sampled = jnp.where(visible, scatterer.pdf(arrives.towards) * per_angle, 0.0)
    if ends.light is not None:
        each = jnp.broadcast_to(jnp.asarray(shares.lights, found.dtype), packed.light_count)
        delta = ends.light >= 0
        found = jnp.where(delta, each[jnp.maximum(ends.light, 0)], found)
        sampled = jnp.where(delta, 0.0, sampled)
    return stop_gradient(found + sampled)
