"""Unidirectional path tracing: measurement contributions and the path segments that carry them.

A path starts at a first hit x_1 that the caller provides. Every later vertex is a material point. With throughput
T_1 = 1 the contribution of the vertices k = 1, 2, ... is the sum of

    T_k f(x_k, y) G(x_k, y) J(y) L_e(y) w / p(y)                     y an emitter sample, p per area (light)
    T_(k+1) L_e(x_(k+1)) w,   T_(k+1) = T_k f G J / [p(ω) G]         ω a BSDF sample, p per solid angle (emission)

f contains the cosine at x_k. G is the cosine at the other end over the squared distance. J is the Jacobian from the
reference surface. [.] is detached. The weights w are those of the balance heuristic (Veach 1997). Contributions are
differentiable functions of the scene; their derivative is the interior term. Choices and densities are detached. At
infinity G = J = 1. Behind a delta lobe the next vertex slides, because the ray that mirrors and smooth glass continue
moves.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.geometry import queries
from jaxdr.geometry.vector import normalize, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.bsdf.base import DeltaSample
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted, emitter_pdf, radiance_towards, sample_emitter
from jaxdr.transport.interaction import SurfacePoint, either, intersect, material_hit, on_fixed_ray
from jaxdr.transport.mirrored_pairs import Ends, Previous, has_pairs, pair_derivatives
from jaxdr.transport.near_field import Footprint, NearField, footprint
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.transfer import Transfer, Vertex, transfer_to, unoccluded


class Segments(NamedTuple):
    """Path segments from an apex, nearer to the camera, to a target: [B, N, ...] of B bounces of N paths; detached.

    - `apex`, `target`: (face, barycentric) material points. The apex of bounce 0 is the first hit instead.
    - `infinite`: whether the target is the environment, in `direction`.
    - `weight`: f / pdf (RGB) of all paths through the segment, without its own BSDF value at the apex and without its
      geometric term. It is the throughput to the apex times the radiance that arrives, over the density of the target
      (per area; at infinity per solid angle).
    - `visible`: false where an emitter sample is occluded. Its weight is as if it were not occluded.
    - `throughput`: to the apex; for emitter samples only.
    - `unlit`: the weight without the radiance. None unless the environment's radiance depends on the direction, or a
      surface's radiance on the point.
    - `lobe`: of BSDF-sampled segments, the throughput over the density of `direction` (solid angle), also where the ray
      hits nothing.
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
    """Differentiable path vertices, in scenes where vertices behind `delta` lobes slide."""

    position: Float[Array, "B N 3"]
    shading_normal: Float[Array, "B N 3"]
    delta: Bool[Array, "B N"]


class NearLight(NamedTuple):
    """Light that the first hits of N paths scatter, and the shares that are taken in material form; detached.

    `light` comes from emitter sampling, `beyond` over the BSDF-sampled segment.
    """

    light: Float[Array, "N 3"]
    beyond: Float[Array, "N 3"]
    light_share: Float[Array, " N"]
    beyond_share: Float[Array, " N"]


class PathRecord(NamedTuple):
    """Radiance towards the camera of N paths, and the segments behind the first hit.

    - `direct`: connections to emitter samples, which carry all direct light; None if there are none.
    - `scattered`: BSDF-sampled segments, which carry the light gathered at their far end and beyond; None if there are
      none.
    - `vertices`: the apexes of the segments; None if no vertex may slide.
    - `near`: the light that first hits take in material form; None if they have one form.
    """

    radiance: Float[Array, "N 3"]
    direct: Segments | None
    scattered: Segments | None
    vertices: Vertices | None = None
    near: NearLight | None = None


class Lobe(NamedTuple):
    """Directions that replace BSDF samples where `pdf` (solid angle) is positive; detached."""

    direction: Float[Array, "N 3"]
    pdf: Float[Array, " N"]


class Onwards(NamedTuple):
    """Where paths go on from their vertices, and what replaces BSDF samples there, if anything."""

    where: bool | Bool[Array, "*#N"] = True
    given: Lobe | None = None


