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

from jaxdr.boundary.folds import SMOOTH
from jaxdr.boundary.texture_jumps import glow_jumps, seam_jumps
from jaxdr.geometry.vector import dot, norm, normalize
from jaxdr.scene.camera import View
from jaxdr.scene.color import luminance
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.emission import has_emitters, radiance_towards, sample_emitter
from jaxdr.transport.interaction import SurfacePoint, intersect, material_point, on_fixed_ray
from jaxdr.transport.near_field import NearField
from jaxdr.transport.path import PathSettings
from jaxdr.transport.radiance import first_bounce, first_bounce_of_jump, radiance_by_form
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice, uniform

PILOTS = 4  # emitter samples that estimate how much the radiance jumps at an edge


class EdgeDistribution(NamedTuple):
    """What edge points are drawn from; detached. Its rows are the edges of the moving shapes, numbered by `edge`.

    `start`, `end` are the film points of the visible part of each edge, `clip` the fractions of the 3D edge at the ends
    between near and far plane, `homogeneous` the denominators of the projection there, `range` the part of the
    projected edge inside the film window. `importance` per unit length; the cdfs are of length x importance. Seen
    through an aperture, an edge's `extent` bounds its length from all of it.
    """

    edge: Int[Array, " E"]
    start: Float[Array, "E 2"]
    end: Float[Array, "E 2"]
    clip: Float[Array, "E 2"]
    homogeneous: Float[Array, "E 2"]
    range: Float[Array, "E 2"]
    importance: Float[Array, " E"]
    silhouettes: Float[Array, " E"]
    creases: Float[Array, " E"]
    extent: Float[Array, " E"] | None = None


def edge_distribution(packed: PackedScene, moving: tuple[bool, ...], key: PRNGKeyArray) -> EdgeDistribution:
    """Distributions over silhouettes and creases of the `moving` shapes; `key` draws a few emitter samples."""
    packed = jax.tree.map(stop_gradient, packed)
    camera, number = packed.camera, packed.edges_of(moving)
    view = camera.view()
    ends = packed.vertices[packed.edges.vertices[number]]
    p0, p1 = view.local(ends[:, 0]), view.local(ends[:, 1])
    (near0, near1), (far0, far1) = (
        _clip(sign * (limit - p0[:, 2]), sign * (limit - p1[:, 2]))
        for sign, limit in ((1.0, camera.near_clip), (-1.0, camera.far_clip))
    )
    t0, t1 = jnp.maximum(near0, far0), jnp.minimum(near1, far1)
    in_front = t1 > t0
    q0, q1 = p0 + t0[:, None] * (p1 - p0), p0 + t1[:, None] * (p1 - p0)
    behind = ~in_front[:, None]
    ahead = jnp.asarray([0.0, 0.0, 1.0], q0.dtype)
    q0, q1 = jnp.where(behind, ahead, q0), jnp.where(behind, ahead, q1)
    start, end = view.project_local(q0), view.project_local(q1)
    extent, margin = norm(end - start), None
    if camera.aperture:
        blur0, blur1 = camera.blur(q0), camera.blur(q1)
        extent, margin = extent + jnp.abs(blur0 - blur1), jnp.maximum(jnp.abs(blur0), jnp.abs(blur1))
    s0, s1 = _inside_window(camera.film, start, end, margin)
    length = jnp.where(in_front, extent * jnp.maximum(s1 - s0, 0.0), 0.0)
    silhouette, importance = _importance(packed, moving, number, key)
    mass = length * importance
    return EdgeDistribution(
        edge=number,
        start=start,
        end=end,
        clip=jnp.stack([t0, t1], -1),
        homogeneous=jnp.stack([view.homogeneous(q0), view.homogeneous(q1)], -1),
        range=jnp.stack([s0, s1], -1),
        importance=importance,
        silhouettes=jnp.cumsum(jnp.where(silhouette, mass, 0.0)),
        creases=jnp.cumsum(jnp.where(silhouette, 0.0, mass)),
        extent=extent if camera.aperture else None,
    )


def _clip(outside0, outside1):
    """Parameter range of a line on which a linear function, positive outside, is not positive; empty as (1, 0)."""
    change = outside1 - outside0
    root = -outside0 / jnp.where(change == 0, 1.0, change)
    low = jnp.where(outside0 > 0, jnp.where(outside1 > 0, 1.0, root), 0.0)
    high = jnp.where(outside1 > 0, jnp.where(outside0 > 0, 0.0, root), 1.0)
    return low, high


