"""Discontinuities in the image plane: silhouettes and creases seen directly, with both sides (DESIGN 1).

With the camera ray fixed, the image is an integral over the film whose integrand jumps across projected edges. Its
derivative is the line integral of (L on one side - L on the other) times the normal velocity of the edge. Edge points
are drawn proportional to projected length times an estimate of the jump.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, norm, normalize
from jaxdr.scene.color import luminance
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.emission import has_emitters, radiance_towards, sample_emitter
from jaxdr.transport.interaction import SurfacePoint, material_point, on_fixed_ray
from jaxdr.transport.near_field import NearField
from jaxdr.transport.path import PathSettings, trace_jump, trace_paths
from jaxdr.transport.sampler import lattice, uniform

PILOTS = 4  # emitter samples that estimate how much the radiance jumps at an edge


class EdgeDistribution(NamedTuple):
    """What edge points are drawn from; detached. `start`, `end` are the film points of the visible part of each edge.

    `clip` are the fractions of the 3D edge at its near-clipped ends, `depth` the depths there, `range` the part of the
    projected edge inside the film window. `importance` per unit length; the cdfs are of length x importance.
    """

    start: Float[Array, "E 2"]
    end: Float[Array, "E 2"]
    clip: Float[Array, "E 2"]
    depth: Float[Array, "E 2"]
    range: Float[Array, "E 2"]
    importance: Float[Array, " E"]
    silhouettes: Float[Array, " E"]
    creases: Float[Array, " E"]


def edge_distribution(packed: PackedScene, moving: tuple[bool, ...], key: PRNGKeyArray) -> EdgeDistribution:
    """Distributions over silhouettes and creases of the `moving` shapes; `key` draws a few emitter samples."""
    packed = jax.tree.map(stop_gradient, packed)
    camera, edges = packed.camera, packed.edges
    local = camera.local(packed.vertices)
    p0, p1 = local[edges.vertices[:, 0]], local[edges.vertices[:, 1]]
    t0, t1 = _clip(camera.near_clip - p0[:, 2], camera.near_clip - p1[:, 2])
    in_front = t1 > t0
    q0, q1 = p0 + t0[:, None] * (p1 - p0), p0 + t1[:, None] * (p1 - p0)
    behind = ~in_front[:, None]
    ahead = jnp.asarray([0.0, 0.0, 1.0], q0.dtype)
    q0, q1 = jnp.where(behind, ahead, q0), jnp.where(behind, ahead, q1)
    start, end = camera.project_local(q0), camera.project_local(q1)
    s0, s1 = _inside_window(camera.film, start, end)
    length = jnp.where(in_front, norm(end - start) * jnp.maximum(s1 - s0, 0.0), 0.0)
    silhouette, importance = _importance(packed, moving, key)
    mass = length * importance
    return EdgeDistribution(
        start=start,
        end=end,
        clip=jnp.stack([t0, t1], -1),
        depth=jnp.stack([q0[:, 2], q1[:, 2]], -1),
        range=jnp.stack([s0, s1], -1),
        importance=importance,
        silhouettes=jnp.cumsum(jnp.where(silhouette, mass, 0.0)),
        creases=jnp.cumsum(jnp.where(silhouette, 0.0, mass)),
    )


def _clip(outside0, outside1):
    """Parameter range of a line on which a linear function, positive outside, is not positive; empty as (1, 0)."""
    change = outside1 - outside0
    root = -outside0 / jnp.where(change == 0, 1.0, change)
    low = jnp.where(outside0 > 0, jnp.where(outside1 > 0, 1.0, root), 0.0)
    high = jnp.where(outside1 > 0, jnp.where(outside0 > 0, 0.0, root), 1.0)
    return low, high


def _inside_window(film, start, end):
    """Parameter range of projected edges within reach of the window's reconstruction filters."""
    x0, y0, width, height = film.window
    reach = film.filter.radius
    low, high = jnp.zeros(start.shape[0], start.dtype), jnp.ones(start.shape[0], start.dtype)
    for axis, first, size in ((0, x0, width), (1, y0, height)):
        for sign, limit in ((-1.0, first - reach), (1.0, first + size + reach)):
            a, b = _clip(sign * (start[:, axis] - limit), sign * (end[:, axis] - limit))
            low, high = jnp.maximum(low, a), jnp.minimum(high, b)
    return low, high