class TwoForms(NamedTuple):
    """Points that may move in two forms.

    `seen`: the pixel's footprints there, of size zero at points with one form. `apart`: the material form minus the
    points; None if nothing is differentiated.
    """

    seen: Footprint
    apart: Float[Array, "N 3"] | None = None


class Bounce(NamedTuple):
    """What one vertex of N paths adds.

    - `light`: by emitter sampling. `emission`: found by BSDF sampling.
    - `light_share`, `beyond_share`: shares in material form of the emitter sample's light, and of all light over the
      BSDF-sampled segment; None without a footprint.
    - `scattered`: None if no direction was sampled. Its weight is the BSDF value times geometric term.
    """

    light: Float[Array, "N 3"]
    emission: Float[Array, "N 3"]
    light_share: Float[Array, " N"] | None
    beyond_share: Float[Array, " N"] | None
    direct: Segments | None
    scattered: Segments | None
    vertices: Vertices | None = None


def trace_paths(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
    near: NearField | None = None,
) -> PathRecord:
    """Paths that go on from first hits, by emitter sampling and BSDF sampling.

    `direction` is that of the rays that found the hits, `u` are the uniform numbers of the first bounce. The balance
    heuristic (Veach 1997) combines both ways of sampling. Without `settings.mis` only emitter sampling finds emitters,
    except over delta lobes, where only BSDF samples find them. `near` is the material form of the first hits. The
    radiance is that of the fixed form; see `near_field_term`.
    """
    radiance = emitted(packed, first, -direction)
    bounces = settings.max_depth - 1
    if bounces == 0:
        return PathRecord(radiance, None, None)
    start = Vertex(first, -direction, jnp.ones_like(direction))
    parts = gather(packed, start, bounces, u, key, settings, near)
    light, emission = parts.light, parts.emission
    own = stop_gradient(light + emission)
    # The light that each BSDF-sampled segment carries from its far end: the sum of what later bounces add.
    beyond = jnp.cumsum(own[::-1], axis=0)[::-1] - own
    near_light = None
    if near is not None:
        shares = parts.light_share[0], parts.beyond_share[0]
        near_light = NearLight(stop_gradient(light[0]), stop_gradient(emission[0]) + beyond[0], *shares)
    scattered = None
    if bounces > 1:
        scattered = jax.tree.map(lambda x: x[: bounces - 1], parts.scattered)
        transfer = scattered.weight  # so far: BSDF value times geometric term of the segment itself
        scattered = scattered._replace(weight=safe_divide(beyond[:-1], transfer, otherwise=0.0))
    return PathRecord(
        radiance + light.sum(0) + emission.sum(0),
        stop_gradient(parts.direct),
        stop_gradient(scattered),
        parts.vertices,
        near_light,
    )


def gather(
    packed: PackedScene,
    start: Vertex,
    bounces: int,
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
    near: NearField | None,
) -> Bounce:
    """All bounces of paths from their first vertex on, [B, N, ...]; `u` are the numbers of the first bounce."""
    if bounces == 1:
        added = scatter(packed, start, u, settings, Onwards(not ends_early(packed, settings)))[1]
        return jax.tree.map(lambda x: x[None], added)
    seen = None
    if near is not None:
        seen = stop_gradient(footprint(near.camera, start.point.position, start.point.normal))

    @queries.rematerialised
    def step(state, bounce):
        at, previous = state
        numbers = jnp.where(bounce == 0, u, uniform(jax.random.fold_in(key, bounce), u.shape, u.dtype))
        forms = None
        if near is not None:  # only first hits have two forms
            sees = seen._replace(size2=jnp.where(bounce == 0, seen.size2, 0.0))
            forms = TwoForms(sees, near.point.position - start.point.position)
        goes_on = bounce < bounces - 1 if ends_early(packed, settings) else True
        behind = None
        if previous is not None:
            saw = None if seen is None else seen._replace(size2=jnp.where(bounce == 1, seen.size2, 0.0))
            vertex, spread = previous
            behind = Previous(vertex, spread, saw, None if forms is None else forms.apart)
        following, added = scatter(packed, at, numbers, settings, Onwards(goes_on), forms, behind)
        if previous is not None:
            previous = at, jnp.ones_like(at.point.valid) if added.vertices is None else ~added.vertices.delta
        return (following, previous), added

    nobody = (start, jnp.zeros_like(start.point.valid)) if settings.pairs and has_pairs(packed) else None
    return loops.scan(step, (start, nobody), jnp.arange(bounces))[1]


