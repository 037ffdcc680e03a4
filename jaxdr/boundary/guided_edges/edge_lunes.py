"""Edges and the directions in which each is a silhouette: the space that boundary segments are drawn from.

A line through a point of an edge in the direction w is a boundary segment if all faces at the edge lie on one side of
the plane through edge and w. Around the edge these planes fill the angle b, which is pi less the angle that the faces
span. So the directions of such lines form two opposite lunes of the sphere, of total solid angle 4 b. An edge is drawn
in proportion to its length times b: then the lines that touch a surface are drawn evenly (Cauchy-Crofton).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.guided_edges.edge_chains import EdgeOrder
from jaxdr.boundary.shared.projection import never_silhouettes
from jaxdr.geometry.vector import (
    Frame,
    between,
    components,
    corners,
    cross,
    dot,
    from_components,
    norm,
    normalize,
    orthonormal_basis,
    scale,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.sampler import sample_cdf

STILL = 0.25  # share of the samples for edges at rest while others move: their receivers and lights may move


class EdgeLunes(NamedTuple):
    """All edges of a scene, in the order of the first primary number; detached.

    - `edge`: row k is this edge of the packed scene, from `start` to `start + side`, between its two `vertices`.
    - `first`, `second`: a unit frame across the edge. In it, silhouettes have directions at angles from 0 to `width`
      and from pi to pi + `width`. The faces lie clockwise of 0.
    - `cdf`: cumulative probabilities of the rows; `density`: per length.
    - `share`: the part of the jump that counts at a row. A face without area has two long edges in one place; they
      share the jump.
    """

    edge: Int[Array, " E"]
    vertices: Int[Array, "E 2"]
    start: Float[Array, "E 3"]
    side: Float[Array, "E 3"]
    tangent: Float[Array, "E 3"]
    first: Float[Array, "E 3"]
    second: Float[Array, "E 3"]
    width: Float[Array, " E"]
    cdf: Float[Array, " E"]
    density: Float[Array, " E"]
    share: Float[Array, " E"]


class LunePoints(NamedTuple):
    """Points on edges, which are rows of an `EdgeLunes`, at the fraction `along`."""

    row: Int[Array, " n"]
    along: Float[Array, " n"]

    def position(self, lunes: EdgeLunes) -> Float[Array, "n 3"]:
        """Positions of the points, detached."""
        return lunes.start[self.row] + scale(lunes.side[self.row], self.along)

    def moving(self, packed: PackedScene, lunes: EdgeLunes) -> Float[Array, "n 3"]:
        """Positions of the points, differentiable."""
        return between(*corners(packed.vertices[lunes.vertices[self.row]]), self.along)


class Passing(NamedTuple):
    """How directions pass an edge.

    `turn`, in [0, pi), is the angle around the edge of the plane through edge and direction; `lune` is 0 or 1; `cosine`
    is that of the angle to the edge. `silhouette`: all faces lie on one side of the plane.
    """

    turn: Float[Array, " n"]
    lune: Int[Array, " n"]
    cosine: Float[Array, " n"]
    silhouette: Bool[Array, " n"]


def edge_lunes(packed: PackedScene, moving: tuple[bool, ...], order: EdgeOrder | None = None) -> EdgeLunes:
    """Lunes of all edges, in the given order or the scene's.

    `moving`: which shapes move relative to the camera.
    """
    packed = jax.tree.map(stop_gradient, packed)
    edges = packed.edges
    number, pairs = jnp.arange(edges.vertices.shape[0]), edges.vertices
    if order is not None:
        number, pairs = order.edge, pairs[order.edge]
        pairs = jnp.where(order.turned[:, None], pairs[:, ::-1], pairs)
    ends = packed.vertices[pairs]
    start, end = corners(ends)
    side = end - start
    length, tangent = norm(side), normalize(side)
    across, second = orthonormal_basis(jnp.where((length > 0)[:, None], tangent, jnp.asarray([0.0, 0.0, 1.0])))
    corner = packed.vertices[edges.opposite[number]] - start[:, None]
    x, y = dot(corner, across[:, None]), dot(corner, second[:, None])
    there = edges.faces[number] >= 0
    rounding = 16 * jnp.finfo(ends.dtype).eps * jnp.abs(ends).max((-1, -2))
    real = there & (jnp.hypot(x, y) > rounding[:, None])
    counts = real.sum(1) / jnp.maximum(there.sum(1), 1)
    angle = jnp.arctan2(y, x)
    # Slots without a face, or whose face has no area, repeat a face with area. Then find the widest gap between faces.
    one = jnp.take_along_axis(angle, real.argmax(1)[:, None], 1)
    angle = jnp.sort(jnp.where(real, angle, one), axis=1)
    gap = jnp.diff(angle, append=angle[:, :1] + 2 * math.pi, axis=1)
    widest = gap.argmax(1)[:, None]
    before = jnp.take_along_axis(angle, widest, 1)
    width = jnp.maximum(jnp.take_along_axis(gap, widest, 1)[:, 0] - math.pi, 0.0)
    first = jnp.cos(before) * across + jnp.sin(before) * second

    weight = jnp.where(never_silhouettes(packed)[number] | ~real.any(1), 0.0, length * width)
    if any(moving) and not all(moving):
        moves = jnp.asarray(moving)[edges.shape[number]]
        moved, still = jnp.where(moves, weight, 0.0).sum(), jnp.where(moves, 0.0, weight).sum()
        both = (moved > 0) & (still > 0)
        share = jnp.where(both, jnp.where(moves, (1 - STILL) / moved, safe_divide(STILL, still, both)), 1.0)
        weight = weight * share
    cdf = jnp.cumsum(weight)
    total = jnp.where(cdf[-1] > 0, cdf[-1], 1.0)
    density = weight / (total * jnp.where(length > 0, length, 1.0))
    second = cross(tangent, first)
    share = packed.edges.shared(number, counts.astype(length.dtype))
    return EdgeLunes(number, pairs, start, side, tangent, first, second, width, cdf / total, density, share)


def edge_points(lunes: EdgeLunes, u: Float[Array, " n"]) -> LunePoints:
    """Points on edges from the first primary number."""
    row, along, _ = sample_cdf(lunes.cdf, u)
    return LunePoints(row, along)


def edge_number(lunes: EdgeLunes, points: LunePoints) -> Float[Array, " n"]:
    """The first primary number of points: the inverse of `edge_points`."""
    before = jnp.where(points.row > 0, lunes.cdf[points.row - 1], 0.0)
    return before + points.along * (lunes.cdf[points.row] - before)


def acceptance(lunes: EdgeLunes, row: Int[Array, " n"], tried: float) -> Float[Array, " n"]:
    """Probabilities with which silhouettes are kept, if `tried` lines are drawn for every segment.

    Of lines in random directions, a share of width / pi passes an edge as a silhouette. Sharp edges and borders need no
    tries: without this choice they would get nearly all segments.
    """
    if tried <= 1:
        return jnp.ones_like(lunes.width[row])
    return math.pi / jnp.maximum(tried * lunes.width[row], math.pi)


def passing(lunes: EdgeLunes, row: Int[Array, " n"], direction: Float[Array, "n 3"]) -> Passing:
    """How unit directions pass the edges of some rows."""
    x, y = dot(direction, lunes.first[row]), dot(direction, lunes.second[row])
    angle = jnp.mod(jnp.arctan2(y, x), 2 * math.pi)
    lune = (angle >= math.pi).astype(jnp.int32)
    turn = angle - math.pi * lune
    width = lunes.width[row]
    return Passing(turn, lune, dot(direction, lunes.tangent[row]), (turn <= width) & (width > 0))


def occluded_side(lunes: EdgeLunes, row: Int[Array, " n"], passed: Passing) -> Float[Array, "n 3"]:
    """Unit normals of the planes through edges and directions, towards the faces."""
    # In the second lune the direction is turned by pi, and the plane is the same: the same normal points to the faces.
    return scale(lunes.first[row], jnp.sin(passed.turn)) - scale(lunes.second[row], jnp.cos(passed.turn))


def lune_directions(lunes: EdgeLunes, row: Int[Array, " n"], u: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    """Directions of silhouettes, uniform over the two lunes (density `lune_pdf`)."""
    u0, u1 = components(u)
    doubled = 2.0 * u0
    lune = jnp.floor(doubled)
    angle = (doubled - lune) * lunes.width[row] + math.pi * lune
    cosine = 1.0 - 2.0 * u1
    sine = jnp.sqrt(jnp.maximum(1.0 - cosine * cosine, 0.0))
    local = from_components(sine * jnp.cos(angle), sine * jnp.sin(angle), cosine)
    return Frame(lunes.first[row], lunes.second[row], lunes.tangent[row]).to_world(local)


def lune_numbers(lunes: EdgeLunes, row: Int[Array, " n"], passed: Passing) -> Float[Array, "n 2"]:
    """The inverse of `lune_directions`."""
    width = lunes.width[row]
    share = jnp.clip(safe_divide(passed.turn, width), 0.0, 1.0)
    return from_components(0.5 * (passed.lune + share), 0.5 * (1.0 - passed.cosine))


def lune_pdf(lunes: EdgeLunes, row: Int[Array, " n"]) -> Float[Array, " n"]:
    """Density (solid angle) of `lune_directions`."""
    width = lunes.width[row]
    return safe_divide(0.25, width, otherwise=0.0)
