"""The emitters' end of paths: rays that leave emitters, and their densities.

Rays leave surfaces by the cosine law, and lights without area as their class says. From infinitely far away they come
through a disk that is perpendicular to the direction and covers the scene.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import Frame, dot, norm, orthonormal_basis
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import cosine_hemisphere, uniform_disk
from jaxdr.transport.emission import EmitterSample
from jaxdr.transport.interaction import SurfacePoint, leave

MARGIN = 1e-4  # the disk is larger than needed by this share, so that rounding does not darken the scene's corners


class LightRays(NamedTuple):
    """Rays that leave emitters, detached: `start` just off the emitter, unit `direction`.

    `pdf` is per solid angle, or per area across the direction where the emitter is infinitely far away.
    """

    start: Float[Array, "N 3"]
    direction: Float[Array, "N 3"]
    pdf: Float[Array, " N"]


def light_rays(packed: PackedScene, sample: EmitterSample, u: Float[Array, "N 2"]) -> LightRays:
    """A ray from each emitter sample."""
    direction = jnp.zeros_like(sample.direction)
    if packed.has_area_emitters:
        normal = stop_gradient(sample.point.normal)
        s, t = orthonormal_basis(normal)
        direction = Frame(s, t, normal).to_world(cosine_hemisphere(u))
    for number, here, group in _finite_lights(packed, sample):
        direction = jnp.where(here[:, None], group.at(number).sample(u), direction)
    start = leave(sample.point, direction)
    if _has_infinite(packed):
        centre, radius = bounding_sphere(packed)
        across, infinite = stop_gradient(sample.direction), sample.infinite[:, None]
        s, t = orthonormal_basis(across)
        disk = uniform_disk(u)
        far = centre + radius * (across + disk[:, :1] * s + disk[:, 1:] * t)
        direction, start = jnp.where(infinite, -across, direction), jnp.where(infinite, far, start)
    direction = stop_gradient(direction)
    return LightRays(stop_gradient(start), direction, emission_pdf(packed, sample, direction))


def emission_pdf(packed: PackedScene, sample: EmitterSample, direction: Float[Array, "N 3"]) -> Float[Array, " N"]:
    """Density with which `light_rays` leave emitter samples in unit `direction`; measures as in `LightRays`."""
    pdf = jnp.zeros_like(sample.pdf)
    if packed.has_area_emitters:
        pdf = surface_emission_pdf(sample.point, direction)
    for number, here, group in _finite_lights(packed, sample):
        pdf = jnp.where(here, group.at(number).pdf(direction), pdf)
    if _has_infinite(packed):
        pdf = jnp.where(sample.infinite, disk_pdf(packed), pdf)
    return stop_gradient(pdf)


def surface_emission_pdf(point: SurfacePoint, direction: Float[Array, "N 3"]) -> Float[Array, " N"]:
    """Density (solid angle, detached) with which rays leave points on emitting surfaces in unit `direction`."""
    return stop_gradient(jnp.maximum(dot(point.normal, direction), 0.0) / math.pi)


def disk_pdf(packed: PackedScene) -> Float[Array, ""]:
    """Density (area across the direction) of rays from infinitely far away."""
    _, radius = bounding_sphere(packed)
    return 1.0 / (math.pi * radius * radius)


def bounding_sphere(packed: PackedScene) -> tuple[Float[Array, "3"], Float[Array, ""]]:
    """(centre, radius) of a sphere around the whole scene, detached."""
    points = stop_gradient(packed.vertices)
    lower, upper = points.min(0), points.max(0)
    return 0.5 * (lower + upper), 0.5 * (1.0 + MARGIN) * norm(upper - lower)


def _has_infinite(packed: PackedScene) -> bool:
    return packed.environment is not None or any(group.light.infinite for group in packed.lights)


def _finite_lights(packed: PackedScene, sample: EmitterSample):
    """(numbers of the lights, which samples are on one of the group, group) for lights without area at a point."""
    for group in packed.lights:
        if not group.light.infinite:
            assert sample.light is not None  # set if the scene has such lights
            number = jnp.maximum(sample.light, 0)
            here: Bool[Array, " N"] = (sample.light >= 0) & group.member[number]
            yield number, here, group
