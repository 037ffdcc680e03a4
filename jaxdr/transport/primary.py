"""The camera's end of the paths: film points, rays, first hits, and how the first hits move."""

from enum import Enum
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.scene.camera import View
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, intersect, material_point, on_fixed_ray
from jaxdr.transport.near_field import NearField, film_importance
from jaxdr.transport.sampler import FIRST_DIMENSIONS, LENS_DIMENSIONS, lattice


class Form(Enum):
    """How first hits move.

    - `FIXED`: along the camera ray, which is fixed.
    - `NEAR`: the same, but light from close by is taken in material form.
    - `MATERIAL`: with their surfaces, as material points.
    """

    FIXED = "fixed"
    NEAR = "near"
    MATERIAL = "material"


class PrimarySamples(NamedTuple):
    """First hits of N = pixels x samples camera rays; the samples of a pixel follow each other.

    - `view`: the camera with the samples' lens points, if it has an aperture.
    - `direction`: of the rays.
    - `u`: uniform numbers for the first bounce.
    - `weight`: one in value. In the "material" form its derivative is that of filter x geometric term x area.
    - `near`: the first hits in material form, for the near field; None in the other forms.
    """

    view: View
    first: SurfacePoint
    direction: Float[Array, "N 3"]
    u: Float[Array, "N 4"]
    weight: Float[Array, " N"]
    near: NearField | None


def primary_samples(
    packed: PackedScene, samples: Int[Array, " n"], key: PRNGKeyArray, rays: str, form: Form
) -> PrimarySamples:
    """Camera samples number `samples` of every pixel; `form` says how first hits move.

    With fixed rays first hits slide over the surfaces. As material points they move with the surfaces. Then pairs of
    samples have opposite film offsets and else the same random numbers: the filter's derivative is odd, so most of its
    noise cancels. Samples that hit nothing stay fixed on the film in all forms.
    """
    camera, film = packed.camera, packed.camera.film
    x0, y0, width, height = film.window
    pixels, count, dtype = width * height, samples.shape[0], packed.vertices.dtype
    number = samples // 2 if form == Form.MATERIAL else samples
    dimensions = FIRST_DIMENSIONS + (LENS_DIMENSIONS if camera.aperture else 0)
    u = lattice(key, pixels, number, dimensions, dtype)
    offset = film.filter.sample(u[:, :2])
    if form == Form.MATERIAL:
        offset = jnp.where((jnp.tile(samples, pixels) % 2 == 1)[:, None], -offset, offset)
    row, column = jnp.divmod(jnp.arange(pixels), width)
    centre = jnp.repeat(jnp.stack([column + x0, row + y0], -1).astype(dtype) + 0.5, count, axis=0)
    view = camera.view(u[:, FIRST_DIMENSIONS:] if camera.aperture else None)
    origin, direction = view.rays(centre + offset)
    origin = jnp.broadcast_to(origin, direction.shape)
    start, reach = view.clipped(origin, direction)
    hit = intersect(packed, start, direction, jnp.ones(pixels * count, bool), rays, reach)
    first = on_fixed_ray(packed, origin, direction, hit.face, hit.barycentric)
    weight, near = jnp.ones(pixels * count, dtype), None
    if form != Form.FIXED:
        moving = material_point(packed, first.face, first.barycentric, first.valid)
        importance = jnp.where(first.valid, film_importance(view, moving, centre), 1.0)
        near = NearField(view, moving, importance)
    if form == Form.MATERIAL:
        direction = jnp.where(first.valid[:, None], -near.wi, direction)
        first, weight, near = near.point, near.importance, None
    return PrimarySamples(view, first, direction, u[:, 2:FIRST_DIMENSIONS], weight, near)
