"""Edges of hard shadows: how their points are drawn, on silhouettes and borders of lights, and where they fall."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.projection import affine_coordinates, never_silhouettes, occluded_side, past_edge
from jaxdr.geometry import queries
from jaxdr.geometry.vector import (
    between,
    components,
    corners,
    cross,
    dot,
    from_components,
    norm,
    normalize,
    scale,
    triangle_normals,
    z_of,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import light_intensity, light_places
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import lattice, sample_cdf
from jaxdr.transport.shading import Scatterer

FLOOR = 0.25  # share of the points that are drawn by the silhouettes' length alone, as the light sees it


class ShadowLines(NamedTuple):
    """Points on lines that bound what lights reach.

    `light` sees the line between `ends` (differentiable); the point is at the fraction `along`. `dark` is the unit
    normal of the plane through light and line, towards what hides the light. `border` marks lines that the light itself
    makes, `used` those that count.
    """

    light: Int[Array, " n"]
    ends: Float[Array, "n 2 3"]
    along: Float[Array, " n"]
    dark: Float[Array, "n 3"]
    border: Bool[Array, " n"]
    used: Bool[Array, " n"]


class ShadowPoints(NamedTuple):
    """Where the light past `ShadowLines` arrives.

    `position`, a point on the edge of the shadow, is differentiable. All else is detached:

    - `point`: the receiver's surface point there, valid where light arrives at all.
    - `towards`: unit direction to the light.
    - `arriving`: RGB intensity of the light over the squared distance.
    - `tangent`: derivative of the position along the line.
    - `lit`: a displacement to the lit side.
    """

    position: Float[Array, "n 3"]
    point: SurfacePoint
    towards: Float[Array, "n 3"]
    arriving: Float[Array, "n 3"]
    tangent: Float[Array, "n 3"]
    lit: Float[Array, "n 3"]

    def scattered(self, detached: PackedScene, wi: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Radiance that the receiver scatters along unit directions `wi` where the light arrives."""
        return Scatterer(detached, self.point, wi).eval(self.towards) * self.arriving


class ShadowDistribution(NamedTuple):
    """The distribution of points on silhouettes; detached. Entry l E + e is edge e as light l sees it; borders follow.

    `film` and `scattered` are cumulative masses: for shadows that the camera sees, and for shadows on surfaces that
    light up other surfaces.
    """

    film: Float[Array, " K"]
    scattered: Float[Array, " K"]


def shadow_distribution(
    packed: PackedScene, shapes: tuple[bool, ...], lights: tuple[bool, ...], settings: PathSettings
) -> ShadowDistribution:
    """Distribution over silhouettes for all lights, by the light that arrives past their middles.

    `shapes` tells which shapes move relative to the camera, `lights` which lights move.
    """
    packed = jax.tree.map(stop_gradient, packed)
    count, borders = packed.edges.vertices.shape[0], _borders(packed)
    places, infinite = light_places(packed)
    moving_shapes, moving_lights = jnp.asarray(shapes), jnp.asarray(lights)
    may_bound = ~never_silhouettes(packed)
    ends = packed.vertices[packed.edges.vertices]
    normal, corner = packed.face_normals(), packed.vertices[packed.faces[:, 0]]

    def masses(light, index, edge_moves, used):
        """(for the film, for scattered light, by length) of one light's lines."""
        lines = _lines(packed, index, jnp.full(index.shape, 0.5, ends.dtype), used)
        points = shadow_points(packed, lines, settings)
        moves = edge_moves | moving_lights[light] | moving_shapes[packed.face_shape[points.point.face]]
        wi = normalize(packed.camera.to_world[:3, 3] - points.point.position)
        seen = on_film(packed, points)
        value = jnp.where(moves & points.point.valid, magnitude(points.scattered(packed, wi)), 0.0)
        for_film = jnp.where(seen.inside, value * norm(seen.across), 0.0)
        received = magnitude(points.arriving) * jnp.abs(dot(points.point.normal, points.towards))
        received = jnp.where(moves & points.point.valid, received * norm(points.tangent), 0.0)
        offset = jnp.where(infinite[light], packed.size, norm(ends_of(lines) - places[light]))
        sides = lines.ends[:, 1] - lines.ends[:, 0]
        length = jnp.where(used, safe_divide(norm(sides), offset), 0.0)
        return for_film, received, length

    def ends_of(lines):
        return lines.ends.mean(1)

    def of_light(light):
        towards = jnp.where(infinite[light], places[light], places[light] - corner)
        front = dot(normal, towards) > 0
        face0, face1 = packed.edges.faces[:, 0], packed.edges.faces[:, 1]
        silhouette = ~packed.edges.interior | (front[face0] != front[jnp.maximum(face1, 0)])
        index = light * count + jnp.arange(count)
        watched = moving_lights[light] | any(shapes)
        return masses(light, index, moving_shapes[packed.edges.shape], silhouette & may_bound & watched)

    tables = [jax.tree.map(jnp.ravel, jax.lax.map(of_light, jnp.arange(packed.light_count)))]
    if borders is not None:
        index = packed.light_count * count + jnp.arange(borders.light.shape[0])
        watched = moving_lights[borders.light] | any(shapes)
        tables.append(masses(borders.light, index, jnp.zeros(index.shape, bool), watched))
    film, scattered, length = (jnp.concatenate(t) for t in zip(*tables, strict=True))
    return ShadowDistribution(*(jnp.cumsum(_mass(table, length)) for table in (film, scattered)))


