"""Boundary segments from their middle: a point on an edge and a direction, by two strategies (Yan et al. 2022, 4.2).

A strategy maps primary numbers (u1, u2, u3) to a point x_B on an edge and a unit direction w_B from the detector's end
x_D to the source's end x_S. Densities are per length of edge and solid angle at x_B: they are the reciprocal of the
Jacobian J_B (Eq. 5). Both maps have inverses. So each strategy knows its exact density of the other's samples (Eq. 15).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.guided_edges.edge_lunes import (
    EdgeLunes,
    LunePoints,
    edge_number,
    edge_points,
    lune_directions,
    lune_numbers,
    lune_pdf,
    occluded_side,
    passing,
)
from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, norm, scale
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitter_pdf, sample_emitter
from jaxdr.transport.emitter_numbers import emitter_numbers
from jaxdr.transport.interaction import SurfacePoint, leave, material_hit

# In offsets of the rays, of edges from detectors.
APART = 4.0  # smallest distance; nearer, edge and shadow coincide
# Smallest height over the detector's face. An edge in the plane of a face casts no shadow on it. Rays beside the edge
# can hit the face all the same. Lunes leave such lines out, but only where the mesh says that edge and face meet.
ABOVE = 0.25


class BoundarySegments(NamedTuple):
    """Lines past edges; detached.

    - `towards`: unit direction to the source.
    - `pole`: unit normal of the plane through edge and line, towards the faces.
    - `scale`: the edge's largest coordinate. `sine`: of the angle between edge and line.
    - `silhouette`: the edge is a silhouette in this direction.
    - `aim`: the emitter's points that were drawn; None if all lines have only a direction.
    """

    point: LunePoints
    position: Float[Array, "n 3"]
    towards: Float[Array, "n 3"]
    pole: Float[Array, "n 3"]
    scale: Float[Array, " n"]
    sine: Float[Array, " n"]
    silhouette: Bool[Array, " n"]
    aim: "Aim | None"


class Aim(NamedTuple):
    """Emitters' points that lines go to.

    - `emitter`: the points, valid where they are on a surface.
    - `there`: whether a line goes to such a point; None if all do. The others have only a direction.
    - `shines`: whether the point emits light against the line.
    """

    emitter: SurfacePoint
    there: Bool[Array, " n"] | None
    shines: Bool[Array, " n"]


class BoundaryEnds(NamedTuple):
    """Both ends of boundary segments as material points, detached; a source that is not valid is the environment.

    `valid`: there is a detector, at a distance from the edge, which is not in the plane of its face, and nothing hides
    the source that was drawn.
    """

    detector: SurfacePoint
    source: SurfacePoint
    valid: Bool[Array, " n"]


class DirectionSampling:
    """Directions uniform over those in which the edge is a silhouette (`edge_lunes`): J_B = 4 b / p(x_B)."""

    samples_emitters = False

    @staticmethod
    def directions(
        packed: PackedScene, lunes: EdgeLunes, point: LunePoints, u: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n 3"], None]:
        """Unit directions from the last two primary numbers, and nothing that they aim at."""
        return lune_directions(lunes, point.row, u), None

    @staticmethod
    def density(
        packed: PackedScene, lunes: EdgeLunes, drawn: BoundarySegments, ends: BoundaryEnds | None = None
    ) -> Float[Array, " n"]:
        """1 / J_B: per length and solid angle."""
        return lunes.density[drawn.point.row] * lune_pdf(lunes, drawn.point.row)

    @staticmethod
    def numbers(
        packed: PackedScene, lunes: EdgeLunes, drawn: BoundarySegments, ends: BoundaryEnds | None = None
    ) -> Float[Array, "n 3"]:
        """Primary numbers of lines past edges."""
        passed = passing(lunes, drawn.point.row, drawn.towards)
        u = lune_numbers(lunes, drawn.point.row, passed)
        return jnp.concatenate([edge_number(lunes, drawn.point)[:, None], u], -1)


class EmitterSampling:
    """Directions to emitter samples: J_B = |cos| / (r^2 p(x_B) p(x_S)); for the environment 1 / (p(x_B) p(w_B))."""

    samples_emitters = True

    @staticmethod
    def directions(
        packed: PackedScene, lunes: EdgeLunes, point: LunePoints, u: Float[Array, "n 2"]
    ) -> tuple[Float[Array, "n 3"], Aim]:
        """Unit directions from the last two primary numbers, and emitters' points. Lights without area do not shine."""
        sample = sample_emitter(packed, u)
        towards = sample.direction_from(point.position(lunes))
        return towards, Aim(sample.point, None, sample.shines_on(towards))

    @staticmethod
    def density(
        packed: PackedScene, lunes: EdgeLunes, drawn: BoundarySegments, ends: BoundaryEnds
    ) -> Float[Array, " n"]:
        """1 / J_B: per length and solid angle, where the source may emit light; zero elsewhere."""
        offset = ends.source.position - drawn.position
        distance2 = jnp.where(ends.source.valid, dot(offset, offset), 1.0)
        cosine = -dot(ends.source.normal, drawn.towards)
        pdf = emitter_pdf(packed, ends.source, drawn.towards, distance2, cosine)
        glows = ~ends.source.valid | (cosine > 0)
        return lunes.density[drawn.point.row] * jnp.where(glows, pdf, 0.0)

    @staticmethod
    def numbers(
        packed: PackedScene, lunes: EdgeLunes, drawn: BoundarySegments, ends: BoundaryEnds
    ) -> Float[Array, "n 3"]:
        """Primary numbers of lines towards emitters."""
        u, _ = emitter_numbers(packed, ends.source, drawn.towards)
        return jnp.concatenate([edge_number(lunes, drawn.point)[:, None], u], -1)


