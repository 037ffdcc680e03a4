"""Emitters of a packed scene: sampling, densities and radiance."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import dot, from_components, normalize
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import search_sorted_rows, uniform_triangle
from jaxdr.transport.interaction import SurfacePoint, material_point


class EmitterSample(NamedTuple):
    """Points on emitters, or directions to the environment (see `PackedScene.turned`), with their densities.

    `pdf` is per area at `point`, or per solid angle where `infinite`; detached. `direction` is set where `infinite`.
    `light` is the number of the chosen light without area, -1 for other emitters; None if the scene has no such lights.
    For these lights `pdf` is a probability, `point` has only a position, and `radiance_towards` gives their intensity.
    """

    point: SurfacePoint
    infinite: Bool[Array, " N"]
    direction: Float[Array, "N 3"]
    radiance: Float[Array, "N 3"]
    pdf: Float[Array, " N"]
    light: Int[Array, " N"] | None = None

    @property
    def is_delta(self) -> Bool[Array, " N"] | None:
        """Whether samples are lights without area; None if the scene has none."""
        return None if self.light is None else self.light >= 0

    def direction_from(self, position: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        """Unit directions to the samples from points of the scene."""
        return jnp.where(self.infinite[:, None], self.direction, normalize(self.point.position - position))

    def shines_on(self, towards: Float[Array, "N 3"]) -> Bool[Array, " N"]:
        """Whether samples emit light against `towards` (of any length); False for lights without area."""
        glows = self.infinite | (dot(self.point.normal, towards) < 0)
        return glows if self.is_delta is None else glows & ~self.is_delta


class Shares(NamedTuple):
    """Probabilities of choosing the environment, surfaces, and each light; plain numbers if there is one kind only."""

    environment: Float[Array, ""] | float
    surfaces: Float[Array, ""] | float
    lights: Float[Array, " D"] | float


def emitter_shares(packed: PackedScene) -> Shares:
    """The probabilities with which emitters are chosen."""
    if packed.choice is None:
        environment = 0.0 if packed.environment is None else 1.0
        return Shares(environment, 1.0 - environment, 1.0)
    each = jnp.diff(packed.choice, prepend=0.0)
    environment, surfaces, first = 0.0, 0.0, 0
    if packed.environment is not None:
        environment, first = each[0], 1
    if packed.has_area_emitters:
        surfaces, first = each[first], first + 1
    return Shares(environment, surfaces, each[first:])


def has_emitters(packed: PackedScene) -> bool:
    """Whether anything in the scene emits light."""
    return packed.environment is not None or packed.has_area_emitters or packed.light_count > 0


def environment_radiance(packed: PackedScene, direction: Float[Array, "N 3"]) -> Float[Array, "*#N 3"]:
    """Radiance of the environment from unit world directions, differentiable in them."""
    return packed.environment.eval(direction)


def surface_radiance(packed: PackedScene, point: SurfacePoint) -> Float[Array, "N 3"]:
    """Radiance of points on emitting surfaces, on the side of their normal; zero for other surfaces."""
    return packed.surface_radiance(point.face, point.on_face)


def sample_emitter(
    packed: PackedScene, u: Float[Array, "N 2"], apex: Float[Array, "N 3"] | None = None
) -> EmitterSample:
    """Material points on emitters, directions to the environment, or lights without area, chosen by power.

    With `apex`, the positions that are lit, clusters of emitting faces are chosen by the light they may send there.
    """
    n, dtype = u.shape[0], u.dtype
    shares = emitter_shares(packed)
    infinite = jnp.full(n, packed.environment is not None)
    light = jnp.zeros(n, jnp.int32) if packed.light_count else None
    if packed.choice is not None:
        kind, left = search_sorted_rows(packed.choice[None], jnp.zeros(n, jnp.int32), u[:, 0])
        u = jnp.stack([left, u[:, 1]], -1)
        infinite = (kind == 0) & infinite
        if light is not None:
            light = jnp.maximum(kind - (packed.choice.shape[0] - packed.light_count), -1)
    direction = jnp.zeros((n, 3), dtype)
    radiance, pdf = jnp.zeros((n, 3), dtype), jnp.ones(n, dtype)
    if packed.has_area_emitters:
        point, per_area = sample_emitting_surface(packed, u, apex)
        point = point._replace(valid=~infinite)
        radiance = surface_radiance(packed, point)
        pdf = shares.surfaces * per_area
    else:
        nowhere = jnp.zeros(n, jnp.int32)
        point = material_point(packed, nowhere, jnp.full((n, 3), 1 / 3, dtype), ~infinite)
    if packed.environment is not None:
        direction = packed.turned(packed.environment_sampler.sample(u))
        radiance = jnp.where(infinite[:, None], environment_radiance(packed, direction), radiance)
        pdf = jnp.where(infinite, shares.environment * packed.environment_sampler.pdf(direction), pdf)
    sample = EmitterSample(point, infinite, direction, radiance, stop_gradient(pdf))
    return sample if light is None else _with_lights(packed, sample, light, shares)


def _with_lights(packed: PackedScene, sample: EmitterSample, light, shares: Shares) -> EmitterSample:
    """Samples, replaced by lights without area where `light` chooses one."""
    chosen = light >= 0
    number = jnp.maximum(light, 0)
    position, direction, infinite = sample.point.position, sample.direction, sample.infinite & ~chosen
    for group in packed.lights:
        here = chosen & group.member[number]
        place = packed.place_of(group, number)
        if group.light.infinite:
            infinite = infinite | here
            direction = jnp.where(here[:, None], place, direction)
        else:
            position = jnp.where(here[:, None], place, position)
    point = sample.point
    point = point._replace(
        valid=point.valid & ~chosen,
        position=position,
        area=jnp.where(chosen, 1.0, point.area),
        scale=jnp.where(chosen, 0.0, point.scale),
    )
    share = jnp.broadcast_to(jnp.asarray(shares.lights, sample.pdf.dtype), packed.light_count)[number]
    radiance, pdf = jnp.where(chosen[:, None], 0.0, sample.radiance), jnp.where(chosen, share, sample.pdf)
    return EmitterSample(point, infinite, direction, radiance, stop_gradient(pdf), light)


def radiance_towards(packed: PackedScene, sample: EmitterSample, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Radiance of samples, or intensity of lights without area; `towards`: unit directions to them."""
    if sample.light is None:
        return sample.radiance
    intensity = light_intensity(packed, jnp.maximum(sample.light, 0), -towards)
    return jnp.where(sample.is_delta[:, None], intensity, sample.radiance)