def _inside_window(film, start, end, margin=None):
    """Parameter range of projected edges within reach of the window's filters, and `margin` pixels more."""
    x0, y0, width, height = film.window
    reach = film.filter.radius if margin is None else film.filter.radius + margin
    low, high = jnp.zeros(start.shape[0], start.dtype), jnp.ones(start.shape[0], start.dtype)
    for axis, first, size in ((0, x0, width), (1, y0, height)):
        for sign, limit in ((-1.0, first - reach), (1.0, first + size + reach)):
            a, b = _clip(sign * (start[:, axis] - limit), sign * (end[:, axis] - limit))
            low, high = jnp.maximum(low, a), jnp.minimum(high, b)
    return low, high


def _importance(packed: PackedScene, moving: tuple[bool, ...], number: Int[Array, " E"], key):
    """(is a silhouette, estimate of the jump of radiance per unit length of projected edge).

    Creases: the difference of what the two faces would receive, unshadowed, from a few emitter samples, a share of
    their fold that stands for all other light, and how much their textures differ. Silhouettes: what the visible face
    receives, and a typical value for the background. Only the noise depends on these estimates.
    """
    faces, row_of = packed.faces_of(moving)
    corners, shape = packed.vertices[packed.faces[faces]], packed.face_shape[faces]
    corner = corners[:, 0]
    normal = normalize(jnp.cross(corners[:, 1] - corner, corners[:, 2] - corner))
    front = dot(normal, packed.camera.view().towards(corner)) > 0
    # Normals turned towards the camera: two faces that continue each other have no crease.
    normal = jnp.where(front[:, None], normal, -normal)
    smooth = jnp.asarray(packed.smooth)[shape]
    lit = front | packed.two_sided[shape]  # one-sided faces seen from behind are black
    if (through := packed.spreads_through) is not None:
        lit |= through[shape]
    received = jnp.where(lit, _unshadowed(packed, corner, normal, smooth, key), 0.0)

    pair, interior = packed.edges.faces[number], packed.edges.interior[number]
    face0 = row_of(pair[:, 0])
    face1 = jnp.where(pair[:, 1] >= 0, row_of(pair[:, 1]), face0)
    # Edges of one or of many faces count as silhouettes; with both sides estimated, none is wrong.
    silhouette = ~interior | (front[face0] != front[face1])
    if packed.camera.aperture:  # and those that are silhouettes from a part of it
        turns = packed.camera.turns(corner, normal)
        silhouette = silhouette | turns[face0] | turns[face1]
    fold = norm(normal[face0] - normal[face1])
    jump = jnp.abs(received[face0] - received[face1])
    typical = jnp.where(received.mean() > 0, received.mean(), 1.0)
    crease = jump + typical * jnp.where(smooth[face0], SMOOTH, 1.0) * fold
    if packed.uvs is not None:
        light = 0.5 * (received[face0] + received[face1]) + 0.1 * typical
        crease = crease + light * seam_jumps(packed, number)
    if packed.glow:  # as irradiance that a white surface would send on
        crease = crease + jnp.pi * glow_jumps(packed, number)
    bright = jnp.maximum(received[face0], received[face1])
    return silhouette, jnp.where(silhouette, 0.5 * (typical + bright), crease)


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
    key_silhouettes, key_creases = jax.random.split(key)
    silhouettes = _silhouettes(packed, distribution, count, key_silhouettes, settings, form)
    if form == "material":
        return FilmEdgeTerms(silhouettes, jnp.zeros_like(silhouettes))
    return FilmEdgeTerms(silhouettes, _creases(packed, distribution, count, key_creases, settings, form))


class _EdgePoints(NamedTuple):
    """Points on visible edges, and the camera rays on their two sides (leading axis 2).

    `weight` = 1 / (count x density per pixel of length). `normal` on the film, towards the first side. `at_edge`: the
    ray on that side ends at the edge, which nothing hides there. `outline`: all faces at the edge are on one side, and
    nothing hides it. Only `view` and `film_point` are differentiable.
    """

    view: View
    film_point: Float[Array, "n 2"]
    normal: Float[Array, "n 2"]
    weight: Float[Array, " n"]
    direction: Float[Array, "2 n 3"]
    first: SurfacePoint
    distance: Float[Array, "2 n"]
    at_edge: Bool[Array, "2 n"]
    outline: Bool[Array, " n"]


