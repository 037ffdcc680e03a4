"""Unidirectional path tracing: measurement contributions and the segments they came through.

A path starts at a first hit that the caller provides; every later vertex is a material point (DESIGN 1), except behind
narrow lobes: there it slides along a ray that is fixed in the lobe (DESIGN 2b). Contributions are differentiable
functions of the scene (the interior term is their derivative); choices and densities are detached. Behind delta lobes
the next vertex slides as well: mirrors and smooth glass continue a ray as it moves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted, emitter_pdf, radiance_towards, sample_emitter
from jaxdr.transport.interaction import (
    SurfacePoint,
    detached_barycentric,
    either,
    intersect,
    leave,
    material_point,
    on_fixed_ray,
)
from jaxdr.transport.near_field import NearField
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer


class Segments(NamedTuple):
    """Path segments from an apex (nearer to the camera) to a target, [B, N, ...]: B bounces of N paths; all detached.

    `apex` and `target` are (face, barycentric) material points; the apex of bounce 0 is the first hit instead. Where
    `infinite`, the target is the environment in `direction`. `weight` is f / pdf (RGB) of all paths through the segment
    without its own BSDF value at the apex and geometric term: throughput to the apex times radiance that arrives,
    over the density of the target (per area, at infinity per solid angle). `visible` is off where an emitter sample is
    occluded; its weight is that of an unoccluded one. `throughput` to the apex comes with emitter samples, and `unlit`,
    the weight without the radiance, where that of the environment depends on the direction or that of a surface on the
    point; `lobe`, of BSDF-sampled segments, is the throughput over the density of `direction` (solid angle), whatever
    lies there.
    """

    apex_face: Int[Array, "B N"]
    apex_barycentric: Float[Array, "B N 3"]
    target_face: Int[Array, "B N"]
    target_barycentric: Float[Array, "B N 3"]
    infinite: Bool[Array, "B N"]
    direction: Float[Array, "B N 3"]
    weight: Float[Array, "B N 3"]
    visible: Bool[Array, "B N"]
    throughput: Float[Array, "B N 3"] | None = None
    unlit: Float[Array, "B N 3"] | None = None
    lobe: Float[Array, "B N 3"] | None = None


class Vertices(NamedTuple):
    """Path vertices as they move, differentiable, in scenes where some slide.

    `narrow`: the BSDF-sampled direction is held fixed in the lobe. `delta`: the path goes on in a delta lobe. None if
    there are no such lobes.
    """

    position: Float[Array, "B N 3"]
    shading_normal: Float[Array, "B N 3"]
    narrow: Bool[Array, "B N"] | None
    delta: Bool[Array, "B N"] | None = None


class PathRecord(NamedTuple):
    """Radiance towards the camera of N paths, and the segments behind the first hit.

    `direct` are connections to emitter samples; they carry all direct light. `scattered` are BSDF-sampled segments;
    they carry what is gathered at their far end and beyond. None where there are none. `near` is the share of the
    radiance (detached) that is taken in material form. `vertices` are the apexes of the segments, where some may slide.
    """

    radiance: Float[Array, "N 3"]
    near: Float[Array, "N 3"]
    direct: Segments | None
    scattered: Segments | None
    vertices: Vertices | None = None


class PathSettings(NamedTuple):
    """Static settings: `max_depth` in segments, MIS or emitter sampling alone, query implementation.

    Lobes narrower than `attached` (radians) hold their direction fixed; 0 for none.
    """

    max_depth: int
    mis: bool
    rays: str
    attached: float = 0.0


class _Bounce(NamedTuple):
    """What one vertex of N paths adds.

    `light` by emitter sampling, `emission` found by BSDF sampling; `near_light` and `near_beyond` are the shares of the
    light sample and of everything behind the BSDF-sampled segment that are in material form.
    """

    light: Float[Array, "N 3"]
    emission: Float[Array, "N 3"]
    near_light: Float[Array, " N"]
    near_beyond: Float[Array, " N"]
    direct: Segments
    scattered: Segments | None
    vertices: Vertices | None = None


def trace_paths(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"] | Float[Array, "B N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
    near: NearField | None = None,
) -> PathRecord:
    """Trace paths on from first hits; `direction` is that of the rays which found them, `u` the first bounce's numbers.

    Or those of all bounces; then nothing is drawn from `key`.

    Next-event estimation and BSDF sampling are combined by the balance heuristic (Veach 1997), unless `settings.mis`
    is off: then emitters are reached by next-event estimation alone, but for delta lobes, whose light only they find.
    `near` is the other form of the first hits.
    """
    radiance = emitted(packed, first, -direction)
    bounces = settings.max_depth - 1
    if bounces == 0:
        return PathRecord(radiance, jnp.zeros_like(radiance), None, None)
    scatterer = Scatterer(packed, first, -direction)
    parts = gather(packed, scatterer, bounces, u, key, settings, near)
    light, emission = parts.light, parts.emission
    own = stop_gradient(light + emission)
    # What every BSDF-sampled segment carries from its far end: the light that later bounces add, summed from the end.
    beyond = jnp.cumsum(own[::-1], axis=0)[::-1] - own
    near_radiance = jnp.zeros_like(radiance)
    if near is not None:
        near_radiance = parts.near_light[0, :, None] * stop_gradient(light[0])
        near_radiance += parts.near_beyond[0, :, None] * (stop_gradient(emission[0]) + beyond[0])
    scattered = None
    if bounces > 1:
        scattered = jax.tree.map(lambda x: x[: bounces - 1], parts.scattered)
        transfer = scattered.weight  # so far: BSDF value times geometric term of the segment itself
        gathered = beyond[:-1] / jnp.where(transfer > 0, transfer, 1.0)
        scattered = scattered._replace(weight=jnp.where(transfer > 0, gathered, 0.0))
    return PathRecord(
        radiance + light.sum(0) + emission.sum(0),
        near_radiance,
        jax.tree.map(stop_gradient, parts.direct),
        jax.tree.map(stop_gradient, scattered),
        parts.vertices,
    )


def gather(packed, scatterer, bounces, u, key, settings, near) -> _Bounce:
    """All bounces of paths from their first vertex on, [B, N, ...]."""

    given = u if u.ndim == 3 else None
    u = u if given is None else given[0]

    def numbers(bounce):
        return given[bounce] if given is not None else uniform(jax.random.fold_in(key, bounce), u.shape, u.dtype)

    throughput = jnp.ones_like(scatterer.point.position)
    last = bounces - ends_early(packed, settings)
    if last == 0:
        return _stack(scatter_last(packed, scatterer, throughput, u, settings, near))
    state, added = scatter(packed, scatterer, throughput, u, settings, near)
    parts = [_stack(added)]

    def step(state, bounce):
        point, wi, throughput = state
        return scatter(packed, Scatterer(packed, point, wi), throughput, numbers(bounce), settings)

    if last > 1:
        state, added = jax.lax.scan(step, state, jnp.arange(1, last))
        parts.append(added)
    if last < bounces:
        point, wi, throughput = state
        scatterer = Scatterer(packed, point, wi)
        parts.append(_stack(scatter_last(packed, scatterer, throughput, numbers(last), settings)))
    return jax.tree.map(lambda *p: jnp.concatenate(p), *parts)


def ends_early(packed: PackedScene, settings: PathSettings) -> bool:
    """Whether the last bounce needs no BSDF ray: emitters are not found by rays, and there is no delta lobe."""
    return not (settings.mis or packed.has_delta_lobes)


def _stack(bounce: _Bounce) -> _Bounce:
    return jax.tree.map(lambda x: x[None], bounce)


class _Transfer(NamedTuple):
    """From a vertex towards a target: `value` = f_s |cos| G J (RGB; G counts the target's cosine, 1 at infinity).

    `towards` unit, `cosine` at the target (signed), `geometry` = G J; all of them differentiable.
    """

    value: Float[Array, "N 3"]
    towards: Float[Array, "N 3"]
    distance2: Float[Array, " N"]
    cosine: Float[Array, " N"]
    geometry: Float[Array, " N"]


def _transfer(scatterer, target: SurfacePoint, infinite, direction, delta=None) -> _Transfer:
    """`delta` ones have no area, and so no cosine."""
    offset = target.position - scatterer.point.position
    towards = jnp.where(infinite[:, None], direction, normalize(offset))
    distance2 = jnp.where(infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    cosine = jnp.where(infinite, 1.0, -dot(target.normal, towards))
    if delta is not None:
        cosine = jnp.where(delta, 1.0, cosine)
    geometry = jnp.where(infinite, 1.0, jnp.abs(cosine) / distance2 * target.area_ratio())
    scattered = scatterer.eval_towards(towards, target.position, infinite)
    return _Transfer(scattered * geometry[:, None], towards, distance2, cosine, geometry)


def _both_forms(
    packed, near: NearField | None, fixed: _Transfer, scatterer, target: SurfacePoint, infinite, direction, far
):
    """(value, towards) of both forms of the first hit, mixed by the share of the near field, and that share.

    All of it equals the fixed form's in value; the derivative is what differs. Nothing of what is `far` has a share.
    """
    if near is None:
        return fixed.value, fixed.towards, jnp.zeros_like(fixed.distance2)
    material = _transfer(Scatterer(packed, near.point, near.wi), target, infinite, direction)
    far_share = 1.0 - near.share(scatterer.point, target.position, far)
    share = near.share(near.point, target.position, far)
    weight = share * near.importance
    value = far_share[:, None] * fixed.value + weight[:, None] * material.value
    mixed = stop_gradient(share)[:, None]
    return value, (1.0 - mixed) * fixed.towards + mixed * material.towards, stop_gradient(share)


def _emitter_connection(packed, scatterer, throughput, u, settings, near):
    """(direct light at a vertex from one emitter sample, its share in material form, the segment to it)."""
    sample, point = sample_emitter(packed, u), scatterer.point
    delta = sample.is_delta
    fixed = _transfer(scatterer, sample.point, sample.infinite, sample.direction, delta)
    infinite, towards = sample.infinite[:, None], fixed.towards
    facing = stop_gradient(fixed.cosine) > 0
    reachable = point.valid & facing & (stop_gradient(fixed.value) != 0).any(-1)
    start = scatterer.leave(towards)
    end = jnp.where(infinite, start + 2.0 * packed.size() * towards, leave(sample.point, -towards))
    reach = jnp.where(reachable, 1.0, 0.0).astype(start.dtype)
    seen = reachable & ~queries.occluded(packed.geometry, queries.Rays(start, end - start, reach), settings.rays)
    # Narrow lobes have one form: it has no geometric term that grows, and MIS bounds that of the emitter samples.
    narrow = _narrow(scatterer, settings)
    far = sample.infinite if narrow is None else sample.infinite | narrow
    far = far if delta is None else far | delta
    value, _, share = _both_forms(packed, near, fixed, scatterer, sample.point, sample.infinite, sample.direction, far)
    arriving = throughput * radiance_towards(packed, sample, towards) / sample.pdf[:, None]
    light = arriving * value
    if narrow is not None:
        solid_angle_pdf = sample.pdf * fixed.distance2 / jnp.where(reachable, fixed.cosine, 1.0)
        light *= _share(_balance(solid_angle_pdf, scatterer.density(towards), narrow), delta)
    elif settings.mis:
        solid_angle_pdf = sample.pdf * stop_gradient(fixed.distance2 / jnp.where(reachable, fixed.cosine, 1.0))
        light *= _share(solid_angle_pdf / (solid_angle_pdf + scatterer.pdf(towards)), delta)
    # Lights without area are points: no path segment passes near one, and their shadows are found otherwise.
    carries = reachable if delta is None else reachable & ~delta
    lit = point.valid & scatterer.spreads() if packed.has_delta_lobes else point.valid
    unlit = None
    if packed.has_varying_sky or packed.glow:
        unlit = jnp.where(carries[:, None], throughput / sample.pdf[:, None], 0.0)
    segment = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=sample.point.face,
        target_barycentric=sample.point.barycentric,
        infinite=sample.infinite,
        direction=sample.direction,
        weight=jnp.where(carries[:, None], arriving, 0.0),
        visible=seen,
        throughput=jnp.where(lit[:, None], throughput, 0.0),
        unlit=unlit,
    )
    return jnp.where(seen[:, None], light, 0.0), share, segment


def _narrow(scatterer, settings: PathSettings) -> Bool[Array, " N"] | None:
    """Where the sampled direction is held fixed in the lobe; None for nowhere."""
    return scatterer.lobe_width() < settings.attached if settings.attached > 0 else None


def _balance(density, other, narrow):
    """Balance heuristic (Veach 1997), differentiated where lobes are narrow.

    There the two techniques have different forms: their shares must add up to one as functions of the scene.
    """
    weight = density / (density + other)
    return jnp.where(narrow, weight, stop_gradient(weight))


def _share(weight, delta):
    """Weight of emitter samples, [N, 1]: one where nothing else finds the light."""
    return (weight if delta is None else jnp.where(delta, 1.0, weight))[:, None]


def scatter_last(packed, scatterer, throughput, u, settings, near=None) -> _Bounce:
    """A vertex behind which paths end: emitter sampling alone."""
    light, share, direct = _emitter_connection(packed, scatterer, throughput, u[:, :2], settings, near)
    unused = jax.tree.map(jnp.zeros_like, direct)._replace(throughput=None, unlit=None, lobe=jnp.zeros_like(light))
    return _Bounce(light, jnp.zeros_like(light), share, jnp.zeros_like(share), direct, unused)


def scatter(packed, scatterer, throughput, u, settings, near=None):
    """((next vertex, direction back from it, throughput), what this vertex adds): light, and BSDF sampling.

    The weight of the BSDF-sampled segment is its BSDF value times geometric term, for `trace_paths` to divide by.
    """
    point = scatterer.point
    light, near_light, direct = _emitter_connection(packed, scatterer, throughput, u[:, :2], settings, near)

    sampled = scatterer.sample(u[:, 2:])
    pdf = scatterer.pdf(sampled)
    delta = chosen = None
    if packed.has_delta_lobes:
        delta = scatterer.sample_delta(u[:, 2:])
        chosen = delta.probability > 0
        sampled = jnp.where(chosen[:, None], stop_gradient(delta.wo), sampled)
        pdf = jnp.where(chosen, stop_gradient(delta.probability), pdf)
    active = point.valid & (pdf > 0)
    origin = scatterer.leave(sampled)
    face = intersect(packed, origin, sampled, active, settings.rays)
    hit = face >= 0
    face = jnp.where(hit, face, 0)
    barycentric = detached_barycentric(packed, origin, sampled, face)
    following = material_point(packed, face, barycentric, hit)
    narrow, vertices, direction = _narrow(scatterer, settings), None, sampled
    if packed.environment_turns:
        direction = jnp.where(hit[:, None], sampled, packed.turned(sampled))
    if narrow is not None or delta is not None:
        apart = None if narrow is None else narrow & point.valid
        vertices = Vertices(point.position, point.shading_normal, apart, chosen)
    if narrow is not None:
        # The direction turns with the lobe, in solid angle: no G, no J (that of a rotation is one).
        direction = jnp.where(narrow[:, None], scatterer.turn(sampled), direction)
        sliding = on_fixed_ray(packed, point.position, direction, jnp.where(narrow & hit, face, -1))
        following = either(narrow & hit, sliding._replace(barycentric=barycentric), following)
    if delta is not None:
        direction = jnp.where(chosen[:, None], delta.wo, direction)
        sliding = on_fixed_ray(packed, point.position, direction, jnp.where(chosen & hit, face, -1))
        following = either(chosen & hit, sliding._replace(barycentric=barycentric), following)

    # f G J / pdf in area measure; the density of a sampled direction there is pdf times the detached G.
    transfer = _transfer(scatterer, following, ~hit, direction)
    fixed, in_angle = transfer, ~hit
    if narrow is not None or delta is not None:
        for fixed_in_angle in (narrow, chosen):
            in_angle = in_angle if fixed_in_angle is None else in_angle | fixed_in_angle
        fixed = _transfer(scatterer, following, in_angle, direction)
    if delta is not None:
        fixed = fixed._replace(value=jnp.where(chosen[:, None], delta.weight, fixed.value))
    forms = _both_forms(packed, near, fixed, scatterer, following, in_angle, direction, in_angle)
    value, towards, near_beyond = forms
    density = pdf * stop_gradient(fixed.geometry)
    carries = active & (density > 0)
    incoming = throughput
    factor = value / jnp.where(carries, density, 1.0)[:, None]
    throughput = jnp.where(carries[:, None], throughput * factor, 0.0)

    emission = jnp.zeros_like(throughput)
    if settings.mis or delta is not None:
        weight = jnp.zeros_like(pdf)
        if settings.mis:
            found = emitter_pdf(packed, following, transfer.towards, transfer.distance2, jnp.abs(transfer.cosine))
            if narrow is None:
                weight = stop_gradient(pdf / jnp.where(active, pdf + found, 1.0))
            else:
                weight = _balance(jnp.where(active, scatterer.density(direction), 1.0), found, narrow)
        if chosen is not None:
            weight = jnp.where(chosen, 1.0, weight)  # emitter samples never find what a delta lobe sees
        emission = throughput * emitted(packed, following, -towards) * weight[:, None]
    # Delta lobes have no density: no estimator may spread what they carry over directions beside theirs.
    spread = active if chosen is None else active & ~chosen
    scattered = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=face,
        target_barycentric=barycentric,
        infinite=active & ~hit,
        direction=sampled,
        weight=jnp.where((hit if chosen is None else hit & spread)[:, None], stop_gradient(transfer.value), 0.0),
        visible=hit,
        lobe=jnp.where(spread[:, None], incoming / jnp.where(spread, pdf, 1.0)[:, None], 0.0),
    )
    following = following._replace(valid=hit & (throughput != 0).any(-1))
    added = _Bounce(light, emission, near_light, near_beyond, direct, scattered, vertices)
    return (following, -towards, throughput), added