def _importance(packed: PackedScene, moving, key):
    """(is a silhouette, estimate of the jump of radiance per unit length of projected edge).

    Creases: the difference of what the two faces would receive, unshadowed, from a few emitter samples, and a share of
    their fold that stands for all other light. Silhouettes: what the visible face receives, and a typical value for
    the background. Only the noise depends on these estimates.
    """
    corner = packed.vertices[packed.faces[:, 0]]
    normal = normalize(packed.face_normals())
    front = dot(normal, corner - packed.camera.position) < 0
    # Normals turned towards the camera: two faces that continue each other have no crease.
    normal = jnp.where(front[:, None], normal, -normal)
    smooth = jnp.asarray(packed.smooth)[packed.face_shape]
    lit = front | packed.two_sided[packed.face_shape]  # one-sided faces seen from behind are black
    received = jnp.where(lit, _unshadowed(packed, corner, normal, smooth, key), 0.0)

    edges = packed.edges
    face0 = edges.faces[:, 0]
    face1 = jnp.where(edges.faces[:, 1] >= 0, edges.faces[:, 1], face0)
    # Edges of one or of many faces count as silhouettes; with both sides estimated, none is wrong.
    silhouette = ~edges.interior | (front[face0] != front[face1])
    fold = norm(normal[face0] - normal[face1])
    jump = jnp.abs(received[face0] - received[face1])
    typical = jnp.where(received.mean() > 0, received.mean(), 1.0)
    crease = jump + typical * jnp.where(smooth[face0], 0.1, 1.0) * fold
    bright = jnp.maximum(received[face0], received[face1])
    importance = jnp.where(silhouette, 0.5 * (typical + bright), crease)
    return silhouette, jnp.where(jnp.asarray(moving)[edges.shape], importance, 0.0)


def _unshadowed(packed: PackedScene, corner, normal, smooth, key) -> Float[Array, " F"]:
    """Irradiance (luminance) of faces from a few emitter samples, without visibility.

    Interpolated normals agree at an edge: what can differ for smooth faces is which of them the light reaches at all.
    """
    received = jnp.zeros(corner.shape[0], corner.dtype)
    if not has_emitters(packed):
        return received
    sample = sample_emitter(packed, lattice(key, 1, jnp.arange(PILOTS), 2, corner.dtype)[0])
    for i in range(PILOTS):
        offset = sample.point.position[i] - corner
        squared = jnp.maximum(dot(offset, offset), 1e-30)
        direction = jnp.where(sample.infinite[i], sample.direction[i], offset / jnp.sqrt(squared)[:, None])
        facing = jnp.maximum(-direction @ sample.point.normal[i], 0.0) / squared
        if sample.light is None:
            power = luminance(sample.radiance[i]) / sample.pdf[i] / PILOTS
        else:
            one = jax.tree.map(lambda x, i=i: jnp.broadcast_to(x[i], (corner.shape[0], *x.shape[1:])), sample)
            power = luminance(radiance_towards(packed, one, direction)) / sample.pdf[i] / PILOTS
            facing = jnp.where(one.is_delta, 1.0 / squared, facing)
        cosine = dot(direction, normal)
        cosine = jnp.where(smooth, jnp.where(cosine > 0, 0.3, 0.0), jnp.maximum(cosine, 0.0))
        received = received + cosine * jnp.where(sample.infinite[i], 1.0, facing) * power
    return received


class FilmEdgeTerms(NamedTuple):
    """Images that are zero in value and right in derivative."""

    silhouettes: Float[Array, "H W 3"]
    creases: Float[Array, "H W 3"]


