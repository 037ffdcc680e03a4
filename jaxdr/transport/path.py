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
    `infinite`, the target is the environment in `direction`. `weight` is f / pdf (RGB) of all paths through the segment
    without its own BSDF value at the apex and geometric term: throughput to the apex times radiance that arrives,
    over the density of the target (per area, at infinity per solid angle). `visible` is off where an emitter sample is
    occluded; its weight is that of an unoccluded one.
    """

    apex_face: Int[Array, "B N"]
    apex_barycentric: Float[Array, "B N 3"]
    target_face: Int[Array, "B N"]
    target_barycentric: Float[Array, "B N 3"]
    infinite: Bool[Array, "B N"]
    direction: Float[Array, "B N 3"]
    weight: Float[Array, "B N 3"]
    visible: Bool[Array, "B N"]


class PathRecord(NamedTuple):
    """Radiance towards the camera of N paths, and the segments behind the first hit.

    `direct` are connections to emitter samples; they carry all direct light. `scattered` are BSDF-sampled segments;
    they carry what is gathered at their far end and beyond. None where there are none.
    """

    radiance: Float[Array, "N 3"]
    direct: Segments | None
    scattered: Segments | None


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
        return PathRecord(radiance, None, None)

    def numbers(bounce):
        fresh = uniform(jax.random.fold_in(key, bounce), u.shape, u.dtype)
        return jnp.where(bounce == 0, u, fresh)

    def step(state, bounce):
        point, wi, throughput = state
        return _bounce(packed, point, wi, throughput, numbers(bounce), settings)

    # Without MIS the last bounce needs no BSDF ray; it stands behind the loop, whatever the depth.
    looped = bounces if settings.mis else bounces - 1
    state, parts = (first, -direction, jnp.ones_like(direction)), []
    gathered = scattered = None
    if looped:
        state, (light, emission, direct, scattered) = jax.lax.scan(step, state, jnp.arange(looped))
        parts.append((light, direct))
        radiance = radiance + light.sum(0) + emission.sum(0)
    if looped < bounces:
        point, wi, throughput = state
        scatterer = Scatterer(packed, point, wi)
        last = _emitter_connection(packed, point, scatterer, throughput, numbers(looped)[:, :2], settings)
        parts.append(jax.tree.map(lambda x: x[None], last))
        radiance = radiance + last[0]
    light, direct = jax.tree.map(lambda *p: jnp.concatenate(p), *parts)
    if bounces > 1:
        # What is gathered beyond a BSDF-sampled segment: the light that later bounces add, summed from the end.
        later = stop_gradient(light)[1:]
        if settings.mis:
            later = later + stop_gradient(emission)[1:]
        gathered = jnp.cumsum(later[::-1], axis=0)[::-1]
        scattered = jax.tree.map(lambda x: x[: bounces - 1], scattered)
        own = scattered.weight  # so far: BSDF value times geometric term of the segment itself
        scattered = scattered._replace(weight=jnp.where(own > 0, gathered / jnp.where(own > 0, own, 1.0), 0.0))
    else:
        scattered = None
    return PathRecord(radiance, jax.tree.map(stop_gradient, direct), jax.tree.map(stop_gradient, scattered))


def _emitter_connection(packed, point, scatterer, throughput, u, settings):
    """(direct light at a vertex from one emitter sample, the segment to it)."""
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
    arriving = throughput * sample.radiance / sample.pdf[:, None]
    value = arriving * f * (geometry * weight)[:, None]
    segment = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=sample.point.face,
        target_barycentric=sample.point.barycentric,
        infinite=sample.infinite,
        direction=sample.direction,
        weight=jnp.where(reachable[:, None], arriving, 0.0),
        visible=seen,
    )
    return jnp.where(seen[:, None], value, 0.0), segment


def _bounce(packed, point: SurfacePoint, wi, throughput, u, settings):
    """Direct light at a vertex, and the next vertex by BSDF sampling with the emission found there.

    The weight of the BSDF-sampled segment is its BSDF value times geometric term, for `trace_paths` to divide by.
    """
    scatterer = Scatterer(packed, point, wi)
    light, direct = _emitter_connection(packed, point, scatterer, throughput, u[:, :2], settings)

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
    f = scatterer.eval(towards)
    factor = f * (change / jnp.where(active, pdf, 1.0))[:, None]
    throughput = jnp.where(active[:, None], throughput * factor, 0.0)

    emission = jnp.zeros_like(throughput)
    if settings.mis:
        weight = pdf / jnp.where(active, pdf + emitter_pdf(packed, following, distance2, cosine), 1.0)
        emission = throughput * emitted(packed, following, -towards) * stop_gradient(weight)[:, None]
    scattered = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=face,
        target_barycentric=barycentric,
        infinite=active & ~hit,
        direction=sampled,
        weight=jnp.where(hit[:, None], stop_gradient(f) * detached[:, None], 0.0),
        visible=hit,
    )
    carried = (throughput > 0).any(-1)
    following = following._replace(valid=hit & carried)
    return (following, -towards, throughput), (light, emission, direct, scattered)