def ends_early(packed: PackedScene, settings: PathSettings) -> bool:
    """Whether the last bounce needs no BSDF ray: BSDF samples do not look for emitters, and there is no delta lobe."""
    return not (settings.mis or packed.has_delta_lobes)


def scatter(
    packed: PackedScene,
    at: Vertex,
    u: Float[Array, "N 4"],
    settings: PathSettings,
    onwards: Onwards,
    forms: TwoForms | None = None,
    previous: Previous | None = None,
) -> tuple[Vertex | None, Bounce]:
    """(next vertex, what this vertex adds): light by emitter sampling, and by BSDF sampling where paths go `onwards`.

    With `forms`, the shares of the material form are computed as well, and the path goes on from the mixture of both
    forms. With the `previous` vertices, derivatives at narrow lobes are those of pairs; see `mirrored_pairs`.
    """
    scatterer = Scatterer(packed, at.point, at.wi)
    light, light_share, ends, direct = _connect(packed, at, scatterer, u[:, :2], settings, forms)
    if onwards.where is False:
        return None, Bounce(light, jnp.zeros_like(light), light_share, None, direct, None)
    sampled = _sample(packed, at, scatterer, u[:, 2:], onwards)
    target, direction = _next_point(packed, at, scatterer, sampled, settings)
    hit = target.valid

    # T' = T f G J / [p G], in area measure. At infinity and behind a delta lobe there is no G.
    transfer = transfer_to(scatterer, target, ~hit, direction)
    value, geometry, in_angle = transfer.value, transfer.geometry, ~hit
    if sampled.delta is not None and sampled.chosen is not None:  # both or none are
        in_angle = ~hit | sampled.chosen
        value = jnp.where(sampled.chosen[:, None], sampled.delta.weight, value)
        geometry = jnp.where(sampled.chosen, 1.0, geometry)
    density = sampled.pdf * stop_gradient(geometry)
    carries = sampled.active & (density > 0)
    throughput = scale(at.throughput * value, 1.0 / jnp.where(carries, density, 1.0))
    throughput = jnp.where(carries[:, None], throughput, 0.0)

    beyond_share, back = None, -transfer.towards
    if forms is not None:
        beyond_share = jnp.where(in_angle, 0.0, forms.seen.share(stop_gradient(transfer.distance2)))
        if forms.apart is not None:
            # The direction back to the first hit, which moves in the mixture of both forms.
            moved = scale(forms.apart - stop_gradient(forms.apart), beyond_share)
            mixed = at.point.position + moved - target.position
            back = jnp.where(hit[:, None], normalize(jnp.where(hit[:, None], mixed, 1.0)), -direction)
    emission = _found_emission(packed, scatterer, Vertex(target, back, throughput), transfer, sampled, settings)
    if previous is not None:
        found = _found_ends(packed, scatterer, target, transfer, direction, sampled, ends, settings)
        both = (light, ends), (emission, found)
        light, emission = pair_derivatives(packed, previous, at, scatterer, *both, settings)
    goes_on = carries if settings.black else (throughput != 0).any(-1)
    following = target._replace(valid=hit & goes_on)
    scattered = _record(at, target, transfer, sampled) if settings.records else None
    vertices = None
    if settings.records and sampled.chosen is not None:
        vertices = Vertices(at.point.position, at.point.shading_normal, sampled.chosen)
    added = Bounce(light, emission, light_share, beyond_share, direct, scattered, vertices)
    return Vertex(following, back, throughput), added


