"""Flux of moving light through pixel borders: the derivative of a box filter for light in material form.

Light from near a first hit moves with the hit (`transport.near_field`), so it leaves one pixel and enters another. With
a smooth filter the filter's own derivative accounts for that. A box is constant on its pixel: what remains is the flux
through the border, radiance x normal velocity of the material point's film position. One path serves both pixels.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from jaxdr.boundary.shared.term import Chunk, Context, streams
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, intersect, material_point, on_fixed_ray
from jaxdr.transport.near_field import footprint
from jaxdr.transport.primary import Form
from jaxdr.transport.radiance import Answers, request
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice


class _Held(NamedTuple):
    """First hits of rays through the borders, and the rays' points on the aperture (None without an aperture)."""

    first: SurfacePoint
    lens: Float[Array, "n 2"] | None


class PixelBorders:
    """Term of the light that moves through the sides of pixels, from points on every side."""

    name = "pixel_borders"

    def prepare(self, context: Context, key):
        """An empty state; None without a box filter, without light in material form, or if nothing moves."""
        del key
        here = context.form == Form.NEAR and context.packed.camera.film.filter.tiles and any(context.moving.seen)
        return () if here else None

    def draw(self, context: Context, state, chunk: Chunk, key):
        """Rays through the sides across both film axes, and requests for the light in material form along them."""
        packed, settings, dtype = context.packed, context.settings, context.packed.vertices.dtype
        x0, y0, _, _ = packed.camera.film.window
        count, aperture = _points(context, chunk), packed.camera.aperture
        dimensions = 5 + (LENS_DIMENSIONS if aperture else 0)
        film_points, numbers = [], []
        for axis, key_axis in enumerate(jax.random.split(key)):
            rows, columns = _sides(packed, axis)
            u = lattice(key_axis, rows * columns, jnp.arange(count), dimensions, dtype)
            row, column = jnp.divmod(jnp.arange(rows * columns), columns)
            corner = jnp.repeat(jnp.stack([column + x0, row + y0], -1).astype(dtype), count, axis=0)
            film_points.append(corner.at[:, 1 - axis].add(u[:, 0]))
            numbers.append(u)
        film_point, u = jnp.concatenate(film_points), jnp.concatenate(numbers)
        lens = u[:, 5:] if aperture else None
        view = packed.camera.view(lens)
        origin, direction = view.rays(film_point)
        origin = jnp.broadcast_to(origin, direction.shape)
        start, reach = view.clipped(origin, direction)
        hit = intersect(packed, start, direction, jnp.ones(u.shape[0], bool), settings.rays, reach)
        first = on_fixed_ray(packed, origin, direction, hit.face, hit.barycentric)
        seen = footprint(view, first.position, first.normal)
        stream = streams(self.name, u.shape[0])
        asked = request(first, -direction, u[:, 1:5], settings.max_depth - 1, stream, 0.0)
        return asked._replace(seen=seen), _Held(first, lens)

    def image(
        self, context: Context, state, chunk: Chunk, held: _Held, answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """The flux through each side, taken from one of its two pixels and added to the other."""
        assert answers is not None  # `draw` always asks
        packed, first = context.packed, held.first
        view, count = packed.camera.view(held.lens), _points(context, chunk)
        moving = material_point(packed, first.face, first.barycentric, first.valid)
        ahead = jnp.asarray([0.0, 0.0, 1.0], moving.position.dtype)
        seen = view.project_local(jnp.where(first.valid[:, None], view.local(moving.position), ahead))
        moved = jnp.where(first.valid[:, None], seen - stop_gradient(seen), 0.0)
        fluxes, begin = [], 0
        for axis in (0, 1):
            rows, columns = _sides(packed, axis)
            end = begin + rows * columns * count
            flux = answers.near[begin:end] * moved[begin:end, axis, None]
            fluxes.append(flux.reshape(rows, columns, count, 3).mean(2))
            begin = end
        across, down = fluxes
        return chunk.share * (across[:, :-1] - across[:, 1:] + down[:-1] - down[1:])


def _points(context: Context, chunk: Chunk) -> int:
    """How many points are drawn on each side of a pixel."""
    return max(1, round(chunk.samples.shape[0] * context.edge_samples / 4))


def _sides(packed: PackedScene, axis: int) -> tuple[int, int]:
    """(rows, columns) of the pixel sides that are perpendicular to a film axis."""
    _, _, width, height = packed.camera.film.window
    return (height, width + 1) if axis == 0 else (height + 1, width)