def light_places(packed: PackedScene) -> tuple[Float[Array, "D 3"], Bool[Array, " D"]]:
    """(positions of the lights without area or directions towards them, whether they are infinitely far away)."""
    number = jnp.arange(packed.light_count)
    place, infinite = jnp.zeros((packed.light_count, 3), packed.vertices.dtype), jnp.zeros(packed.light_count, bool)
    for group in packed.lights:
        place = jnp.where(group.member[:, None], packed.place_of(group, number), place)
        infinite = jnp.where(group.member, group.light.infinite, infinite)
    return place, infinite


def light_intensity(
    packed: PackedScene, number: Int[Array, " N"], direction: Float[Array, "N 3"]
) -> Float[Array, "N 3"]:
    """Intensity of lights without area, by their numbers, in unit directions away from them."""
    intensity = jnp.zeros_like(direction)
    for group in packed.lights:
        here = group.member[number][:, None]
        intensity = jnp.where(here, group.at(number).intensity_in(direction), intensity)
    return intensity


def sample_emitting_surface(
    packed: PackedScene, u: Float[Array, "N 2"], apex: Float[Array, "N 3"] | None = None
) -> tuple[SurfacePoint, Float[Array, " N"]]:
    """(material points on area emitters, their densities): in proportion to power. Densities are per area, detached.

    With `apex`, clusters of emitting faces are used if the scene has any; see `EmitterClusters`.
    """
    if apex is not None and packed.clusters is not None:
        face, left = packed.clusters.sample(stop_gradient(apex), u[:, 0])
    else:
        index, left = search_sorted_rows(packed.emitter_cdf[None], jnp.zeros(u.shape[0], jnp.int32), u[:, 0])
        face = packed.emitter_faces[index]
    barycentric = uniform_triangle(from_components(left, u[:, 1]))
    point = material_point(packed, face, barycentric, jnp.ones(face.shape, bool))
    return point, emitting_surface_pdf(packed, point, apex)


def emitting_surface_pdf(
    packed: PackedScene, point: SurfacePoint, apex: Float[Array, "N 3"] | None = None
) -> Float[Array, " N"]:
    """Density (per area, detached) with which `sample_emitting_surface` would choose points."""
    if apex is not None and packed.clusters is not None:
        return packed.clusters.pdf(stop_gradient(apex), point.face)
    return packed.emitter_density[point.face]


def emitter_pdf(
    packed: PackedScene,
    point: SurfacePoint,
    direction: Float[Array, "N 3"],
    distance2,
    cosine,
    apex: Float[Array, "N 3"] | None = None,
) -> Float[Array, " N"]:
    """Density (solid angle) with which `sample_emitter` would choose the hit `point`, or on a miss its `direction`."""
    shares = emitter_shares(packed)
    miss = 0.0 if packed.environment is None else shares.environment * packed.environment_sampler.pdf(direction)
    if not packed.has_area_emitters:
        return jnp.where(point.valid, 0.0, miss).astype(cosine.dtype)
    per_area = shares.surfaces * emitting_surface_pdf(packed, point, apex)
    return jnp.where(point.valid, safe_divide(per_area * distance2, cosine, cosine > 0), miss)


def emitted(packed: PackedScene, point: SurfacePoint, wi: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Radiance that reaches the previous vertex from a hit, or from the environment on a miss.

    `wi` points from the hit towards the previous vertex. Surfaces glow on the side of their normal.
    """
    result = jnp.zeros_like(wi)
    if packed.has_area_emitters:
        front = point.valid & (stop_gradient(dot(point.normal, wi)) > 0)
        result = jnp.where(front[:, None], surface_radiance(packed, point), 0.0)
    if packed.environment is not None:
        result = jnp.where(point.valid[:, None], result, environment_radiance(packed, -wi))
    return result