class _Sampled(NamedTuple):
    """Detached unit `direction` and its `pdf` (solid angle, or the probability of a `delta` lobe), where `active`.

    `own` is the BSDF's density, also for given directions; emitter samples are weighted against it. `chosen` tells
    where a delta lobe was chosen. `delta` and `chosen` are None in scenes without delta lobes.
    """

    direction: Float[Array, "N 3"]
    pdf: Float[Array, " N"]
    own: Float[Array, " N"]
    active: Bool[Array, " N"]
    delta: DeltaSample | None
    chosen: Bool[Array, " N"] | None


def _sample(packed: PackedScene, at: Vertex, scatterer: Scatterer, u, onwards: Onwards) -> _Sampled:
    direction, delta, chosen = scatterer.sample(u), None, None
    where, given = onwards
    if given is not None:
        direction = jnp.where((given.pdf > 0)[:, None], given.direction, direction)
    own = scatterer.pdf(direction)
    pdf = own if given is None else jnp.where(given.pdf > 0, given.pdf, own)
    if packed.has_delta_lobes:
        delta = scatterer.sample_delta(u)
        chosen = delta.probability > 0
        direction = jnp.where(chosen[:, None], stop_gradient(delta.wo), direction)
        pdf = jnp.where(chosen, stop_gradient(delta.probability), pdf)
    active = at.point.valid & (pdf > 0)
    return _Sampled(direction, pdf, own, active if where is True else active & where, delta, chosen)


def _next_point(packed: PackedScene, at: Vertex, scatterer: Scatterer, sampled: _Sampled, settings: PathSettings):
    """(hits of sampled rays: material points, or sliding points behind delta lobes; the differentiable directions)."""
    origin = scatterer.leave(sampled.direction)
    found = intersect(packed, origin, sampled.direction, sampled.active, settings.rays)
    target, direction = material_hit(packed, found), sampled.direction
    hit = target.valid
    if packed.environment_turns:
        direction = jnp.where(hit[:, None], direction, packed.turned(direction))
    if sampled.delta is not None:
        slides = sampled.chosen & hit
        direction = jnp.where(sampled.chosen[:, None], sampled.delta.wo, direction)
        sliding = on_fixed_ray(
            packed, at.point.position, direction, jnp.where(slides, found.face, -1), target.barycentric
        )
        target = either(slides, sliding._replace(barycentric=target.barycentric), target)
    return target, direction


def _connect(packed, at: Vertex, scatterer: Scatterer, u, settings: PathSettings, forms: TwoForms | None):
    """(direct light at a vertex from one emitter sample, its share in material form, the sample, the segment to it)."""
    point = at.point
    sample = sample_emitter(packed, u, point.position)
    delta = sample.is_delta
    transfer = transfer_to(scatterer, sample.point, sample.infinite, sample.direction, delta)
    towards = transfer.towards
    facing = stop_gradient(transfer.cosine) > 0
    reachable = point.valid & facing & transfer.scatters(scatterer, settings.black)
    visible = unoccluded(packed, scatterer, sample.point, sample.infinite, towards, reachable, settings.rays)
    share = None
    if forms is not None:
        far = sample.infinite if delta is None else sample.infinite | delta
        share = jnp.where(far, 0.0, forms.seen.share(stop_gradient(transfer.distance2)))
    arriving = at.throughput * scale(radiance_towards(packed, sample, towards), 1.0 / sample.pdf)
    light = arriving * transfer.value
    if settings.mis:
        per_angle = stop_gradient(transfer.distance2 / jnp.where(reachable, transfer.cosine, 1.0)) * sample.pdf
        # Not `sampling.balance`: with its condition XLA rounds a batch of images otherwise than single ones.
        weight = per_angle / (per_angle + scatterer.pdf(towards))
        # No other sampling finds lights without area, so their weight is one.
        light = scale(light, weight if delta is None else jnp.where(delta, 1.0, weight))
    light = jnp.where(visible[:, None], light, 0.0)
    ends = Ends(sample.point, sample.infinite, sample.direction, visible, point.valid, sample.light)
    if not settings.records:
        return light, share, ends, None
    # Lights without area carry no segments: `boundary.film.hard_shadows` finds their shadows.
    carries = reachable & transfer.scatters(scatterer, False) if settings.black else reachable
    carries = carries if delta is None else carries & ~delta
    lit = point.valid & scatterer.spreads() if packed.has_delta_lobes else point.valid
    unlit = None
    if packed.has_varying_sky or packed.glow:
        unlit = stop_gradient(scale(at.throughput, jnp.where(carries, 1.0 / sample.pdf, 0.0)))
    segment = Segments(
        apex_face=point.face,
        apex_barycentric=point.barycentric,
        target_face=sample.point.face,
        target_barycentric=sample.point.barycentric,
        infinite=sample.infinite,
        direction=stop_gradient(sample.direction),
        weight=jnp.where(carries[:, None], stop_gradient(arriving), 0.0),
        visible=visible,
        throughput=jnp.where(lit[:, None], stop_gradient(at.throughput), 0.0),
        unlit=unlit,
    )
    return light, share, ends, segment


