"""Discontinuities in the image plane: silhouettes, creases, intersections and cuts that the camera sees directly.

With the camera ray fixed, the image is an integral over the film whose integrand jumps across projected edges. Its
derivative is the line integral of (L on one side - L on the other) times the normal velocity of the edge. The two sides
share their random numbers, and at creases the directions of their first bounce. So their noise cancels in part.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.film.cut_segments import cutting_planes
from jaxdr.boundary.film.edge_distribution import CUT, INTERSECTION, EdgeDistribution, edge_distribution, sample_edges
from jaxdr.boundary.shared.path_segments import on_face
from jaxdr.boundary.shared.term import Chunk, Context, named_key, streams
from jaxdr.geometry.gather import rows_of
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
    z_of,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera import View
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.interaction import SurfacePoint, intersect, on_fixed_ray
from jaxdr.transport.near_field import footprint
from jaxdr.transport.path import Lobe
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form
from jaxdr.transport.radiance import Answers, request
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice
from jaxdr.transport.shading import Scatterer

KINDS = ("silhouettes", "creases")
PARALLEL = 1e-6  # sine² of the angle between two faces; of smaller angles they share no line that could be told


class FilmEdgePoints(NamedTuple):
    """n points on visible edges, and the camera rays on their two sides (leading axis 2); detached.

    - `along`: the point's fraction of its `edge`; the edge is `INTERSECTION` or `CUT` where it is none of a mesh.
    - `point`: its position.
    - `lens`: the point of the aperture that it is seen through; None without an aperture.
    - `film_point`, `normal`: its film position, and the line's unit normal on the film, towards the first side.
    - `weight`: 1 / (count x density per pixel of length).
    - `direction`, `first`, `distance`: camera rays on both sides, their first hits, and the distance to them.
    - `at_edge`: the ray on this side ends at the edge, so nothing hides the edge there.
    - `outline`: all faces at the edge are on one side, and nothing hides the edge.
    """

    edge: Int[Array, " n"]
    along: Float[Array, " n"]
    point: Float[Array, "n 3"]
    lens: Float[Array, "n 2"] | None
    film_point: Float[Array, "n 2"]
    normal: Float[Array, "n 2"]
    weight: Float[Array, " n"]
    direction: Float[Array, "2 n 3"]
    first: SurfacePoint
    distance: Float[Array, "2 n"]
    at_edge: Bool[Array, "2 n"]
    outline: Bool[Array, " n"]


class _Held(NamedTuple):
    """Edge points. `seen` tells which count, `bounded` the sides on which light in material form ends there."""

    points: FilmEdgePoints
    seen: Bool[Array, " n"]
    bounded: Bool[Array, "2 n"]


class FilmEdges:
    """Term of the edges in the image, from as many points on silhouettes as on creases, stratified along the edges.

    Where first hits are material points, creases do not count. Light in material form has a boundary at a silhouette
    only on the surface behind it. There the edge's velocity counts relative to that surface. Where surfaces intersect
    or are cut it has a boundary on both sides.
    """

    def __init__(self, *kinds: str):
        self.kinds: tuple[str, ...] = kinds or KINDS
        first, *others = self.kinds
        self.name = "edges" if others else first

    def prepare(self, context: Context, key) -> EdgeDistribution | None:
        """Distributions over the edges of what moves relative to the camera."""
        if not any(context.moving.seen):
            return None
        material = context.form == Form.MATERIAL
        return edge_distribution(context.packed, context.moving.seen, key, context.settings, material)

    def draw(self, context: Context, state: EdgeDistribution, chunk: Chunk, key):
        """Points on edges, and requests for the radiance on both sides."""
        packed, settings, form = context.packed, context.settings, context.form
        del key  # each kind has a key from the chunk's: the same points are drawn whether the kinds are one term or two
        count, kinds = max(1, round(chunk.paths * context.edge_samples)), self.kinds
        drawn, lenses, numbers, stream = [], [], [], []
        for kind in kinds:
            key_edges, key_first, key_lens = jax.random.split(named_key(chunk.key, kind), 3)
            drawn.append(sample_edges(state, getattr(state, kind), count, key_edges))
            numbers.append(lattice(key_first, 1, jnp.arange(count), 4, chunk.weight.dtype))
            if packed.camera.aperture:
                lenses.append(lattice(key_lens, 1, jnp.arange(count), LENS_DIMENSIONS, chunk.weight.dtype))
            stream.append(streams(kind, count))
        drawn = jax.tree.map(lambda *x: jnp.concatenate(x), *drawn)
        lens = jnp.concatenate(lenses) if lenses else None
        u, stream = jnp.concatenate(numbers), jnp.concatenate(stream)
        points = _edge_points(packed, state, drawn, lens, settings)
        crease = jnp.repeat(jnp.asarray([kind == "creases" for kind in kinds]), count)
        seen = jnp.where(crease, points.at_edge.all(0), points.outline)
        first = points.first._replace(valid=points.first.valid & seen)
        given = None
        if kinds[-1] == "creases" and not packed.has_delta_lobes and packed.spreads_through is None:
            # Not with delta lobes: two mirrors reflect into different directions. Not where light passes through: a
            # direction that leaves one face may enter the other.
            given = _common_directions(packed, points, crease, u)
        size = None
        if form == Form.NEAR:
            size = jax.vmap(partial(footprint, _view(packed, points)))(first.position, first.normal)
        sides = (first, -points.direction, jnp.stack([u, u]), jnp.stack([stream, stream]))
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (*sides, size, given))
        first, wi, u, stream, size, given = flat
        emission = jnp.tile(seen, 2).astype(wi.dtype)
        asked = request(first, wi, u, settings.max_depth - 1, stream, emission)._replace(seen=size, given=given)
        behind = points.distance.argmax(0) == jnp.arange(2)[:, None]
        return asked, _Held(points, seen, behind & ~crease | (points.edge < 0))

    def image(
        self, context: Context, state, chunk: Chunk, held: _Held, answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """Jumps x normal velocities."""
        packed, form, points = context.packed, context.form, held.points
        assert answers is not None  # `draw` always asks
        total, near = (x.reshape(2, -1, 3) for x in answers)
        view, first = _view(packed, points), points.first
        ends = corners(packed.ends_of(jnp.maximum(points.edge, 0)))
        material = on_face(packed, first.face.reshape(-1), first.barycentric.reshape(-1, 3)).reshape(2, -1, 3)
        position = between(*ends, points.along)
        position = jnp.where((points.edge == INTERSECTION)[:, None], _intersection(points, material), position)
        if cutting_planes(packed.camera):
            position = jnp.where((points.edge == CUT)[:, None], _cut(points, material, view), position)
        film_point = view.project(position)
        value = 0.0
        if form != Form.MATERIAL:
            far = total - near
            value = scale(far[1] - far[0], _moved(points, film_point))
        if form != Form.FIXED:
            near = total if form == Form.MATERIAL else near
            ahead = jnp.asarray([0.0, 0.0, 1.0], film_point.dtype)
            for side, sign in ((0, -1.0), (1, 1.0)):
                hit = first.valid[side][:, None]
                local = jnp.where(hit, view.local(material[side]), ahead)
                relative = film_point - jnp.where(hit, view.project_local(local), 0.0)
                moved = jnp.where(held.bounded[side], sign * _moved(points, relative), 0.0)
                value += scale(near[side], moved)
        value = scale(value, jnp.where(held.seen, points.weight, 0.0))
        return chunk.share * splat(packed.camera.film, points.film_point, value)


def _moved(points: FilmEdgePoints, position: Float[Array, "n 2"]) -> Float[Array, " n"]:
    """Displacement of a film point along the edge's normal: zero in value, right in derivative."""
    along = dot(points.normal, position)
    return along - stop_gradient(along)


