"""The camera's end of the paths: film points, rays, first hits, and how the first hits move (DESIGN 1)."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.geometry.vector import dot
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, intersect, material_point, on_fixed_ray
from jaxdr.transport.sampler import FIRST_DIMENSIONS, lattice


class PrimarySamples(NamedTuple):
    """First hits of N = pixels x samples camera rays, the samples of a pixel in a row.

    `direction` of the rays, `u` numbers for the first bounce, `weight` one in value: its derivative is that of the
    filter, the geometric term and the area where first hits are material points.
    """

    first: SurfacePoint
    direction: Float[Array, "N 3"]
    u: Float[Array, "N 4"]
    weight: Float[Array, " N"]


def primary_samples(
    packed: PackedScene, samples: Int[Array, " n"], key: PRNGKeyArray, rays: str, material: bool
) -> PrimarySamples:
    """Camera samples number `samples` of every pixel.

    With fixed rays first hits slide over the surfaces. As `material` points they stay on them, and pairs of samples
    have opposite film offsets and the same random numbers otherwise: the filter's derivative is odd, so most of its
    noise cancels. What no surface covers stays fixed on the film in both forms.
    """
    film = packed.camera.film
    x0, y0, width, height = film.window
    pixels, count, dtype = width * height, samples.shape[0], packed.vertices.dtype
    number = samples // 2 if material else samples
    u = lattice(key, pixels, number, FIRST_DIMENSIONS, dtype).reshape(pixels * count, FIRST_DIMENSIONS)
    offset = film.filter.sample(u[:, :2])
    if material:
        offset = jnp.where((jnp.tile(samples, pixels) % 2 == 1)[:, None], -offset, offset)
    row, column = jnp.divmod(jnp.arange(pixels), width)
    centre = jnp.repeat(jnp.stack([column + x0, row + y0], -1).astype(dtype) + 0.5, count, axis=0)
    origin, direction = packed.camera.rays(centre + offset)
    origin = jnp.broadcast_to(origin, direction.shape)
    face = intersect(packed, origin, direction, jnp.ones(pixels * count, bool), rays)
    first = on_fixed_ray(packed, origin, direction, face)
    weight = jnp.ones(pixels * count, dtype)
    if material:
        first = material_point(packed, first.face, first.barycentric, first.valid)
        weight = jnp.where(first.valid, _film_density(packed, first, centre), 1.0)
    return PrimarySamples(first, direction, u[:, 2:], weight)


def _film_density(packed: PackedScene, point: SurfacePoint, centre) -> Float[Array, " N"]:
    """W_e G J over its detached value: pixel importance at the moving projections of material points (Eq. 2-4)."""
    camera = packed.camera
    local = camera.local(point.position)
    depth = jnp.where(point.valid, local[:, 2], 1.0)
    local = jnp.concatenate([local[:, :2], depth[:, None]], -1)
    importance = camera.film.filter.pdf(camera.project_local(local) - centre)
    # Film area per surface area: |n . (x - o)| / depth^3, times the squared focal length.
    projected = jnp.abs(dot(point.normal, point.position - camera.position)) / depth**3
    value = importance * projected * camera.pixels_per_tangent**2 * point.area_ratio()
    detached = stop_gradient(value)
    return jnp.where(detached > 0, value / jnp.where(detached > 0, detached, 1.0), 1.0)
