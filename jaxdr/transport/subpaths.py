"""Subpaths of bidirectional path tracing (Veach 1997, chapter 10), from the camera and from emitters.

A subpath is x_0, x_1, ...; x_0 is on the lens or on an emitter, and is not kept. There are k + 1 strategies for a path
of k segments. The strategy with s vertices from an emitter and t = k + 1 - s from the camera joins the last vertices of
two subpaths. Its weight needs the densities of all other strategies relative to its own. Their sum is updated vertex by
vertex (`Subpath.shorter`), so that a weight does not need a loop over the path (van Antwerpen 2011, Recursive MIS
computation for streaming BDPT; Georgiev 2012).

BSDFs are always evaluated for radiance, with `wi` towards the camera, also on subpaths from emitters. So shading
normals and squared ratios of indices are right without correction terms (Veach 1997, 5.2 and 5.3).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr import loops
from jaxdr.geometry.vector import dot, normalize
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.bsdf.base import DeltaSample
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import EmitterSample, radiance_towards
from jaxdr.transport.interaction import SurfacePoint, intersect, material_hit
from jaxdr.transport.light_rays import light_rays
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer

# Upper bound of sums of relative densities, so that no product of two overflows float32. A strategy with larger sums
# has the weight zero anyway.
LARGEST = 1e18


class Subpath(NamedTuple):
    """Vertices of N subpaths, all material points: [N, ...] each, or [B, N, ...] of x_1 to x_B.

    - `back`: unit direction to the previous vertex.
    - `throughput`: contribution of the subpath over its density, without the BSDF at the vertex. For a subpath from an
      emitter, throughput times f_s |cos| for light from `back` is the radiance that the vertex sends on, per subpath
      and area.
    - `density`: with which the vertex was sampled from the previous one (per area, or per solid angle on a miss);
      detached.
    - `shorter`: detached. A sum over the strategies that end a subpath of this kind before this vertex: their densities
      over that of the strategy that ends it here, to the power of the heuristic. The sum is divided by the density (to
      that power, solid angle at this vertex) with which the previous vertex is sampled from here.
    - `joined`: whether the segment to the previous vertex may be a connection: no delta lobe leads along it. None in
      scenes without delta lobes.
    """

    point: SurfacePoint
    back: Float[Array, "*n 3"]
    throughput: Float[Array, "*n 3"]
    density: Float[Array, "*n"]
    shorter: Float[Array, "*n"]
    joined: Bool[Array, "*n"] | None

    def vertices(self, count: int) -> "Subpath":
        """The first `count` vertices of all paths in a row, [count * N, ...]."""
        return jax.tree.map(lambda a: a[:count].reshape(-1, *a.shape[2:]), self)


def relative_densities(
    ratio: Float[Array, " N"],
    joined: Bool[Array, " N"] | None,
    reverse: Float[Array, " N"],
    shorter: Float[Array, " N"],
    power: int,
) -> Float[Array, " N"]:
    """Summed densities of all strategies that end a subpath before a vertex, over that of ending it there; detached.

    `ratio` is the density of the vertex as sampled from the path's other end over that from this end. `reverse` is the
    density with which this vertex samples the previous one (solid angle). All ratios are taken to `power`: 1 is the
    balance heuristic, 2 the power heuristic.
    """
    next_shorter = 1.0 if joined is None else jnp.where(joined, 1.0, 0.0)
    sum_before = jnp.minimum(next_shorter + jnp.minimum(reverse**power, LARGEST) * shorter, LARGEST)
    total = jnp.minimum(jnp.minimum(ratio**power, LARGEST) * sum_before, LARGEST)
    return stop_gradient(total).astype(ratio.dtype)


def quotient(density, other) -> Float[Array, "*n"]:
    """density / other, zero where `other` is zero: no path has such a vertex."""
    return safe_divide(density, other, otherwise=0.0)


def camera_start(packed: PackedScene, primary: PrimarySamples) -> Subpath:
    """First hits as x_1 of camera subpaths.

    Their density is per area of the surface, for film points that are uniform over the whole window: a subpath from an
    emitter may land in any pixel, and there are as many of these subpaths as pixels.
    """
    first, view = primary.first, primary.view
    _, _, width, height = view.film.window
    local = view.local(first.position)
    local = jnp.where(first.valid[:, None], local, jnp.asarray([0.0, 0.0, 1.0], local.dtype))
    density = stop_gradient(view.film_area(local, first.normal)) / (width * height)
    throughput = jnp.broadcast_to(primary.weight[:, None], first.position.shape)
    joined = jnp.ones_like(first.valid) if packed.has_delta_lobes else None
    return Subpath(first, -primary.direction, throughput, density, jnp.zeros_like(density), joined)


def light_start(packed: PackedScene, sample: EmitterSample, u: Float[Array, "N 2"], power: int, rays: str) -> Subpath:
    """Hits of rays from emitter samples, as x_1 of subpaths from emitters."""
    ray = light_rays(packed, sample, u)
    emits = (ray.pdf > 0) & (sample.pdf > 0)
    point = material_hit(packed, intersect(packed, ray.start, ray.direction, emits, rays))
    hit = point.valid
    infinite, has_area = sample.infinite, ~sample.infinite
    if sample.is_delta is not None:
        has_area &= ~sample.is_delta
    offset = point.position - sample.point.position
    away = jnp.where(infinite[:, None], -sample.direction, normalize(offset))
    distance2 = jnp.where(infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    leaving = jnp.where(has_area, jnp.maximum(dot(sample.point.normal, away), 0.0), 1.0)
    arriving = jnp.abs(dot(point.normal, away))
    change = jnp.where(has_area, sample.point.area_ratio(), 1.0) * point.area_ratio()
    density = stop_gradient(ray.pdf * arriving / distance2)
    whole = sample.pdf * density
    carries = emits & hit & (whole > 0)
    radiance = radiance_towards(packed, sample, -away)
    throughput = radiance * safe_divide(leaving / distance2 * change, whole, carries)[:, None]
    throughput = jnp.where(carries[:, None], throughput, 0.0)
    # Only one strategy ends before x_1: a camera subpath that hits the emitter.
    found = jnp.where(has_area | infinite, 1.0, 0.0)
    if sample.is_delta is not None:
        found = jnp.where(sample.is_delta, 0.0, found)
    shorter = found * jnp.minimum(quotient(stop_gradient(leaving / distance2), sample.pdf) ** power, LARGEST)
    joined = jnp.ones_like(hit) if packed.has_delta_lobes else None
    point = point._replace(valid=carries)
    return Subpath(point, -away, throughput, density, stop_gradient(shorter).astype(density.dtype), joined)


def trace_on(
    packed: PackedScene, start: Subpath, u: Float[Array, "B N 2"], adjoint: bool, power: int, rays: str
) -> Subpath:
    """Subpaths of B + 1 vertices from their first ones, [B + 1, N, ...]; `adjoint`: they come from emitters."""

    def step(vertex, numbers):
        following = _step(packed, vertex, numbers, adjoint, power, rays)
        return following, following

    _, others = loops.scan(step, start, u)
    return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), start, others)


def _step(packed: PackedScene, vertex: Subpath, u, adjoint: bool, power: int, rays: str) -> Subpath:
    """The next vertex by BSDF sampling."""
    scatterer = Scatterer(packed, vertex.point, vertex.back)
    onwards, lobe = scatterer.sample(u), None
    forward = scatterer.pdf(onwards)
    if packed.has_delta_lobes:
        lobe = scatterer.adjoint_delta(u) if adjoint else scatterer.sample_delta(u)
        chosen = lobe.probability > 0
        onwards = jnp.where(chosen[:, None], stop_gradient(lobe.wo), onwards)
        forward = jnp.where(chosen, stop_gradient(lobe.probability), forward)
    onwards = jnp.where((forward > 0)[:, None], onwards, vertex.back)  # if sampling fails, avoid zero vectors
    origin = scatterer.leave(onwards)
    following = material_hit(packed, intersect(packed, origin, onwards, vertex.point.valid & (forward > 0), rays))
    return extend(vertex, scatterer, following, Onwards(onwards, forward, lobe), adjoint, power)


class Onwards(NamedTuple):
    """Detached directions, drawn with density `forward` (solid angle), or in a delta lobe.

    In a delta lobe `forward` is the probability of `lobe`. `lobe` is None in scenes without delta lobes.
    """

    direction: Float[Array, "N 3"]
    forward: Float[Array, " N"]
    lobe: DeltaSample | None = None


def extend(
    vertex: Subpath, scatterer: Scatterer, following: SurfacePoint, onwards: Onwards, adjoint: bool, power: int
) -> Subpath:
    """Subpaths with one more vertex, `following`, or with the environment where `following` is not valid.

    `scatterer`, the BSDF at the last vertex seen from `back`, has sampled the directions `onwards`.
    """
    direction, forward, lobe = onwards
    point, hit = vertex.point, following.valid
    offset = following.position - point.position
    towards = jnp.where(hit[:, None], normalize(offset), direction)
    distance2 = jnp.where(hit, jnp.maximum(dot(offset, offset), 1e-30), 1.0)
    leaving = jnp.abs(dot(point.normal, towards))
    arriving = jnp.where(hit, jnp.abs(dot(following.normal, towards)), 1.0)
    density = stop_gradient(forward * arriving / distance2)
    carries = point.valid & (forward > 0) & (density > 0)
    turned = scatterer.seen_from(towards)
    reverse = turned.pdf(vertex.back)
    # f_s |cos| towards the emitter, times the geometric term without that cosine.
    value = turned.eval(vertex.back) if adjoint else scatterer.eval(towards)
    geometry = (leaving if adjoint else arriving) / distance2 * jnp.where(hit, following.area_ratio(), 1.0)
    factor = value * safe_divide(geometry, density, carries)[:, None]
    joined = before = vertex.joined
    if lobe is not None:
        chosen, reverses = lobe.probability > 0, scatterer.delta_reverses(turned, towards)
        probability = jnp.where(chosen, forward, 1.0)
        weight = lobe.weight / probability[:, None]
        if adjoint:
            weight *= stop_gradient(jnp.where(reverses, quotient(leaving, arriving), 0.0))[:, None]
        factor = jnp.where(chosen[:, None], weight, factor)
        # A delta lobe has the same probability both ways. Other factors of delta distributions cancel in the weights.
        reverse = jnp.where(chosen, jnp.where(reverses, forward, 0.0), reverse)
        joined, before = ~chosen, vertex.joined & ~chosen
    throughput = jnp.where(carries[:, None], vertex.throughput * factor, 0.0)
    ratio = quotient(stop_gradient(leaving / distance2), vertex.density)
    shorter = relative_densities(ratio, before, reverse, vertex.shorter, power)
    # Also where the throughput is zero: its derivative may not be.
    following = following._replace(valid=hit & carries)
    return Subpath(following, -towards, throughput, density, shorter, joined)
