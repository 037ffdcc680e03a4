"""The distribution of points on edges in the image: projected length times an estimate of the jump of radiance.

Where two surfaces pass through each other, what they share is a crease, too. It is no edge of a mesh. Its segments are
found anew for every scene, and are further rows of the distribution. So are those where a clipping plane of the camera
cuts faces. The image jumps there as at a silhouette.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.film.cut_segments import cut_segments, cutting_planes
from jaxdr.boundary.shared.folds import SMOOTH
from jaxdr.boundary.shared.texture_jumps import glow_jumps, seam_jumps
from jaxdr.geometry import queries
from jaxdr.geometry.vector import (
    between,
    components,
    corners,
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
from jaxdr.transport.emission import has_emitters, radiance_towards, sample_emitter
from jaxdr.transport.keys import fixed_key
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import lattice, sample_cdf, seed_of, uniform

ROOM = 16  # intersections, or cuts by one plane, for each row of faces in a square of all faces
INTERSECTION, CUT = -1, -2  # in place of the number of an edge
PILOTS = 4  # emitter samples that estimate how much the radiance jumps at an edge


class EdgeDistribution(NamedTuple):
    """The distribution of edge points; detached. Rows are edges of the moving shapes, then intersections, then cuts.

    - `edge`: the number of the edge; `INTERSECTION` where faces intersect, `CUT` where a clipping plane cuts one.
    - `ends`: the ends of the edge.
    - `faces`, `opposite`: the faces at the edge, and the vertices of these faces that are not on it; padded with -1.
      Where faces intersect or are cut there are no `opposite` vertices.
    - `share`: which share of a jump counts.
    - `start`, `end`: film points of the visible part of the edge.
    - `clip`: fractions of the 3D edge at the ends of the part between near and far plane.
    - `homogeneous`: denominators of the projection there.
    - `range`: the part of the projected edge inside the film window.
    - `importance`: estimate of the jump of radiance, per unit of projected length.
    - `silhouettes`, `creases`: cumulative sums of length x importance over the edges of either kind.
    - `extent`: with an aperture, an upper bound of the projected length from every point of the aperture; else None.
    """

    edge: Int[Array, " E"]
    ends: Float[Array, "E 2 3"]
    faces: Int[Array, "E K"]
    opposite: Int[Array, "E K"]
    share: Float[Array, " E"]
    start: Float[Array, "E 2"]
    end: Float[Array, "E 2"]
    clip: Float[Array, "E 2"]
    homogeneous: Float[Array, "E 2"]
    range: Float[Array, "E 2"]
    importance: Float[Array, " E"]
    silhouettes: Float[Array, " E"]
    creases: Float[Array, " E"]
    extent: Float[Array, " E"] | None = None


class _Rows(NamedTuple):
    """Edges of the moving shapes, then intersections, then cuts; see `EdgeDistribution`."""

    edge: Int[Array, " E"]
    ends: Float[Array, "E 2 3"]
    faces: Int[Array, "E K"]
    opposite: Int[Array, "E K"]
    share: Float[Array, " E"]


def _rows(packed: PackedScene, moving: tuple[bool, ...], key: PRNGKeyArray, settings: PathSettings) -> _Rows:
    edges, number = packed.edges, packed.edges_of(moving)
    ends, one = packed.vertices[edges.vertices[number]], jnp.ones(number.shape, packed.vertices.dtype)
    room = ROOM * (4 + math.isqrt(packed.faces.shape[0]))
    moves = jnp.asarray(moving)[packed.face_shape]
    indirect = settings.max_depth > 2
    found = queries.face_intersections(packed.geometry, moves, seed_of(key), room, indirect, settings.rays)
    none = jnp.full((room, edges.faces.shape[1]), -1, jnp.int32)
    valid = found.first >= 0
    weight = jnp.where(valid, found.weight, 0.0)
    rows = (
        (number, jnp.full(room, INTERSECTION, jnp.int32)),
        (ends, jnp.where(valid[:, None, None], found.ends, ends[:1])),
        (edges.faces[number], none.at[:, :2].set(jnp.stack([found.first, found.second], -1))),
        (edges.opposite[number], none),
        (edges.shared(number, one), weight),
    )
    for k, plane in enumerate(cutting_planes(packed.camera)):
        cut = cut_segments(packed, moves, plane, room, jax.random.fold_in(key, k))
        of_cut = jnp.full(room, CUT, jnp.int32), cut.ends, none.at[:, :2].set(cut.face[:, None]), none
        rows = [(*row, more) for row, more in zip(rows, (*of_cut, cut.weight), strict=True)]
    return _Rows(*(jnp.concatenate(parts) for parts in rows))


def edge_distribution(
    packed: PackedScene, moving: tuple[bool, ...], key: PRNGKeyArray, settings: PathSettings, material: bool = False
) -> EdgeDistribution:
    """Distributions over silhouettes and creases of the `moving` shapes.

    A query finds where surfaces pass through each other. If there are too many places, there or at clipping planes,
    `key` chooses some. With `material` intersections are the only creases.
    """
    packed = jax.tree.map(stop_gradient, packed)
    camera, rows = packed.camera, _rows(packed, moving, key, settings)
    view = camera.view()
    p0, p1 = (view.local(end) for end in corners(rows.ends))
    z0, z1 = z_of(p0), z_of(p1)
    (near0, near1), (far0, far1) = (
        _clip(sign * (limit - z0), sign * (limit - z1))
        for sign, limit in ((1.0, camera.near_clip), (-1.0, camera.far_clip))
    )
    # The ends of a cut lie on a plane, up to rounding.
    cut = rows.edge == CUT
    t0 = jnp.where(cut, 0.0, jnp.maximum(near0, far0))
    t1 = jnp.where(cut, 1.0, jnp.minimum(near1, far1))
    in_front = t1 > t0
    q0, q1 = between(p0, p1, t0), between(p0, p1, t1)
    behind = ~in_front[:, None]
    ahead = jnp.asarray([0.0, 0.0, 1.0], q0.dtype)
    q0, q1 = jnp.where(behind, ahead, q0), jnp.where(behind, ahead, q1)
    start, end = view.project_local(q0), view.project_local(q1)
    extent, margin = norm(end - start), None
    if camera.aperture:
        blur0, blur1 = camera.blur(q0), camera.blur(q1)
        extent, margin = extent + jnp.abs(blur0 - blur1), jnp.maximum(jnp.abs(blur0), jnp.abs(blur1))
    s0, s1 = _inside_window(camera.film, start, end, margin)
    length = jnp.where(in_front & (rows.share > 0), extent * jnp.maximum(s1 - s0, 0.0), 0.0)
    silhouette, importance = _importance(packed, moving, rows, fixed_key(0))
    mass = length * importance
    crease = (rows.edge == INTERSECTION) if material else ~silhouette
    return EdgeDistribution(
        edge=rows.edge,
        ends=rows.ends,
        faces=rows.faces,
        opposite=rows.opposite,
        share=rows.share,
        start=start,
        end=end,
        clip=from_components(t0, t1),
        homogeneous=from_components(view.homogeneous(q0), view.homogeneous(q1)),
        range=from_components(s0, s1),
        importance=importance,
        silhouettes=jnp.cumsum(jnp.where(silhouette, mass, 0.0)),
        creases=jnp.cumsum(jnp.where(crease, mass, 0.0)),
        extent=extent if camera.aperture else None,
    )


def _clip(outside0, outside1):
    """Parameter range (low, high) in which a linear function with these end values is not positive; (1, 0) if empty."""
    change = outside1 - outside0
    root = safe_divide(-outside0, change)
    low = jnp.where(outside0 > 0, jnp.where(outside1 > 0, 1.0, root), 0.0)
    high = jnp.where(outside1 > 0, jnp.where(outside0 > 0, 0.0, root), 1.0)
    return low, high


def _inside_window(film, start, end, margin=None):
    """Parameter range of projected edges inside the window, widened by the filter's radius and `margin` pixels."""
    x0, y0, width, height = film.window
    reach = film.filter.radius if margin is None else film.filter.radius + margin
    reach = jnp.broadcast_to(reach, start.shape[:1])[:, None]
    first, last = jnp.asarray((x0, y0), start.dtype), jnp.asarray((x0 + width, y0 + height), start.dtype)
    # Distance outside each of the four sides, [E, 4].
    outside = (jnp.concatenate([first - reach - p, p - last - reach], -1) for p in (start, end))
    low, high = _clip(*outside)
    return low.max(-1), high.min(-1)


