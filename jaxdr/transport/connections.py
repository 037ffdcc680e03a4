"""Connections of subpaths: contribution and weight of each strategy (s, t) of bidirectional path tracing.

s vertices come from an emitter, t from the camera (Veach 1997, chapter 10). s = 0: a camera subpath meets an emitter.
s = 1: a vertex is joined with an emitter sample drawn for it. t = 1: a vertex is joined with the lens, and any pixel
may see it. Only camera subpaths find emitters that the camera sees directly. It does not see lights without area.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import dot, normalize
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import (
    EmitterSample,
    emitted,
    emitter_shares,
    emitting_surface_pdf,
    radiance_towards,
)
from jaxdr.transport.interaction import leave
from jaxdr.transport.light_rays import disk_pdf, emission_pdf, surface_emission_pdf
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.subpaths import LARGEST, Subpath, quotient, relative_densities


class Connections(NamedTuple):
    """C connections of N pairs of subpaths, in a row.

    - `value`: contribution of the path over its density, whether it is visible or not.
    - `carries`: whether the geometry lets light pass. The value may be zero there, and its derivative not.
    - `weight`: of the strategy, detached.
    - `start`, `end`: just off the surfaces. The connection is visible if nothing lies between them.
    """

    value: Float[Array, "C 3"]
    carries: Bool[Array, " C"]
    weight: Float[Array, " C"]
    start: Float[Array, "C 3"]
    end: Float[Array, "C 3"]


class Ends(NamedTuple):
    """The vertices x_1, x_2, ... of N subpaths of one kind in a row, [B * N], and their BSDFs, seen from `back`."""

    vertex: Subpath
    scatterer: Scatterer
    paths: int

    def rows(self, numbers: list[int], wi: Float[Array, "M 3"] | None = None) -> "Ends":
        """The vertices 1 + `numbers`, [M], M = len(numbers) * N; seen from `wi`, if given, instead of `back`."""

        def pick(a):
            return jnp.concatenate([a[i * self.paths : (i + 1) * self.paths] for i in numbers])

        vertex = jax.tree.map(pick, self.vertex)
        return Ends(vertex, self.scatterer.rows(pick, vertex.back if wi is None else wi), self.paths)


def ends(packed: PackedScene, subpath: Subpath, count: int) -> Ends:
    """The first `count` vertices of subpaths."""
    vertex = subpath.vertices(count)
    return Ends(vertex, Scatterer(packed, vertex.point, vertex.back), subpath.density.shape[1])


def found_emission(
    packed: PackedScene, camera: Subpath, power: int
) -> tuple[Float[Array, "B N 3"], Float[Array, "B N"]]:
    """s = 0: (contributions of emitters that camera subpaths meet at x_1, x_2, ..., weights of the strategy)."""
    bounces, paths = camera.density.shape
    vertex = camera.vertices(bounces)
    value = vertex.throughput * emitted(packed, vertex.point, vertex.back)
    shares, valid = emitter_shares(packed), vertex.point.valid
    sampled, leaving = jnp.zeros_like(vertex.density), jnp.zeros_like(vertex.density)
    if packed.environment is not None:
        sampled = shares.environment * packed.environment_sampler.pdf(-vertex.back)
        leaving = jnp.full_like(leaving, disk_pdf(packed))
    if packed.has_area_emitters:
        sampled = jnp.where(valid, shares.surfaces * emitting_surface_pdf(packed, vertex.point), sampled)
        leaving = jnp.where(valid, surface_emission_pdf(vertex.point, vertex.back), leaving)
    elif packed.environment is not None:
        sampled = jnp.where(valid, 0.0, sampled)
    ratio = quotient(stop_gradient(sampled), vertex.density)
    weight = 1.0 / (1.0 + relative_densities(ratio, vertex.joined, leaving, vertex.shorter, power))
    weight = weight.reshape(bounces, paths).at[0].set(1.0)
    return value.reshape(bounces, paths, 3), weight


def with_emitters(packed: PackedScene, camera: Ends, sample: EmitterSample, power: int) -> Connections:
    """s = 1: every vertex with an emitter sample of its own."""
    vertex, scatterer, _ = camera
    point, delta, infinite = vertex.point, sample.is_delta, sample.infinite
    offset = sample.point.position - point.position
    towards = jnp.where(infinite[:, None], sample.direction, normalize(offset))
    distance2 = jnp.where(infinite, 1.0, jnp.maximum(dot(offset, offset), 1e-30))
    cosine = jnp.where(infinite, 1.0, -dot(sample.point.normal, towards))
    cosine = cosine if delta is None else jnp.where(delta, 1.0, cosine)
    geometry = jnp.maximum(cosine, 0.0) / distance2 * jnp.where(infinite, 1.0, sample.point.area_ratio())
    value = scatterer.eval(towards) * geometry[:, None] * radiance_towards(packed, sample, towards)
    value = vertex.throughput * value / sample.pdf[:, None]
    carries = point.valid & (stop_gradient(cosine) > 0)
    value = jnp.where(carries[:, None], value, 0.0)

    found = scatterer.pdf(towards) * stop_gradient(jnp.maximum(cosine, 0.0) / distance2)
    found = found if delta is None else jnp.where(delta, 0.0, found)
    fewer = jnp.minimum(quotient(found, sample.pdf) ** power, LARGEST)
    reached = emission_pdf(packed, sample, -towards) * jnp.abs(dot(point.normal, towards)) / distance2
    reverse = scatterer.seen_from(towards).pdf(vertex.back)
    more = relative_densities(quotient(reached, vertex.density), vertex.joined, reverse, vertex.shorter, power)
    weight = stop_gradient(1.0 / (1.0 + fewer + more)).astype(found.dtype)

    start = scatterer.leave(towards)
    far = start + 2.0 * packed.size * towards
    end = jnp.where(infinite[:, None], far, leave(sample.point, -towards))
    return Connections(value, carries & scatterer.may_scatter(towards), weight, start, end)


def with_each_other(seen: Ends, lit: Ends, power: int) -> Connections:
    """s > 1, t > 1: vertices from the camera with vertices from emitters, row by row."""
    z, y = seen.vertex, lit.vertex
    offset = y.point.position - z.point.position
    towards = normalize(offset)
    distance2 = jnp.maximum(dot(offset, offset), 1e-30)
    at_camera, at_light = (jnp.abs(dot(v.point.normal, towards)) for v in (z, y))
    # Both BSDFs in both directions: each surface is seen from its previous vertex and from the other end.
    z_onwards, y_onwards = seen.scatterer.seen_from(towards), lit.scatterer.seen_from(-towards)
    value = seen.scatterer.eval(towards) * y_onwards.eval(y.back) * (at_light / distance2)[:, None]
    carries = z.point.valid & y.point.valid
    value = jnp.where(carries[:, None], z.throughput * value * y.throughput, 0.0)
    carries &= seen.scatterer.may_scatter(towards) & y_onwards.may_scatter(y.back)

    found = seen.scatterer.pdf(towards) * stop_gradient(at_light / distance2)
    fewer = relative_densities(quotient(found, y.density), y.joined, y_onwards.pdf(y.back), y.shorter, power)
    reached = lit.scatterer.pdf(-towards) * stop_gradient(at_camera / distance2)
    more = relative_densities(quotient(reached, z.density), z.joined, z_onwards.pdf(z.back), z.shorter, power)
    weight = 1.0 / (1.0 + fewer + more)
    return Connections(value, carries, weight, seen.scatterer.leave(towards), lit.scatterer.leave(-towards))


def with_camera(
    packed: PackedScene, light: Ends, u: Float[Array, "C 2"] | None, power: int
) -> tuple[Connections, Float[Array, "C 2"]]:
    """t = 1: (every vertex with the lens, film points); `u` chooses lens points where the camera has an aperture.

    Values are per square pixel of the film, for as many subpaths as pixels.
    """
    vertex, view = light.vertex, packed.camera.view(u)
    point, (x0, y0, width, height) = vertex.point, view.film.window
    local = view.local(point.position)
    ahead = point.valid & (local[:, 2] >= view.near) & (local[:, 2] <= view.far)
    local = jnp.where(ahead[:, None], local, jnp.asarray([0.0, 0.0, 1.0], local.dtype))
    film_point = view.project_local(local)
    low = jnp.asarray([x0, y0], local.dtype) - view.film.filter.radius
    high = jnp.asarray([x0 + width, y0 + height], local.dtype) + view.film.filter.radius
    on_film = ahead & ((film_point >= low) & (film_point <= high)).all(-1)
    towards = view.towards(point.position)
    scatterer = light.scatterer.seen_from(towards)
    area = view.film_area(local, point.normal) / (width * height)
    value = vertex.throughput * scatterer.eval(vertex.back) * area[:, None]
    value = jnp.where(on_film[:, None], value, 0.0)

    ratio = quotient(stop_gradient(area), vertex.density)
    reverse = scatterer.pdf(vertex.back)
    weight = 1.0 / (1.0 + relative_densities(ratio, vertex.joined, reverse, vertex.shorter, power))

    origin, direction = view.rays(stop_gradient(film_point))
    end, _ = view.clipped(jnp.broadcast_to(origin, direction.shape), direction)
    carries = on_film & scatterer.may_scatter(vertex.back)
    return Connections(value, carries, weight, scatterer.leave(towards), end), film_point