def _intersection(points: FilmEdgePoints, material: Float[Array, "2 n 3"]) -> Float[Array, "n 3"]:
    """Points on the lines that the planes of the faces on both sides share; they move along both normals.

    Each plane goes with the material point that is seen beside the line: n . dx = n . d(material) for both normals n.
    The motion along the line is left out: it does not change what is seen.
    """
    normal = stop_gradient(points.first.normal)
    return points.point + _common_motion(normal, dot(normal, material - stop_gradient(material)))


def _cut(points: FilmEdgePoints, material: Float[Array, "2 n 3"], view: View) -> Float[Array, "n 3"]:
    """Points on the lines where a clipping plane cuts a face: they move along the normals of the plane and the face."""
    first = points.at_edge[0][:, None]
    of_face, seen = (jnp.where(first, x[0], x[1]) for x in (points.first.normal, material))
    depth, gradient = z_of(view.local(points.point)), stop_gradient(view.inverse[2])
    slope = norm(gradient)
    of_plane = jnp.broadcast_to(gradient / slope, of_face.shape)
    normal = stop_gradient(jnp.stack([of_face, of_plane]))
    moved = jnp.stack([dot(normal[0], seen - stop_gradient(seen)), (stop_gradient(depth) - depth) / slope])
    return points.point + _common_motion(normal, moved)


def _common_motion(normal: Float[Array, "2 n 3"], moved: Float[Array, "2 n"]) -> Float[Array, "n 3"]:
    """Shortest motion of the line that two planes share, which move by this much along their unit normals."""
    cosine = dot(normal[0], normal[1])
    sine2 = 1.0 - cosine**2
    one, two = (safe_divide(moved[k] - cosine * moved[1 - k], sine2, sine2 > PARALLEL) for k in (0, 1))
    return scale(normal[0], one) + scale(normal[1], two)


def _view(packed: PackedScene, points: FilmEdgePoints) -> View:
    return packed.camera.view(points.lens)


def _common_directions(packed: PackedScene, points: FilmEdgePoints, crease, u) -> Lobe:
    """One direction for both sides of a crease, from the BSDF of a random side, and the mean of both pdfs.

    Away from creases the pdf is zero, so that no direction is given.
    """
    second = u[:, 2:3] >= 0.5
    rest = jnp.concatenate([2.0 * u[:, 2:3] - second, u[:, 3:]], -1)
    scatterers = [
        Scatterer(packed, jax.tree.map(lambda x, side=side: x[side], points.first), -points.direction[side])
        for side in (0, 1)
    ]
    direction = jnp.where(second, scatterers[1].sample(rest), scatterers[0].sample(rest))
    pdf = 0.5 * (scatterers[0].pdf(direction) + scatterers[1].pdf(direction))
    pdf = jnp.where(crease, pdf, 0.0)
    return Lobe(jnp.stack([direction, direction]), jnp.stack([pdf, pdf]))