def _importance(packed: PackedScene, moving: tuple[bool, ...], rows: _Rows, key):
    """(is a silhouette, estimate of the jump of radiance per unit length of projected edge).

    The jump at a crease has three parts: the difference of the unshadowed light that the two faces receive from a few
    emitter samples; a share of their fold, which stands for all other light; and the difference of their textures. The
    jump at a silhouette is the light that the brighter face receives, and a typical value for the background; so is it
    where surfaces pass through each other, which may have different materials. These estimates change the noise only.
    """
    intersection, cut = rows.edge == INTERSECTION, rows.edge == CUT
    faces, row_of = packed.faces_of(moving)
    own, edges = faces.shape[0], packed.edges_of(moving).shape[0]
    number, sharing = rows.edge[:edges], jnp.maximum(rows.faces[edges:, :2], 0)
    faces = jnp.concatenate([faces, sharing.T.reshape(-1)])
    triangles, shape = packed.corners_of(faces), packed.face_shape[faces]
    corner, normal = corners(triangles)[0], normalize(triangle_normals(triangles))
    front = dot(normal, packed.camera.view().towards(corner)) > 0
    # Turn the normals towards the camera. Then two faces in one plane have no crease, however they are oriented.
    normal = jnp.where(front[:, None], normal, -normal)
    smooth = jnp.asarray(packed.smooth)[shape]
    lit = front | packed.two_sided[shape]  # one-sided faces seen from behind are black
    if (through := packed.spreads_through) is not None:
        lit |= through[shape]
    received = jnp.where(lit, _unshadowed(packed, corner, normal, smooth, key), 0.0)

    pair, interior = packed.edges.faces[number, :2], packed.edges.interior[number]
    first, second = components(pair)
    face0 = row_of(first)
    face1 = jnp.where(second >= 0, row_of(second), face0)
    added = own + jnp.arange(sharing.shape[0])
    face0, face1 = jnp.concatenate([face0, added]), jnp.concatenate([face1, added + sharing.shape[0]])
    interior = jnp.concatenate([interior, jnp.ones(added.shape, bool)])
    # Edges of one face or of more than two count as silhouettes. Both sides are estimated, so either kind is right.
    silhouette = ~interior | cut | ((front[face0] != front[face1]) & ~intersection)
    if packed.camera.aperture:  # add the edges that are silhouettes from a part of the aperture
        turns = packed.camera.turns(corner, normal)
        silhouette = silhouette | ((turns[face0] | turns[face1]) & ~intersection)
    fold = norm(normal[face0] - normal[face1])
    jump = jnp.abs(received[face0] - received[face1])
    mean = received[:own].mean()
    typical = jnp.where(mean > 0, mean, 1.0)
    crease = jump + typical * jnp.where(smooth[face0], SMOOTH, 1.0) * fold
    if packed.has_seams:
        light = 0.5 * (received[face0] + received[face1]) + 0.1 * typical
        crease = crease + light * jnp.pad(seam_jumps(packed, number), (0, sharing.shape[0]))
    if packed.glow:  # radiance x pi: the irradiance with which a white surface would look as bright
        crease = crease + jnp.pi * jnp.pad(glow_jumps(packed, number), (0, sharing.shape[0]))
    bright = jnp.maximum(received[face0], received[face1])
    return silhouette, jnp.where(silhouette | intersection, 0.5 * (typical + bright), crease)


