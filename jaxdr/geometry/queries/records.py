"""What ray queries are asked and what they answer, as records of arrays; `api` says what each query does with them.

N rows of rays, segments or sectors; V vertices, F faces, E edges with up to K faces each.
"""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.edge_tree import EdgeTree


class Geometry(NamedTuple):
    """The triangles that all queries are about."""

    vertices: Float[Array, "V 3"]
    faces: Int[Array, "F 3"]


class Rays(NamedTuple):
    """Rays `origin + t direction`, 0 < t < `reach`; none where that is not positive."""

    origin: Float[Array, "N 3"]
    direction: Float[Array, "N 3"]
    reach: Float[Array, " N"]


class Lines(NamedTuple):
    """Lines through points along unit normals, no further than `depth` to both sides, and the `shape` that they cross.

    A depth of zero leaves a point out.
    """

    point: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    depth: Float[Array, " N"]
    shape: Int[Array, " N"]


class EdgeSet(NamedTuple):
    """Edges by the numbers of their ends, faces and third corners of these (`opposite`), both -1 padded.

    `interior` edges have two faces that agree about the orientation; only where all their faces face alike are they
    skipped. `rank` is how much an edge counts, 0 for not at all: its kernel radius, or what the query says. `tree` is
    `queries.edge_tree` of the same.
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
    """Segments from `apex` to `target`, in the plane of unit `normal`, and how wide their kernels are.

    That is r = radius * `scale` (scene units) at an edge, magnified by the projection but to no more than `widest` (to
    none where that is zero). A scale of zero leaves a segment out.
    """

    apex: Float[Array, "N 3"]
    target: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    scale: Float[Array, " N"]
    widest: Float[Array, " N"]


class SectorQuery(NamedTuple):
    """Planar sectors between an `apex` and a chord from `first` to `last`.

    `centre`: the share of the chord from where layers are counted. `needed`: the rank from which on edges count, 0 to
    leave a chord out. `group`: that of the faces that hide nothing, or `NO_GROUP`, `UNBOUNDED`.
    """

    apex: Float[Array, "N 3"]
    first: Float[Array, "N 3"]
    last: Float[Array, "N 3"]
    centre: Float[Array, " N"]
    needed: Float[Array, " N"]
    group: Int[Array, " N"]


class Hit(NamedTuple):
    """Nearest crossing: `face`, -1 for a miss; ray parameter `t`, huge for a miss; barycentric coordinates in the face.

    The coordinates are kept inside of the face; for a miss they are those of the middle of a face.
    """

    face: Int[Array, " N"]
    t: Float[Array, " N"]
    barycentric: Float[Array, "N 3"]


class Projections(NamedTuple):
    """Where lines through points cross a shape: `face`, -1 for none, and signed `height` over the point.

    The nearest to the point, sorted; `count` counts all of them, also those beyond the capacity.
    """

    face: Int[Array, "N C"]
    height: Float[Array, "N C"]
    count: Int[Array, " N"]


class Candidates(NamedTuple):
    """Compacted (segment, element) pairs; unused slots have `segment` -1.

    `count` is the number of pairs found. When it exceeds the capacity the pairs are thinned at random without bias and
    `weight` is the inverse of the survival probability, else 1; of two lists that were joined each pair has its own.
    """

    segment: Int[Array, " C"]
    element: Int[Array, " C"]
    count: Int[Array, ""]
    weight: Float[Array, "*n"]


class SectorCrossings(NamedTuple):
    """Compacted (chord, edge) pairs with the fraction of the way `along` the edge; unused slots have `chord` -1.

    `weight` as in `Candidates`. `counts`: all crossings found, chords whose layers could not be counted consistently,
    chords of too many crossings (`jax`: crossings left out), nodes of the tree visited, rays cast.
    """

    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    counts: Int[Array, "5"]
    weight: Float[Array, ""]


# Groups of faces that a chord looks past, beside those of faces (0, 1, ...).
NO_GROUP, UNBOUNDED = -1, -2

# How far beside an edge visibility rays pass, as a share of the largest coordinate: some 100 float32 roundings.
BESIDE = 1.2e-5
