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
from jaxdr.scene.packed import LUMINANCE, PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.interaction import material_point, on_fixed_ray
from jaxdr.transport.path import PathSettings, trace_paths
from jaxdr.transport.sampler import lattice, uniform
from jaxdr.transport.shading import has_emitters, sample_emitter

PILOTS = 4  # emitter samples that estimate how much the radiance jumps at an edge


class EdgeDistribution(NamedTuple):
    """What edge points are drawn from; detached. `start`, `end` are the film points of the visible part of each edge.

    `clip` are the fractions of the 3D edge at its near-clipped ends, `depth` the depths there, `range` the part of the
    projected edge inside the film window. `importance` per unit length, `cdf` of length x importance.
    """

    start: Float[Array, "E 2"]
    end: Float[Array, "E 2"]
    clip: Float[Array, "E 2"]
    depth: Float[Array, "E 2"]
    range: Float[Array, "E 2"]
    silhouette: Bool[Array, " E"]
    importance: Float[Array, " E"]
    cdf: Float[Array, " E"]


def edge_distribution(
    packed: PackedScene, moving: tuple[bool, ...], key: PRNGKeyArray, creases: bool = True
) -> EdgeDistribution:
    """Distribution over the silhouettes and `creases` of the `moving` shapes; `key` draws a few emitter samples."""
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
    if not creases:
        importance = jnp.where(silhouette, importance, 0.0)
    cdf = jnp.cumsum(length * importance)
    return EdgeDistribution(
        start=start,
        end=end,
        clip=jnp.stack([t0, t1], -1),
        depth=jnp.stack([q0[:, 2], q1[:, 2]], -1),
        range=jnp.stack([s0, s1], -1),
        silhouette=silhouette,
        importance=importance,
        cdf=cdf,
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
        power = (sample.radiance[i] @ jnp.asarray(LUMINANCE, corner.dtype)) / sample.pdf[i] / PILOTS
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
    material: bool = False,
) -> FilmEdgeTerms:
    """Boundary terms of the film from `count` edge points, stratified along all edges.

    With `material` first hits only the surface behind a silhouette has a boundary there, and the edge's velocity counts
    relative to that surface.
    """
    camera, film = packed.camera, packed.camera.film
    key_edge, key_first, key_path = jax.random.split(key, 3)
    edge, fraction, weight = _sample(distribution, count, key_edge)

    # The point of the 3D edge seen at this fraction of the projected edge; it moves with the edge.
    d = jax.tree.map(lambda table: table[edge], distribution)
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
    u = lattice(key_first, count, jnp.zeros(1, jnp.int32), 4, point.dtype)[:, 0]

    def radiance(side):
        origin, direction = detached.camera.rays(stop_gradient(film_point) + side * step * normal)
        origin = jnp.broadcast_to(origin, direction.shape)
        reach = jnp.full(count, 1e30, direction.dtype)
        hit = queries.closest_hit(detached.vertices, detached.faces, origin, direction, reach, settings.rays)
        first = on_fixed_ray(detached, origin, direction, hit.face)
        # Common random numbers on both sides: what does not jump cancels.
        found = trace_paths(detached, first, direction, u, key_path, settings).radiance
        distance = jnp.where(first.valid, hit.t.astype(direction.dtype), jnp.inf)
        return found, hit.face, first.barycentric, distance

    colour, face, barycentric, distance = jax.vmap(radiance)(jnp.asarray([1.0, -1.0], point.dtype))
    edge_distance = norm(stop_gradient(point) - detached.camera.position)
    at_edge = jnp.abs(distance.min(0) - edge_distance) <= edge_distance * (
        1e-5 + 50 * step / detached.camera.pixels_per_tangent
    )
    neighbours = packed.edges.faces[edge]
    at_neighbour = ((face[:, :, None] == neighbours[None]) & (neighbours >= 0)[None]).any((0, 2))
    seen = at_edge | at_neighbour

    jump = colour[1] - colour[0]
    position = film_point
    if material:
        behind = distance.argmax(0)
        jump = jnp.where((behind == 1)[:, None], colour[1], -colour[0])
        far_face, far_barycentric = (
            jnp.take_along_axis(x, behind.reshape(1, -1, *[1] * (x.ndim - 2)), 0)[0] for x in (face, barycentric)
        )
        hits = far_face >= 0
        far = material_point(packed, jnp.where(hits, far_face, 0), far_barycentric, hits)
        local = camera.local(far.position)
        local = jnp.where(hits[:, None], local, jnp.asarray([0.0, 0.0, 1.0], local.dtype))
        position = film_point - jnp.where(hits[:, None], camera.project_local(local), 0.0)
    displacement = dot(normal, position - stop_gradient(position))
    value = jnp.where(seen, weight, 0.0)[:, None] * jump * displacement[:, None]
    is_silhouette = d.silhouette[:, None]
    return FilmEdgeTerms(
        silhouettes=splat(film, film_point, jnp.where(is_silhouette, value, 0.0)),
        creases=splat(film, film_point, jnp.where(is_silhouette, 0.0, value)),
    )


def _sample(
    distribution: EdgeDistribution, count: int, key
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Edges, fractions of the projected edges, and 1 / (count x density per pixel of length)."""
    cdf = distribution.cdf
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