def _unshadowed(packed: PackedScene, corner, normal, smooth, key) -> Float[Array, " F"]:
    """Irradiance (magnitude) of faces from a few emitter samples, without visibility.

    Interpolated normals agree at an edge. So smooth faces have one constant cosine, or zero where they face away.
    """
    if not has_emitters(packed):
        return jnp.zeros(corner.shape[0], corner.dtype)

    def arriving(sample):
        """From one emitter sample."""
        offset = sample.point.position - corner
        squared = jnp.maximum(dot(offset, offset), 1e-30)
        direction = jnp.where(sample.infinite, sample.direction, scale(offset, 1.0 / jnp.sqrt(squared)))
        facing = jnp.maximum(-dot(direction, sample.point.normal), 0.0) / squared
        if sample.light is None:
            power = magnitude(sample.radiance) / sample.pdf
        else:
            one = jax.tree.map(lambda x: jnp.broadcast_to(x, (corner.shape[0], *x.shape)), sample)
            power = magnitude(radiance_towards(packed, one, direction)) / sample.pdf
            facing = jnp.where(one.is_delta, 1.0 / squared, facing)
        cosine = dot(direction, normal)
        cosine = jnp.where(smooth, jnp.where(cosine > 0, 0.3, 0.0), jnp.maximum(cosine, 0.0))
        return cosine * jnp.where(sample.infinite, 1.0, facing) * power

    samples = sample_emitter(packed, lattice(key, 1, jnp.arange(PILOTS), 2, corner.dtype))
    return jax.vmap(arriving)(samples).mean(0)


def sample_edges(
    distribution: EdgeDistribution, cdf: Float[Array, " E"], count: int, key
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """Rows, fractions of the projected edges, and 1 / (count x density per pixel of length)."""
    total = cdf[-1]
    strata = jnp.arange(count, dtype=cdf.dtype) + uniform(key, (count,), cdf.dtype)
    target = strata / count * total
    edge, along, mass = sample_cdf(cdf, target)
    low, high = components(distribution.range[edge])
    importance = distribution.importance[edge]
    weight = jnp.where(mass > 0, total / (count * jnp.where(importance > 0, importance, 1.0)), 0.0)
    return edge, low + along * (high - low), weight