def _edge_points(
    packed: PackedScene, distribution: EdgeDistribution, drawn, lens, settings: PathSettings
) -> FilmEdgePoints:
    """Trace the camera rays on both sides of drawn edge points. `lens`: their points of the aperture, or None."""
    camera, film = packed.camera, packed.camera.film
    row, fraction, weight = drawn
    count = row.shape[0]
    d = jax.tree.map(lambda table: rows_of(table, row), distribution)
    edge, ends, opposite = d.edge, d.ends, d.opposite
    weight = weight * d.share
    # The point of the 3D edge seen at this fraction of the projected edge.
    (h0, h1), (t0, t1) = components(d.homogeneous), components(d.clip)
    along = fraction * h0 / (fraction * h0 + (1 - fraction) * h1)
    along = t0 + along * (t1 - t0)
    p0, p1 = corners(ends)
    point = between(p0, p1, along)
    view, start, end = camera.view(lens), d.start, d.end
    if camera.aperture:
        # From every point of the lens, too, the film point is linear in the fraction.
        start, end = (view.project(between(p0, p1, t)) for t in (t0, t1))
        weight = safe_divide(weight * norm(end - start), d.extent)
    film_point = view.project(point)

    x, y = components(normalize(end - start))
    normal = from_components(y, -x)
    sides = jnp.asarray([1.0, -1.0], point.dtype)[:, None, None]
    pixel = view.pixel_size(point)
    # Rounding error of points far from the origin.
    rounding = 4 * jnp.finfo(point.dtype).eps * jnp.abs(ends).max((-1, -2))
    step = jnp.maximum(1e-5 * max(film.width, film.height), rounding / pixel)
    origin, direction = view.rays(film_point + sides * scale(normal, step))
    origin = jnp.broadcast_to(origin, direction.shape)
    begin, reach = view.clipped(origin, direction)
    rays = direction.reshape(-1, 3)
    hit = intersect(packed, begin.reshape(-1, 3), rays, jnp.ones(2 * count, bool), settings.rays, reach.reshape(-1))
    first = on_fixed_ray(packed, origin.reshape(-1, 3), rays, hit.face, hit.barycentric)
    first = jax.tree.map(lambda x: x.reshape(2, count, *x.shape[1:]), first)
    distance = jnp.where(first.valid, norm(first.position - origin), jnp.inf)
    edge_distance = norm(point - origin)
    tolerance = 1e-5 * edge_distance + 50 * step * pixel
    near = jnp.abs(distance - edge_distance) <= tolerance
    neighbours = d.faces
    at_neighbour = ((first.face[:, :, None] == neighbours) & (neighbours >= 0)).any(-1) & first.valid
    at_edge = near | at_neighbour

    # Find on which side of the edge each face is.
    across = cross(p1 - p0, view.towards(point))
    beside = origin + scale(direction, edge_distance)
    across = scale(across, jnp.sign(dot(across, beside[0] - beside[1])))
    height = dot(rows_of(packed.vertices, opposite) - point[:, None], across[:, None])
    length = norm(across)
    # Faces without area are on neither side.
    flat = jnp.abs(height) <= (rounding * length)[:, None]
    height = jnp.where((opposite >= 0) & ~flat, height, 0.0)
    on_first, on_second = (height > 0).any(-1), (height < 0).any(-1)
    # Where a face is thinner than the step, the rays of both of its edges end beyond it. Each of the two edges would
    # count the whole jump, so each has half the weight.
    thin = (jnp.abs(height) <= 2 * (step * pixel * length)[:, None]) & (opposite >= 0)
    once = jnp.maximum(1.0 - 0.5 * thin.sum(-1), 0.0)
    weight = jnp.where(at_edge.all(0), once * weight, weight)
    # A ray beside the edge misses a face that is seen edge-on; many silhouettes of fine meshes have such faces. Then
    # the ray ends on the next face of the surface, which may be nearer than the edge or farther.
    around = jnp.concatenate([packed.edges.vertices[jnp.maximum(edge, 0)], opposite], -1)
    surface = at_edge | ((packed.faces[first.face][..., None] == around[:, None]).any((-1, -2)) & first.valid)
    clear = distance >= edge_distance - tolerance
    outline = jnp.where(on_first, surface[0] & clear[1], surface[1] & clear[0])
    outline = jnp.where(on_first == on_second, at_edge.all(0), outline)
    if cutting_planes(camera):
        # The face ends on one side. Nothing has to be on the other.
        outline = jnp.where(edge == CUT, (at_edge & clear[::-1]).any(0), outline)
    return FilmEdgePoints(
        edge, along, point, lens, film_point, normal, weight, direction, first, distance, at_edge, outline
    )
