"""Flux of moving light through pixel borders: the derivative of a box filter for light in material form.

What is near first hits moves with them (`transport.near_field`), so it leaves pixels and enters others. For a smooth
filter that is the filter's own derivative; a box that is constant on its pixel leaves the flux through the border:
radiance x normal velocity of the material point's film position, along the border. One path serves the two pixels.
"""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import intersect, material_point, on_fixed_ray
from jaxdr.transport.near_field import NearField
from jaxdr.transport.path import PathSettings
from jaxdr.transport.radiance import first_bounce, radiance_by_form
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice


def pixel_border_term(
    packed: PackedScene, count: int, key: PRNGKeyArray, settings: PathSettings
) -> Float[Array, "H W 3"]:
    """Image that is zero in value and right in derivative, from `count` points on every side of a pixel."""
    columns, rows = jax.random.split(key)
    across = _flux(packed, 0, count, columns, settings)
    down = _flux(packed, 1, count, rows, settings)
    return across[:, :-1] - across[:, 1:] + down[:-1] - down[1:]


def _flux(packed: PackedScene, axis: int, count: int, key, settings) -> Float[Array, "rows columns 3"]:
    """Light that moves along a film axis through the sides across it, per side and in the direction of the axis."""
    x0, y0, width, height = packed.camera.film.window
    shape = (height, width + 1) if axis == 0 else (height + 1, width)
    sides, dtype = shape[0] * shape[1], packed.vertices.dtype
    key_first, key_path = jax.random.split(key)
    aperture = packed.camera.aperture
    dimensions = 5 + (LENS_DIMENSIONS if aperture else 0)
    u = lattice(key_first, sides, jnp.arange(count), dimensions, dtype).reshape(sides * count, dimensions)
    row, column = jnp.divmod(jnp.arange(sides), shape[1])
    corner = jnp.repeat(jnp.stack([column + x0, row + y0], -1).astype(dtype), count, axis=0)
    film_point = corner.at[:, 1 - axis].add(u[:, 0])

    view = packed.camera.view(u[:, 5:] if aperture else None)
    detached, still = (jax.tree.map(stop_gradient, x) for x in (packed, view))
    origin, direction = still.rays(film_point)
    origin = jnp.broadcast_to(origin, direction.shape)
    start, reach = still.clipped(origin, direction)
    face = intersect(detached, start, direction, jnp.ones(sides * count, bool), settings.rays, reach)
    first = on_fixed_ray(detached, origin, direction, face)
    near = NearField(still, first, jnp.ones_like(first.area))
    begun = first_bounce(detached, first, direction, u[:, 1:5], settings, near)
    radiance = radiance_by_form(detached, begun, key_path, settings)[1]

    moving = material_point(packed, first.face, first.barycentric, first.valid)
    ahead = jnp.asarray([0.0, 0.0, 1.0], dtype)
    seen = view.project_local(jnp.where(first.valid[:, None], view.local(moving.position), ahead))[:, axis]
    moved = jnp.where(first.valid, seen - stop_gradient(seen), 0.0)
    return (radiance * moved[:, None]).reshape(*shape, count, 3).mean(2)