def _edge_points(packed, distribution: EdgeDistribution, cdf, count, key, settings) -> _EdgePoints:
    camera, film = packed.camera, packed.camera.film
    row, fraction, weight = _sample(distribution, cdf, count, key)
    d = jax.tree.map(lambda table: table[row], distribution)
    edge = d.edge
    weight = packed.edges.shared(edge, weight)
    # The point of the 3D edge seen at this fraction of the projected edge; it moves with the edge.
    h0, h1 = d.homogeneous[:, 0], d.homogeneous[:, 1]
    tau = fraction * h0 / (fraction * h0 + (1 - fraction) * h1)
    tau = (d.clip[:, 0] + tau * (d.clip[:, 1] - d.clip[:, 0]))[:, None]
    ends = packed.vertices[packed.edges.vertices[edge]]
    point = (1 - tau) * ends[:, 0] + tau * ends[:, 1]
    view, start, end = camera.view(), d.start, d.end
    if camera.aperture:
        # A lens point each. From there an equal step of the fraction is an equal step on the film, too.
        key_lens = jax.random.fold_in(key, 1)
        view = camera.view(lattice(key_lens, 1, jnp.arange(count), LENS_DIMENSIONS, point.dtype)[0])
        start, end = (
            stop_gradient(view.project((1 - t) * ends[:, 0] + t * ends[:, 1])) for t in (d.clip[:, :1], d.clip[:, 1:])
        )
        weight = weight * norm(end - start) / jnp.where(d.extent > 0, d.extent, 1.0)
    film_point = view.project(point)

    along = normalize(end - start)
    normal = jnp.stack([along[:, 1], -along[:, 0]], -1)
    detached = jax.tree.map(stop_gradient, packed)
    sides = jnp.asarray([1.0, -1.0], point.dtype)[:, None, None]
    still = stop_gradient(view)
    pixel = still.pixel_size(stop_gradient(point))
    # Far from the origin points are known to rounding only.
    rounding = 4 * jnp.finfo(point.dtype).eps * jnp.abs(stop_gradient(ends)).max((-1, -2))
    step = jnp.maximum(1e-5 * max(film.width, film.height), rounding / pixel)
    origin, direction = still.rays(stop_gradient(film_point) + sides * step[:, None] * normal)
    origin = jnp.broadcast_to(origin, direction.shape)
    begin, reach = still.clipped(origin, direction)
    rays = direction.reshape(-1, 3)
    face = intersect(detached, begin.reshape(-1, 3), rays, jnp.ones(2 * count, bool), settings.rays, reach.reshape(-1))
    first = on_fixed_ray(detached, origin.reshape(-1, 3), rays, face)
    first = jax.tree.map(lambda x: x.reshape(2, count, *x.shape[1:]), first)
    distance = jnp.where(first.valid, norm(first.position - origin), jnp.inf)
    edge_distance = norm(stop_gradient(point) - origin)
    tolerance = 1e-5 * edge_distance + 50 * step * pixel
    near = jnp.abs(distance - edge_distance) <= tolerance
    neighbours = packed.edges.faces[edge]
    at_neighbour = ((first.face[:, :, None] == neighbours) & (neighbours >= 0)).any(-1) & first.valid
    at_edge = near | at_neighbour

    # Which sides the faces are on.
    ends, point = stop_gradient(ends), stop_gradient(point)
    across = jnp.cross(ends[:, 1] - ends[:, 0], still.towards(point))
    beside = origin + edge_distance[..., None] * direction
    across = across * jnp.sign(dot(across, beside[0] - beside[1]))[:, None]
    opposite = packed.edges.opposite[edge]
    height = ((detached.vertices[opposite] - point[:, None]) * across[:, None]).sum(-1)
    # Faces without area are on neither side.
    flat = jnp.abs(height) <= (rounding * norm(across))[:, None]
    height = jnp.where((neighbours >= 0) & ~flat, height, 0.0)
    on_first, on_second = (height > 0).any(-1), (height < 0).any(-1)
    # Where a face is thinner than the step, both rays of both of its edges end beyond it, and each would count all that
    # jumps there.
    thin = (jnp.abs(height) <= 2 * (step * pixel * norm(across))[:, None]) & (neighbours >= 0)
    once = jnp.maximum(1.0 - 0.5 * thin.sum(-1), 0.0)
    weight = jnp.where(at_edge.all(0), once * weight, weight)
    # A face that is seen edge-on escapes a ray beside the edge: many silhouettes of fine meshes have such faces. Then
    # the ray ends on what comes next on the surface, which may be nearer than the edge or farther.
    corners = jnp.concatenate([packed.edges.vertices[edge], jnp.where(neighbours >= 0, opposite, -1)], -1)
    surface = at_edge | ((packed.faces[first.face][..., None] == corners[:, None]).any((-1, -2)) & first.valid)
    clear = distance >= edge_distance - tolerance
    outline = jnp.where(on_first, surface[0] & clear[1], surface[1] & clear[0])
    outline = jnp.where(on_first == on_second, at_edge.all(0), outline)
    return _EdgePoints(view, film_point, normal, weight, direction, first, distance, at_edge, outline)


