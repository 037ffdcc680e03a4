"""Walks along silhouettes, from edge to edge, as a fixed point sees them: the small step that mesh chains are made of.

A point walks a length along its edge. At a vertex it goes on along another edge there that is a silhouette too, so it
stays on the outline. Which one? The edges at a vertex stand in a list that is closed to a ring. A walk runs through all
rings in one sense, chosen at random, and takes the first silhouette that it meets. The walk back runs in the other
sense and meets the same edges. Lengths are kept. So a walk is as likely as its reverse, per length of edge. From a
vertex without another silhouette it turns back on its own edge.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, LunePoints, passing
from jaxdr.geometry.vector import norm, scale
from jaxdr.safe_divide import safe_divide

LOOKS = 48  # at most so many edges are looked at in a walk; longer walks do not count, neither way


class EdgeRings(NamedTuple):
    """The ends of edges around vertices. End 2 k + s is the start (s = 0) or the end (s = 1) of row k of the lunes.

    `end`: all ends, those of one vertex in a row. `place`: where each of them is. `first`, `count`: the ends of the
    vertex of each of them, of edges that are drawn.
    """

    end: Int[Array, " M"]
    place: Int[Array, " M"]
    first: Int[Array, " M"]
    count: Int[Array, " M"]


class Seen(NamedTuple):
    """What walks keep in view: points, or unit directions where `infinite`."""

    place: Float[Array, "n 3"]
    infinite: Bool[Array, " n"]

    def towards(self, position: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Vectors from positions towards it, of any length."""
        return jnp.where(self.infinite[:, None], self.place, self.place - position)


def edge_rings(lunes: EdgeLunes) -> EdgeRings:
    """The rings of all vertices; edges that are never drawn are in none."""
    vertex = jnp.where(lunes.density[:, None] > 0, lunes.vertices, -1).reshape(-1)
    end = jnp.argsort(vertex).astype(jnp.int32)
    at = vertex[end]
    first = jnp.searchsorted(at, vertex, side="left").astype(jnp.int32)
    count = jnp.searchsorted(at, vertex, side="right").astype(jnp.int32) - first
    place = jnp.zeros_like(end).at[end].set(jnp.arange(end.shape[0], dtype=jnp.int32))
    return EdgeRings(end, place, first, count)


class _Walk(NamedTuple):
    """Walkers that stand at the `end` of an edge, with a length `left` to go, and have looked at `looks` edges there.

    Those that have arrived are at `point`.
    """

    end: Int[Array, " n"]
    left: Float[Array, " n"]
    looks: Int[Array, " n"]
    point: LunePoints
    arrived: Bool[Array, " n"]


def walk(
    lunes: EdgeLunes,
    rings: EdgeRings,
    start: LunePoints,
    seen: Seen,
    length: Float[Array, " n"],
    sense: Bool[Array, " n"],
) -> tuple[LunePoints, Bool[Array, " n"]]:
    """(points after walks along the silhouettes that `seen` sees, whether a walk has arrived after `LOOKS` edges).

    `length`: signed, towards the end of the start's edge where it is positive. `sense`: in which rings are run through.
    """
    far = (length > 0).astype(jnp.int32)
    whole = _length(lunes, start.row)
    room = whole * jnp.where(far == 1, 1.0 - start.along, start.along)
    distance = jnp.abs(length)
    there = jnp.clip(start.along + safe_divide(length, whole), 0.0, 1.0)
    begun = _Walk(
        end=2 * start.row + far,
        left=distance - room,
        looks=jnp.zeros_like(far),
        point=LunePoints(start.row, there),
        arrived=distance <= room,
    )

    def look(state: _Walk) -> _Walk:
        at = state.end
        count = jnp.maximum(rings.count[at], 1)
        turn = (state.looks + 1) * jnp.where(sense, 1, -1)
        other = rings.end[rings.first[at] + (rings.place[at] - rings.first[at] + turn) % count]
        row, side = other // 2, other % 2
        vertex = lunes.start[row] + scale(lunes.side[row], side.astype(lunes.start.dtype))
        onward = passing(lunes, row, seen.towards(vertex)).silhouette
        whole = _length(lunes, row)
        share = safe_divide(state.left, whole)
        arrives = onward & (state.left <= whole)
        along = jnp.clip(jnp.where(side == 0, share, 1.0 - share), 0.0, 1.0)
        moved = _Walk(
            end=jnp.where(onward, 2 * row + 1 - side, at),
            left=jnp.where(onward, state.left - whole, state.left),
            looks=jnp.where(onward, 0, state.looks + 1),
            point=LunePoints(jnp.where(arrives, row, state.point.row), jnp.where(arrives, along, state.point.along)),
            arrived=arrives,
        )
        return jax.tree.map(lambda old, new: jnp.where(state.arrived, old, new), state, moved)

    def goes_on(numbered):
        number, state = numbered
        return (number < LOOKS) & ~state.arrived.all()

    _, last = loops.while_loop(goes_on, lambda s: (s[0] + 1, look(s[1])), (jnp.int32(0), begun))
    return last.point, last.arrived


def _length(lunes: EdgeLunes, row: Int[Array, " n"]) -> Float[Array, " n"]:
    return norm(lunes.side[row])