Strategy = type[DirectionSampling] | type[EmitterSampling]


def segments(
    packed: PackedScene,
    lunes: EdgeLunes,
    strategies: Sequence[Strategy],
    u: Float[Array, "n 3"],
    by: Int[Array, " n"] | None = None,
) -> BoundarySegments:
    """Lines from primary numbers. If there are two strategies, each line is drawn by that of number `by`."""
    point = edge_points(lunes, u[:, 0])
    found = [strategy.directions(packed, lunes, point, u[:, 1:]) for strategy in strategies]
    if len(found) == 1:
        return lines_past(lunes, point, *found[0])
    towards = jnp.where((by == 0)[:, None], found[0][0], found[1][0])
    (aimed,) = (number for number, strategy in enumerate(strategies) if strategy.samples_emitters)
    return lines_past(lunes, point, towards, found[aimed][1]._replace(there=by == aimed))


def lines_past(
    lunes: EdgeLunes, point: LunePoints, towards: Float[Array, "n 3"], aim: Aim | None = None
) -> BoundarySegments:
    """Lines in unit directions past points on edges."""
    passed = passing(lunes, point.row, towards)
    pole = occluded_side(lunes, point.row, passed)
    sine = jnp.sqrt(jnp.maximum(1.0 - passed.cosine**2, 0.0))
    position, start, side = point.position(lunes), lunes.start[point.row], lunes.side[point.row]
    size = jnp.maximum(jnp.abs(start), jnp.abs(start + side)).max(-1)
    counts = passed.silhouette
    if aim is not None:
        counts &= aim.shines if aim.there is None else aim.shines | ~aim.there
    return BoundarySegments(point, position, towards, pole, size, sine, counts, aim)


def segment_ends(packed: PackedScene, drawn: BoundarySegments, active: Bool[Array, " n"], rays: str) -> BoundaryEnds:
    """Both ends of lines past edges, from rays that start just beside them."""
    beside = queries.BESIDE * drawn.scale
    start = drawn.position - scale(drawn.pole, beside)
    hidden, far = jnp.zeros_like(active), jnp.where(active, 1e30, 0.0).astype(start.dtype)
    if drawn.aim is None:
        source = _hit(packed, start, drawn.towards, far, rays)
    else:
        source, there = drawn.aim.emitter, drawn.aim.there
        end = leave(source, -drawn.towards)
        offset = jnp.where(source.valid[:, None], end - start, 2.0 * packed.size * drawn.towards)
        reach = jnp.where(active, 1.0, 0.0).astype(start.dtype)
        if there is None:
            hidden = queries.occluded(packed.geometry, queries.Rays(start, offset, reach), rays)
        else:
            offset = jnp.where(there[:, None], offset, drawn.towards)
            hit = _hit(packed, start, offset, jnp.where(there, reach, far), rays)
            hidden = there & hit.valid
            source = jax.tree.map(lambda a, b: jnp.where(there.reshape(-1, *[1] * (a.ndim - 1)), a, b), source, hit)
    detector = _hit(packed, start, -drawn.towards, jnp.where(hidden, 0.0, far), rays)
    to_edge = drawn.position - detector.position
    apart = (norm(to_edge) > APART * beside) & (jnp.abs(dot(detector.normal, to_edge)) > ABOVE * beside)
    return BoundaryEnds(detector, source, active & ~hidden & detector.valid & apart)


def _hit(packed: PackedScene, start, direction, reach, rays: str) -> SurfacePoint:
    return material_hit(packed, queries.closest_hit(packed.geometry, queries.Rays(start, direction, reach), rays))