def _value(packed, points: _EdgePoints, seen, jump, position) -> Float[Array, "H W 3"]:
    """Image of jump x normal velocity of `position`, zero in value."""
    displacement = dot(points.normal, position - stop_gradient(position))
    value = jnp.where(seen, points.weight, 0.0)[:, None] * jump * displacement[:, None]
    return splat(packed.camera.film, points.film_point, value)


def _silhouettes(packed, distribution, count, key, settings, form) -> Float[Array, "H W 3"]:
    key_edge, key_first, key_path = jax.random.split(key, 3)
    points = _edge_points(packed, distribution, distribution.silhouettes, count, key_edge, settings)
    view, detached = points.view, jax.tree.map(stop_gradient, packed)
    u = lattice(key_first, 1, jnp.arange(count), 4, points.weight.dtype)[0]

    def side(first, direction):
        near = _near_field(view, first) if form == "near" else None
        return first_bounce(detached, first, direction, u, settings, near)

    first = points.first._replace(valid=points.first.valid & points.outline)
    begun = jax.vmap(side)(first, points.direction)
    total, near = radiance_by_form(detached, begun, key_path, settings)
    if form == "material":
        near = total
    seen, film_point = points.outline, points.film_point
    _, _, width, height = packed.camera.film.window
    image = jnp.zeros((height, width, 3), total.dtype)
    if form != "material":
        image += _value(packed, points, seen, (total - near)[1] - (total - near)[0], film_point)
    if form != "fixed":
        behind = points.distance.argmax(0)
        far = jax.tree.map(lambda x: jnp.where(behind.reshape(-1, *[1] * (x.ndim - 2)) == 1, x[1], x[0]), points.first)
        material = material_point(packed, far.face, far.barycentric, far.valid)
        ahead = jnp.asarray([0.0, 0.0, 1.0], film_point.dtype)
        local = jnp.where(far.valid[:, None], view.local(material.position), ahead)
        position = film_point - jnp.where(far.valid[:, None], view.project_local(local), 0.0)
        jump = jnp.where((behind == 1)[:, None], near[1], -near[0])
        image += _value(packed, points, seen, jump, position)
    return image


def _creases(packed, distribution, count, key, settings, form) -> Float[Array, "H W 3"]:
    key_edge, key_first, key_path = jax.random.split(key, 3)
    points = _edge_points(packed, distribution, distribution.creases, count, key_edge, settings)
    detached = jax.tree.map(stop_gradient, packed)
    u = lattice(key_first, 1, jnp.arange(count), 4, points.weight.dtype)[0]
    seen = points.at_edge.all(0)
    first = points.first._replace(valid=points.first.valid & seen)
    one, two = (jax.tree.map(lambda x, side=side: x[side], first) for side in (1, 0))
    near = (_near_field(points.view, one), _near_field(points.view, two)) if form == "near" else None
    if packed.has_delta_lobes or packed.spreads_through is not None:
        # What two mirrors show is not to be found in one direction; one that leaves the one face may enter the other.
        jump = _jump(detached, points, u, key_path, settings, near)
    else:
        begun = first_bounce_of_jump(detached, one, two, points.direction[1], u, settings, near)
        jump = radiance_by_form(detached, begun, key_path, settings)[0]
    return _value(packed, points, seen, jump, points.film_point)


def _jump(detached, points: _EdgePoints, u, key, settings, near) -> Float[Array, "n 3"]:
    """Radiance on the second side less that on the first, from a path each, without what is in material form."""
    sides = []
    for side, field in zip((1, 0), near or (None, None), strict=True):
        first = jax.tree.map(lambda x, side=side: x[side], points.first)
        begun = first_bounce(detached, first, points.direction[side], u, settings, field)
        radiance, near_radiance = radiance_by_form(detached, begun, key, settings)
        sides.append(radiance - near_radiance)
    return sides[0] - sides[1]


def _near_field(view: View, first: SurfacePoint) -> NearField:
    """Where nothing moves both forms of the first hit are one."""
    return NearField(stop_gradient(view), first, jnp.ones_like(first.area))


def _sample(
    distribution: EdgeDistribution, cdf: Float[Array, " E"], count: int, key
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Rows, fractions of the projected edges, and 1 / (count x density per pixel of length)."""
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
