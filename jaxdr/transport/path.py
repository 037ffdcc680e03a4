"""Unidirectional path tracing: measurement contributions and the segments they came through.

A path starts at a first hit that the caller provides; every later vertex is a material point (DESIGN 1). Contributions
are differentiable functions of the scene (the interior term is their derivative); choices and densities are detached.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import (
    SurfacePoint,
    detached_barycentric,
    intersect,
    leave,
    material_point,
)
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer, emitted, emitter_pdf, sample_emitter


class Segments(NamedTuple):
    """Path segments from an apex (nearer to the camera) to a target, [B, N, ...]: B bounces of N paths; all detached.

    `apex` and `target` are (face, barycentric) material points; the apex of bounce 0 is the first hit instead. Where
    `infinite`, the target is the environment in `direction`. `contribution` is the sum over all paths through the
    segment of f / pdf (RGB), what a boundary term on the segment is weighted with (Eq. 20).
    """

    apex_face: Int[Array, "B N"]
    apex_barycentric: Float[Array, "B N 3"]
    target_face: Int[Array, "B N"]
    target_barycentric: Float[Array, "B N 3"]
    infinite: Bool[Array, "B N"]
    direction: Float[Array, "B N 3"]
    contribution: Float[Array, "B N 3"]


class PathRecord(NamedTuple):
    """Radiance towards the camera of N paths, and the segments behind the first hit (emitter and BSDF sampling)."""

    radiance: Float[Array, "N 3"]
    segments: tuple[Segments, ...]


class PathSettings(NamedTuple):
    """Static settings: `max_depth` in segments, MIS or emitter sampling alone, query implementation."""

    max_depth: int
    mis: bool
    rays: str


def trace_paths(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> PathRecord:
    """Trace paths on from first hits; `direction` is that of the rays which found them, `u` the first bounce's numbers.

    Next-event estimation and BSDF sampling are combined by the balance heuristic (Veach 1997), unless `settings.mis`
    is off: then emitters are reached by next-event estimation alone.
    """
    radiance = emitted(packed, first, -direction)
    bounces = settings.max_depth - 1
    if bounces == 0:
        return PathRecord(radiance, ())

    def numbers(bounce):
        fresh = uniform(jax.random.fold_in(key, bounce), u.shape, u.dtype)
        return jnp.where(bounce == 0, u, fresh)

    def step(state, bounce):
        return _bounce(packed, *state, numbers(bounce), settings)

    state = (first, -direction, jnp.ones_like(direction))
    if settings.mis:
        state, (direct, scattered) = jax.lax.scan(step, state, jnp.arange(bounces))
    else:
        # Without MIS the last bounce needs no BSDF ray; it stands behind the loop, whatever the depth.
        scattered = None
        if bounces > 1:
            state, (direct, scattered) = jax.lax.scan(step, state, jnp.arange(bounces - 1))
        last = jax.tree.map(lambda x: x[None], _next_event(packed, *state, numbers(bounces - 1)[:, :2], settings))
        direct = last if bounces == 1 else jax.tree.map(lambda a, b: jnp.concatenate([a, b]), direct, last)
    radiance = radiance + direct.contribution.sum(0)
    if scattered is not None:
        radiance = radiance + scattered.contribution.sum(0)
    return PathRecord(radiance, _detached_segments(direct, scattered))


def _detached_segments(direct: Segments, scattered: Segments | None) -> tuple[Segments, ...]:
    """Segments whose contributions are those of all paths through them: suffix sums over the bounces."""
    direct = jax.tree.map(stop_gradient, direct)
    if scattered is None:
        return (direct,)
    scattered = jax.tree.map(stop_gradient, scattered)
    count = scattered.contribution.shape[0]
    # A BSDF-sampled segment carries the emission it hits, and everything gathered at its far end and beyond.
    gathered = jnp.concatenate([direct.contribution[1:], jnp.zeros_like(direct.contribution[:1])])[:count]
    through = jnp.cumsum((scattered.contribution + gathered)[::-1], axis=0)[::-1]
    return direct, scattered._replace(contribution=through)


def _next_event(packed, point: SurfacePoint, wi, throughput, u, settings) -> Segments:
    """Direct light at a vertex from one emitter sample; differentiable contribution."""
    return _emitter_connection(packed, point, Scatterer(packed, point, wi), throughput, u, settings)


def _emitter_connection(packed, point, scatterer, throughput, u, settings) -> Segments:
    sample = sample_emitter(packed, u)
    offset = sample.point.position - point.position
    infinite = sample.infinite[:, None]
    towards = jnp.where(infinite, sample.direction, normalize(offset))
    distance2 = jnp.where(sample.infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    cosine = jnp.where(sample.infinite, 1.0, -dot(sample.point.normal, towards))
    f = scatterer.eval(towards)
    reachable = point.valid & (stop_gradient(cosine) > 0) & (stop_gradient(f) > 0).any(-1)
    start = leave(point, towards)
    end = jnp.where(infinite, start + 2.0 * packed.size() * towards, leave(sample.point, -towards))
    reach = jnp.where(reachable, 1.0, 0.0).astype(start.dtype)
    seen = reachable & ~queries.occluded(packed.vertices, packed.faces, start, end - start, reach, settings.rays)
    geometry = jnp.where(sample.infinite, 1.0, cosine / distance2 * sample.point.area_ratio())
    weight = 1.0
    if settings.mis:
        solid_angle_pdf = sample.pdf * stop_gradient(distance2 / jnp.where(reachable, cosine, 1.0))
        weight = solid_angle_pdf / (solid_angle_pdf + scatterer.pdf(towards))
    value = throughput * f * sample.radiance * (geometry / sample.pdf * weight)[:, None]
    return Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=sample.point.face,
        target_barycentric=sample.point.barycentric,
        infinite=sample.infinite,
        direction=sample.direction,
        contribution=jnp.where(seen[:, None], value, 0.0),
    )


def _bounce(packed, point: SurfacePoint, wi, throughput, u, settings):
    """Direct light at a vertex, and the next vertex by BSDF sampling."""
    scatterer = Scatterer(packed, point, wi)
    direct = _emitter_connection(packed, point, scatterer, throughput, u[:, :2], settings)

    sampled = scatterer.sample(u[:, 2:])
    pdf = scatterer.pdf(sampled)
    active = point.valid & (pdf > 0)
    origin = leave(point, sampled)
    face = intersect(packed, origin, sampled, active, settings.rays)
    hit = face >= 0
    face = jnp.where(hit, face, 0)
    barycentric = detached_barycentric(packed, origin, sampled, face)
    following = material_point(packed, face, barycentric, hit)

    offset = following.position - point.position
    towards = jnp.where(hit[:, None], normalize(offset), sampled)
    distance2 = jnp.where(hit, jnp.maximum(dot(offset, offset), 1e-30), 1.0)
    cosine = jnp.abs(dot(following.normal, towards))
    # f G J / pdf in area measure; sampling in solid angle makes G J / detach(G) of it, one in value on a hit.
    geometry = jnp.where(hit, cosine / distance2 * following.area_ratio(), 1.0)
    detached = stop_gradient(geometry)
    change = jnp.where(detached > 0, geometry / jnp.where(detached > 0, detached, 1.0), 0.0)
    factor = scatterer.eval(towards) * (change / jnp.where(active, pdf, 1.0))[:, None]
    throughput = jnp.where(active[:, None], throughput * factor, 0.0)

    value = jnp.zeros_like(throughput)
    if settings.mis:
        weight = pdf / jnp.where(active, pdf + emitter_pdf(packed, following, distance2, cosine), 1.0)
        value = throughput * emitted(packed, following, -towards) * stop_gradient(weight)[:, None]
    scattered = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=face,
        target_barycentric=barycentric,
        infinite=active & ~hit,
        direction=sampled,
        contribution=value,
    )
    carried = (throughput > 0).any(-1)
    return (following._replace(valid=hit & carried), -towards, throughput), (direct, scattered)
