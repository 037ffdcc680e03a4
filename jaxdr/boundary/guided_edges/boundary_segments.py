"""Boundary segments from their middle: a point on an edge and a direction, by two strategies (Yan et al. 2022, 4.2).

A strategy maps primary numbers (u1, u2, u3) to a point x_B on an edge and a unit direction w_B from the detector's end
x_D to the source's end x_S. Densities are per length of edge and solid angle at x_B: they are the reciprocal of the
Jacobian J_B (Eq. 5). Both maps have inverses. So each strategy knows its exact density of the other's samples (Eq. 15).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

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
    - `emitter`: the emitter's point that was drawn, valid where it is on a surface; None if only a direction was drawn.
    """

    point: LunePoints
    position: Float[Array, "n 3"]
    towards: Float[Array, "n 3"]
    pole: Float[Array, "n 3"]
    scale: Float[Array, " n"]
    sine: Float[Array, " n"]
    silhouette: Bool[Array, " n"]
    emitter: SurfacePoint | None


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
    def segments(packed: PackedScene, lunes: EdgeLunes, u: Float[Array, "n 3"]) -> BoundarySegments:
        """Lines from primary numbers."""
        point = edge_points(lunes, u[:, 0])
        return lines_past(lunes, point, lune_directions(lunes, point.row, u[:, 1:]), None)

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
    def segments(packed: PackedScene, lunes: EdgeLunes, u: Float[Array, "n 3"]) -> BoundarySegments:
        """Lines from primary numbers; those towards lights without area do not count."""
        point = edge_points(lunes, u[:, 0])
        sample = sample_emitter(packed, u[:, 1:])
        towards = sample.direction_from(point.position(lunes))
        drawn = lines_past(lunes, point, towards, sample.point)
        return drawn._replace(silhouette=drawn.silhouette & sample.shines_on(towards))

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


def lines_past(
    lunes: EdgeLunes, point: LunePoints, towards: Float[Array, "n 3"], emitter: SurfacePoint | None
) -> BoundarySegments:
    """Lines in unit directions past points on edges."""
    passed = passing(lunes, point.row, towards)
    pole = occluded_side(lunes, point.row, passed)
    sine = jnp.sqrt(jnp.maximum(1.0 - passed.cosine**2, 0.0))
    position, start, side = point.position(lunes), lunes.start[point.row], lunes.side[point.row]
    size = jnp.maximum(jnp.abs(start), jnp.abs(start + side)).max(-1)
    return BoundarySegments(point, position, towards, pole, size, sine, passed.silhouette, emitter)


def segment_ends(packed: PackedScene, drawn: BoundarySegments, active: Bool[Array, " n"], rays: str) -> BoundaryEnds:
    """Both ends of lines past edges, from rays that start just beside them."""
    beside = queries.BESIDE * drawn.scale
    start = drawn.position - scale(drawn.pole, beside)
    hidden = jnp.zeros_like(active)
    if drawn.emitter is None:
        source = _hit(packed, start, drawn.towards, active, rays)
    else:
        source = drawn.emitter
        end = leave(source, -drawn.towards)
        offset = jnp.where(source.valid[:, None], end - start, 2.0 * packed.size * drawn.towards)
        reach = jnp.where(active, 1.0, 0.0).astype(start.dtype)
        hidden = queries.occluded(packed.geometry, queries.Rays(start, offset, reach), rays)
    detector = _hit(packed, start, -drawn.towards, active & ~hidden, rays)
    to_edge = drawn.position - detector.position
    apart = (norm(to_edge) > APART * beside) & (jnp.abs(dot(detector.normal, to_edge)) > ABOVE * beside)
    return BoundaryEnds(detector, source, active & ~hidden & detector.valid & apart)


def _hit(packed: PackedScene, start, direction, active, rays: str) -> SurfacePoint:
    reach = jnp.where(active, 1e30, 0.0).astype(start.dtype)
    return material_hit(packed, queries.closest_hit(packed.geometry, queries.Rays(start, direction, reach), rays))