def film_edge_terms(
    packed: PackedScene,
    distribution: EdgeDistribution,
    count: int,
    key: PRNGKeyArray,
    settings: PathSettings,
    form: str = "fixed",
) -> FilmEdgeTerms:
    """Boundary terms of the film from `count` points on silhouettes and as many on creases, stratified along the edges.

    `form` of the first hits, see `primary_samples`. Of light in material form only what the surface behind a silhouette
    sends has a boundary there, and the edge's velocity counts relative to that surface.
    """
    if form != "near":  # what is near is what narrow lobes change
        settings = settings._replace(attached=0.0)
    key_silhouettes, key_creases = jax.random.split(key)
    silhouettes = _silhouettes(packed, distribution, count, key_silhouettes, settings, form)
    if form == "material":
        return FilmEdgeTerms(silhouettes, jnp.zeros_like(silhouettes))
    return FilmEdgeTerms(silhouettes, _creases(packed, distribution, count, key_creases, settings, form))


class _EdgePoints(NamedTuple):
    """Points on visible edges, and the camera rays on their two sides (leading axis 2).

    `weight` = 1 / (count x density per pixel of length). `normal` on the film, towards the first side. `at_edge`: the
    ray on that side ends at the edge, which nothing hides there. Only `film_point` is differentiable.
    """

    film_point: Float[Array, "n 2"]
    normal: Float[Array, "n 2"]
    weight: Float[Array, " n"]
    direction: Float[Array, "2 n 3"]
    first: SurfacePoint
    distance: Float[Array, "2 n"]
    at_edge: Bool[Array, "2 n"]


def _edge_points(packed, distribution: EdgeDistribution, cdf, count, key, settings) -> _EdgePoints:
    camera, film = packed.camera, packed.camera.film
    edge, fraction, weight = _sample(distribution, cdf, count, key)
    d = jax.tree.map(lambda table: table[edge], distribution)
    # The point of the 3D edge seen at this fraction of the projected edge; it moves with the edge.
    z0, z1 = d.depth[:, 0], d.depth[:, 1]
    tau = fraction * z0 / (fraction * z0 + (1 - fraction) * z1)
    tau = (d.clip[:, 0] + tau * (d.clip[:, 1] - d.clip[:, 0]))[:, None]
    ends = packed.vertices[packed.edges.vertices[edge]]
    point = (1 - tau) * ends[:, 0] + tau * ends[:, 1]
    film_point = camera.project(point)

    along = normalize(d.end - d.start)
    normal = jnp.stack([along[:, 1], -along[:, 0]], -1)
    detached = jax.tree.map(stop_gradient, packed)
    step = 1e-5 * max(film.width, film.height)
    sides = jnp.asarray([1.0, -1.0], point.dtype)[:, None, None]
    origin, direction = detached.camera.rays(stop_gradient(film_point) + sides * step * normal)
    rays = direction.reshape(-1, 3)
    origin = jnp.broadcast_to(origin, rays.shape)
    reach = jnp.full(2 * count, 1e30, rays.dtype)
    hit = queries.closest_hit(detached.vertices, detached.faces, origin, rays, reach, settings.rays)
    first = on_fixed_ray(detached, origin, rays, hit.face)
    first = jax.tree.map(lambda x: x.reshape(2, count, *x.shape[1:]), first)
    distance = jnp.where(first.valid, hit.t.reshape(2, count).astype(rays.dtype), jnp.inf)
    edge_distance = norm(stop_gradient(point) - detached.camera.position)
    near = jnp.abs(distance - edge_distance) <= edge_distance * (1e-5 + 50 * step / detached.camera.pixels_per_tangent)
    neighbours = packed.edges.faces[edge]
    at_neighbour = ((first.face[:, :, None] == neighbours) & (neighbours >= 0)).any(-1) & first.valid
    return _EdgePoints(film_point, normal, weight, direction, first, distance, near | at_neighbour)