def _found_emission(
    packed, scatterer: Scatterer, found: Vertex, transfer: Transfer, sampled: _Sampled, settings: PathSettings
) -> Float[Array, "N 3"]:
    """Radiance that BSDF samples find, weighted against emitter samples."""
    target = found.point
    if not settings.mis and sampled.chosen is None:
        return jnp.zeros_like(found.throughput)
    weight = jnp.zeros_like(sampled.pdf)
    if settings.mis:
        still = stop_gradient(transfer)
        lit, cosine = scatterer.point.position, jnp.abs(still.cosine)
        other = emitter_pdf(packed, stop_gradient(target), still.towards, still.distance2, cosine, lit)
        weight = sampled.own / jnp.where(sampled.active & (sampled.own > 0), sampled.own + other, 1.0)
    if sampled.chosen is not None:
        weight = jnp.where(sampled.chosen, 1.0, weight)  # emitter samples never find light over a delta lobe
    return scale(found.throughput * emitted(packed, target, found.wi), stop_gradient(weight))


def _found_ends(
    packed,
    scatterer: Scatterer,
    target: SurfacePoint,
    transfer: Transfer,
    direction,
    sampled: _Sampled,
    ends: Ends,
    settings: PathSettings,
) -> Ends:
    """The emitters that BSDF samples find and emitter samples could find; `ends` are those of emitter samples."""
    hit = target.valid
    glows = jnp.full_like(hit, packed.environment is not None)
    if packed.emitter_density is not None:
        on_surface = (packed.emitter_density[target.face] > 0) & (stop_gradient(transfer.cosine) > 0)
        glows = jnp.where(hit, on_surface, glows)
    else:
        glows = glows & ~hit
    drawn = sampled.active & glows & settings.mis & transfer.scatters(scatterer, settings.black)
    if sampled.chosen is not None:
        drawn = drawn & ~sampled.chosen
    light = None if ends.light is None else jnp.full_like(ends.light, -1)
    return Ends(target, ~hit, direction, drawn, drawn, light)


def _record(at: Vertex, target: SurfacePoint, transfer: Transfer, sampled: _Sampled) -> Segments:
    """The BSDF-sampled segments. Those of delta lobes have weight zero: kernels over directions need a density."""
    hit, spread = target.valid, sampled.active
    if sampled.chosen is not None:
        spread = spread & ~sampled.chosen
    carries = hit if sampled.chosen is None else hit & spread
    per_angle = jnp.where(spread, 1.0 / jnp.where(spread, sampled.pdf, 1.0), 0.0)
    return Segments(
        apex_face=at.point.face,
        apex_barycentric=at.point.barycentric,
        target_face=target.face,
        target_barycentric=target.barycentric,
        infinite=sampled.active & ~hit,
        direction=sampled.direction,
        weight=jnp.where(carries[:, None], stop_gradient(transfer.value), 0.0),
        visible=hit,
        lobe=scale(stop_gradient(at.throughput), per_angle),
    )