def _mass(table, length):
    """Mix the normalised masses that the pilot found with a floor for every silhouette, by length."""
    whole, total = length.sum(), table.sum()
    even = safe_divide(length, whole)
    found = safe_divide(table, total)
    return FLOOR * even + (1.0 - FLOOR) * found


class _Borders(NamedTuple):
    """Lines at which the lights themselves end, and points on their lit sides."""

    light: Int[Array, " K"]
    ends: Float[Array, "K 2 3"]
    inside: Float[Array, "K 3"]


def _borders(packed: PackedScene) -> _Borders | None:
    found = []
    for group in packed.lights:
        if (lines := packed.borders_of(group)) is None:
            continue
        light = jnp.full(lines.shape[0], jnp.argmax(group.member))
        found.append(_Borders(light, lines[:, :2], stop_gradient(lines[:, 2])))
    return jax.tree.map(lambda *x: jnp.concatenate(x), *found) if found else None


def _lines(
    packed: PackedScene, index: Int[Array, " n"], along: Float[Array, " n"], used: Bool[Array, " n"]
) -> ShadowLines:
    """Points on the entries `index` of a `ShadowDistribution`."""
    count, borders = packed.edges.vertices.shape[0], _borders(packed)
    places, infinite = jax.tree.map(stop_gradient, light_places(packed))
    light, edge = jnp.divmod(index, count)
    border = light >= packed.light_count
    light, edge = jnp.where(border, 0, light), jnp.where(border, 0, edge)
    ends = packed.ends_of(edge)
    middle = stop_gradient(ends).mean(1)
    apex = jnp.where(infinite[light][:, None], middle + 2.0 * packed.size * places[light], places[light])
    start, end = corners(stop_gradient(ends))
    dark, _ = occluded_side(packed, edge, (start, end), apex)
    if borders is not None:
        number = jnp.clip(index - packed.light_count * count, 0, borders.light.shape[0] - 1)
        light = jnp.where(border, borders.light[number], light)
        ends = jnp.where(border[:, None, None], borders.ends[number], ends)
        sides = stop_gradient(borders.ends[number]) - places[light][:, None]
        plane = normalize(cross(*corners(sides)))
        plane = scale(plane, -jnp.sign(dot(plane, borders.inside[number] - places[light])))
        dark = jnp.where(border[:, None], plane, dark)
    return ShadowLines(light, ends, along, dark, border, used)


