"""Inputs and answers of ray queries, as records of arrays; `api` describes the queries.

There are N rows of rays, segments or sectors; V vertices; F faces; E edges with up to K faces each.
"""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.edge_tree import EdgeTree


class Geometry(NamedTuple):
    """The triangles that all queries are about."""

    vertices: Float[Array, "V 3"]
    faces: Int[Array, "F 3"]


class Rays(NamedTuple):
    """Rays `origin + t direction`, 0 < t < `reach`. A row without positive reach has no ray."""

    origin: Float[Array, "N 3"]
    direction: Float[Array, "N 3"]
    reach: Float[Array, " N"]


class Lines(NamedTuple):
    """Lines through points along unit normals, up to `depth` to both sides, and the `shape` that they are to cross.

    A depth of zero leaves a point out.
    """

    point: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    depth: Float[Array, " N"]
    shape: Int[Array, " N"]


class EdgeSet(NamedTuple):
    """Edges by the numbers of their ends, their faces, and these faces' third corners (`opposite`); padded with -1.

    `interior` edges have two faces that agree on the orientation. Only they can be skipped because both faces face a
    point, or both face away. `rank` is the importance of an edge, 0 to leave it out: its kernel radius, or as the query
    says. `tree` is `queries.edge_tree` of the same edges.
    """

    ends: Int[Array, "E 2"]
    faces: Int[Array, "E K"]
    opposite: Int[Array, "E K"]
    interior: Bool[Array, " E"]
    rank: Float[Array, " E"]
    tree: EdgeTree | None = None

    @classmethod
    def of(cls, edges: Any, rank: Float[Array, " E"], tree: EdgeTree | None = None) -> "EdgeSet":
        """The edges of a packed scene."""
        return cls(edges.vertices, edges.faces, edges.opposite, edges.interior, rank, tree)


class EdgePoints(NamedTuple):
    """Points on edges, with their kernel radii."""

    position: Float[Array, "M 3"]
    edge: Int[Array, " M"]
    radius: Float[Array, " M"]


class StripQuery(NamedTuple):
    """Segments from `apex` to `target`, the unit `normal` of the plane at the target, and the kernel radii.

    The radius is r = rank * `scale` (scene units) at an edge. The projection magnifies it up to `widest`; if that is
    smaller than r, the radius is r. A scale of zero leaves a segment out.
    """

    apex: Float[Array, "N 3"]
    target: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    scale: Float[Array, " N"]
    widest: Float[Array, " N"]


class SectorQuery(NamedTuple):
    """Planar sectors between an `apex` and a chord from `first` to `last`.

    `centre`: the fraction of the chord from which layers are counted. `needed`: the least rank of edges that count; 0
    leaves a chord out. `group`: the group of the faces that hide nothing, or `NO_GROUP`, `UNBOUNDED`.
    """

    apex: Float[Array, "N 3"]
    first: Float[Array, "N 3"]
    last: Float[Array, "N 3"]
    centre: Float[Array, " N"]
    needed: Float[Array, " N"]
    group: Int[Array, " N"]


class ConeQuery(NamedTuple):
    """Cones of directions around the unit `direction` at an `apex`, with the half-angle `reach` in radians.

    `normal`: edges that lie wholly below the plane through the apex with this unit normal, or in it up to rounding,
    don't count. With a normal of zero all edges count. A reach of zero leaves a cone out.
    """

    apex: Float[Array, "N 3"]
    direction: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    reach: Float[Array, " N"]


class ClosestSilhouettes(NamedTuple):
    """For each cone an edge, -1 if none is in reach, and the fraction `along` it of the point nearest in angle."""

    edge: Int[Array, " N"]
    along: Float[Array, " N"]


class EdgeTable(NamedTuple):
    """Edges at which what a ray sees may jump; detached. `importance` is that of a crease; zero leaves an edge out."""

    ends: Float[Array, "E 2 3"]
    normals: Float[Array, "E 2 3"]
    interior: Bool[Array, " E"]
    importance: Float[Array, " E"]
    tree: EdgeTree


class DrawnEdges(NamedTuple):
    """For each bundle an edge, its importance, and the sum over all candidates: zero if there is none."""

    edge: Int[Array, " N"]
    importance: Float[Array, " N"]
    total: Float[Array, " N"]


class Hit(NamedTuple):
    """Nearest hit: `face`, -1 on a miss; ray parameter `t`, huge on a miss; barycentric coordinates in the face.

    The coordinates are kept inside the face. On a miss they are those of the middle of a face.
    """

    face: Int[Array, " N"]
    t: Float[Array, " N"]
    barycentric: Float[Array, "N 3"]


class Projections(NamedTuple):
    """Where lines through points cross a shape: `face` (-1: none), and signed `height` over the point.

    The crossings nearest to the point are kept, sorted. `count` counts all, also those beyond the capacity.
    """

    face: Int[Array, "N C"]
    height: Float[Array, "N C"]
    count: Int[Array, " N"]


class Candidates(NamedTuple):
    """Compacted (segment, element) pairs; unused slots have `segment` -1.

    `count` is the number of pairs found. If it exceeds the capacity, the pairs are thinned at random without bias. Then
    `weight` is the inverse of the survival probability, else 1. In two lists that were joined each pair has a weight.
    """

    segment: Int[Array, " C"]
    element: Int[Array, " C"]
    count: Int[Array, ""]
    weight: Float[Array, "*n"]


class SectorCrossings(NamedTuple):
    """Compacted (chord, edge) pairs with the fraction `along` the edge; unused slots have `chord` -1.

    `weight` is as in `Candidates`. `counts`: all crossings found; chords with inconsistent layers; chords with too many
    crossings for one walk (`jax`: crossings left out); nodes of the tree visited; rays cast.
    """

    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    counts: Int[Array, "5"]
    weight: Float[Array, ""]


class FaceIntersections(NamedTuple):
    """Compacted pairs of faces that pass through each other, and the `ends` of the segments that they share.

    Unused slots have `first` -1. `count` and `weight` are as in `Candidates`.
    """

    first: Int[Array, " C"]
    second: Int[Array, " C"]
    ends: Float[Array, "C 2 3"]
    count: Int[Array, ""]
    weight: Float[Array, ""]


# Further values of a chord's `group`, beside the groups of faces (0, 1, ...).
NO_GROUP, UNBOUNDED = -1, -2

# Distance at which visibility rays pass an edge, as a share of the largest coordinate: about 100 float32 roundings.
BESIDE = 1.2e-5

# Faces that reach through each other by less, as a share of the largest coordinate, only touch: 8 float32 roundings.
TOUCHING = 1e-6