def _value(packed, points: _EdgePoints, seen, jump, position) -> Float[Array, "H W 3"]:
    """Image of jump x normal velocity of `position`, zero in value."""
    displacement = dot(points.normal, position - stop_gradient(position))
    value = jnp.where(seen, points.weight, 0.0)[:, None] * jump * displacement[:, None]
    return splat(packed.camera.film, points.film_point, value)


def _silhouettes(packed, distribution, count, key, settings, form) -> Float[Array, "H W 3"]:
    camera = packed.camera
    key_edge, key_first, key_path = jax.random.split(key, 3)
    points = _edge_points(packed, distribution, distribution.silhouettes, count, key_edge, settings)
    detached = jax.tree.map(stop_gradient, packed)
    u = lattice(key_first, 1, jnp.arange(count), 4, points.weight.dtype)[0]

    def radiance(first, direction):
        near = _near_field(detached, first) if form == "near" else None
        record = trace_paths(detached, first, direction, u, key_path, settings, near)
        return record.radiance, record.radiance if form == "material" else record.near

    total, near = jax.vmap(radiance)(points.first, points.direction)
    seen, film_point = points.at_edge.any(0), points.film_point
    _, _, width, height = packed.camera.film.window
    image = jnp.zeros((height, width, 3), total.dtype)
    if form != "material":
        image += _value(packed, points, seen, (total - near)[1] - (total - near)[0], film_point)
    if form != "fixed":
        behind = points.distance.argmax(0)
        far = jax.tree.map(lambda x: jnp.where(behind.reshape(-1, *[1] * (x.ndim - 2)) == 1, x[1], x[0]), points.first)
        material = material_point(packed, far.face, far.barycentric, far.valid)
        ahead = jnp.asarray([0.0, 0.0, 1.0], film_point.dtype)
        local = jnp.where(far.valid[:, None], camera.local(material.position), ahead)
        position = film_point - jnp.where(far.valid[:, None], camera.project_local(local), 0.0)
        jump = jnp.where((behind == 1)[:, None], near[1], -near[0])
        image += _value(packed, points, seen, jump, position)
    return image


def _creases(packed, distribution, count, key, settings, form) -> Float[Array, "H W 3"]:
    key_edge, key_first, key_path = jax.random.split(key, 3)
    points = _edge_points(packed, distribution, distribution.creases, count, key_edge, settings)
    detached = jax.tree.map(stop_gradient, packed)
    u = lattice(key_first, 1, jnp.arange(count), 4, points.weight.dtype)[0]
    one, two = (jax.tree.map(lambda x, side=side: x[side], points.first) for side in (1, 0))
    near = (_near_field(detached, one), _near_field(detached, two)) if form == "near" else None
    jump = trace_jump(detached, one, two, points.direction[1], u, key_path, settings, near)
    return _value(packed, points, points.at_edge.all(0), jump, points.film_point)


def _near_field(detached: PackedScene, first: SurfacePoint) -> NearField:
    """Where nothing moves both forms of the first hit are one."""
    return NearField(detached.camera, first, jnp.ones_like(first.area))


def _sample(
    distribution: EdgeDistribution, cdf: Float[Array, " E"], count: int, key
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Edges, fractions of the projected edges, and 1 / (count x density per pixel of length)."""
    total = cdf[-1]
    strata = jnp.arange(count, dtype=cdf.dtype) + uniform(key, (count,), cdf.dtype)
    target = strata / count * total
    edge = jnp.clip(jnp.searchsorted(cdf, target, side="right"), 0, cdf.shape[0] - 1)
    before = jnp.where(edge > 0, cdf[edge - 1], 0.0)
    mass = cdf[edge] - before
    along = jnp.clip((target - before) / jnp.where(mass > 0, mass, 1.0), 0.0, 1.0)
    low, high = distribution.range[edge, 0], distribution.range[edge, 1]
    importance = distribution.importance[edge]
    weight = jnp.where(mass > 0, total / (count * jnp.where(importance > 0, importance, 1.0)), 0.0)
    return edge, low + along * (high - low), weight