def shadow_points(packed: PackedScene, lines: ShadowLines, settings: PathSettings) -> ShadowPoints:
    """Follow the light past lines. A point is invalid if the line is hidden from the light or the ray misses."""
    detached = jax.tree.map(stop_gradient, packed)
    places, infinite = light_places(packed)
    place, infinite = places[lines.light], infinite[lines.light][:, None]
    start, end = corners(lines.ends)
    edge_point = between(start, end, lines.along)
    still, source = stop_gradient((edge_point, place))

    beside = past_edge(still, still, lines.dark)
    to_light = jnp.where(infinite, 2.0 * packed.size * source, source - beside)
    reach = jnp.where(lines.used & ~lines.border, 1.0, 0.0).astype(still.dtype)
    hidden = queries.occluded(detached.geometry, queries.Rays(beside, to_light, reach), settings.rays)
    towards = normalize(to_light)
    origin = jnp.where(lines.border[:, None], source, beside)
    reach = jnp.where(lines.used & ~hidden, 1e30, 0.0).astype(still.dtype)
    hit = queries.closest_hit(detached.geometry, queries.Rays(origin, -towards, reach), settings.rays)
    found = hit.face >= 0
    face = jnp.where(found, hit.face, 0)

    def shadow(edge_point, place, triangle):
        """Where the light's ray through the edge point meets the plane of a face."""
        ray = jnp.where(infinite, -place, edge_point - place)
        normal = triangle_normals(triangle)
        slope = dot(normal, ray)
        distance = safe_divide(dot(normal, corners(triangle)[0] - edge_point), slope, found & (slope != 0))
        return edge_point + scale(ray, jnp.where(found, distance, 0.0))

    triangle = packed.corners_of(face)
    still_triangle = stop_gradient(triangle)

    def moved(direction):
        return jax.jvp(lambda q: shadow(q, source, still_triangle), (still,), (direction,))[1]

    position = shadow(edge_point, place, triangle)
    arrived = stop_gradient(position)
    # Where an object stands on the receiver, the shadow's edge coincides with the object's edge. Leave it out.
    apart = norm(arrived - still) > 4.0 * queries.BESIDE * jnp.abs(still).max(-1)
    barycentric = affine_coordinates(still_triangle, arrived)
    point = material_point(detached, face, barycentric, found & apart)
    distance2 = jnp.where(infinite[:, 0], 1.0, dot(arrived - source, arrived - source))
    intensity = light_intensity(detached, lines.light, -towards)
    return ShadowPoints(
        position=position,
        point=point,
        towards=towards,
        arriving=scale(intensity, safe_divide(1.0, distance2)),
        tangent=moved(stop_gradient(end - start)),
        lit=moved(-lines.dark),
    )


class OnFilm(NamedTuple):
    """Shadow points on the film; only `film_point` is differentiable.

    `across` is normal to the shadow's edge, towards the lit side. Its length is the edge's length on the film per unit
    of the line's parameter. `inside`: within reach of the film's window and in front of the camera.
    """

    film_point: Float[Array, "n 2"]
    across: Float[Array, "n 2"]
    inside: Bool[Array, " n"]


def on_film(packed: PackedScene, points: ShadowPoints) -> OnFilm:
    camera, film = packed.camera, packed.camera.film
    still = stop_gradient(camera)
    position = stop_gradient(points.position)
    in_front = points.point.valid & (z_of(still.local(position)) > camera.near_clip)
    ahead = still.to_world[:3, 3] + still.to_world[:3, 2]

    def project(camera, position):
        return camera.project(jnp.where(in_front[:, None], position, ahead))

    def moved(direction):
        return jax.jvp(lambda p: project(still, p), (position,), (direction,))[1]

    film_point, along, lit = project(camera, points.position), moved(points.tangent), moved(points.lit)
    x, y = components(along)
    across = from_components(y, -x)
    across = scale(across, jnp.sign(dot(across, lit)))
    x0, y0, width, height = film.window
    low = jnp.asarray([x0, y0], position.dtype) - film.filter.radius
    high = jnp.asarray([x0 + width, y0 + height], position.dtype) + film.filter.radius
    inside = ((film_point > low) & (film_point < high)).all(-1)
    return OnFilm(film_point, across, in_front & stop_gradient(inside))


def draw_lines(packed: PackedScene, cdf: Float[Array, " K"], count: int, key) -> tuple[ShadowLines, Float[Array, " n"]]:
    """Points on lines and 1 / density per unit of the line's parameter. A lattice spreads the points over all lines."""
    u = lattice(key, 1, jnp.arange(count), 2, cdf.dtype)
    total = cdf[-1]
    entry, _, mass = sample_cdf(cdf, u[:, 0] * total)
    used = mass > 0
    weight = safe_divide(total, mass, used, 0.0)
    light, edge = jnp.divmod(entry, packed.edges.vertices.shape[0])
    weight = jnp.where(light < packed.light_count, packed.edges.shared(edge, weight), weight)
    return _lines(packed, entry, u[:, 1], used), weight
