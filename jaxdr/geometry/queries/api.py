"""Ray queries: one interface, three implementations (`embree`, `warp`, `jax`), and `auto` for the first available one.

`embree` traces nearest hits and occlusion on the CPU, faster than Warp, which does everything else.

Queries answer discrete questions in float32 (which face, which edge, occluded or not) and have no derivative. Their
inputs are detached here, and the caller evaluates the hit again in JAX. Under `vmap` a batch of rays against one
geometry becomes one larger batch of rays.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name
from jaxtyping import Array, Bool, Int, UInt32

from jaxdr.geometry.bundles import Bundles
from jaxdr.geometry.edge_tree import EdgeTree, build_edge_tree, leaf_edges
from jaxdr.geometry.queries.batches import asked
from jaxdr.geometry.queries.embree import native as embree
from jaxdr.geometry.queries.embree import scene as embree_scene
from jaxdr.geometry.queries.jax import queries as jax_queries
from jaxdr.geometry.queries.records import (
    Candidates,
    ClosestSilhouettes,
    ConeQuery,
    DrawnEdges,
    EdgePoints,
    EdgeSet,
    EdgeTable,
    FaceIntersections,
    Geometry,
    Hit,
    Lines,
    Projections,
    Rays,
    SectorCrossings,
    SectorQuery,
    StripQuery,
)
from jaxdr.process_end import wait_at_exit

IMPLEMENTATIONS = ("embree", "warp", "jax")
CHOICES = ("auto", *IMPLEMENTATIONS)
ANSWER = "answer of a query"  # the name of answers among the values that reverse mode may keep


def _module(implementation: str) -> Any:
    if implementation == "auto":
        implementation = "embree" if embree.available() else "warp"
    if implementation == "jax":
        return jax_queries
    wait_at_exit()
    if implementation == "warp":
        # Imported here, because it fails on GPUs that Warp does not support; they use `jax`.
        from jaxdr.geometry.queries.warp import queries as warp_queries

        return warp_queries
    if implementation == "embree":
        embree_scene.library()  # raises ImportError without the package
        embree.handlers()
        from jaxdr.geometry.queries.embree import queries as embree_queries

        return embree_queries
    raise ValueError(f"unknown query implementation {implementation!r}; expected one of {', '.join(CHOICES)}")


def check_rays(caller: str, rays: str) -> None:
    """Raises ValueError for an unknown implementation of the ray queries."""
    if rays not in CHOICES:
        raise ValueError(f"{caller}: rays must be one of {', '.join(CHOICES)}, got {rays!r}")


def _discrete(records):
    """Detached, float32 (int32) copies of the inputs of a query."""

    def convert(a):
        a = jax.lax.stop_gradient(jnp.asarray(a))
        return a.astype(jnp.float32 if jnp.issubdtype(a.dtype, jnp.floating) else jnp.int32)

    return jax.tree.map(convert, records)


def _asked(query: Callable, fixed: tuple, rows: tuple = (), **options: Any) -> Any:
    """`query(*fixed, *rows, **options)` with detached arrays; see `batches.asked`."""
    answers = asked(partial(query, **options), _discrete(fixed), _discrete(rows))
    return jax.tree.map(lambda answer: checkpoint_name(answer, ANSWER), answers)


def rematerialised(function: Callable) -> Callable:
    """The same function. Reverse mode keeps its arguments and the answers of its queries, and computes the rest again.

    It is for bodies of loops. XLA writes every array that is kept to memory in every iteration, and compiles a kernel
    for each. To repeat the arithmetic is faster.
    """
    return jax.checkpoint(function, prevent_cse=False, policy=jax.checkpoint_policies.save_only_these_names(ANSWER))


def closest_hit(geometry: Geometry, rays: Rays, implementation: str = "auto") -> Hit:
    """The nearest face on each ray; t is in lengths of `direction`."""
    face, t, barycentric = _asked(_module(implementation).closest_hit, (geometry,), (rays,))
    return Hit(face, t.astype(rays.reach.dtype), barycentric.astype(rays.reach.dtype))


def occluded(geometry: Geometry, rays: Rays, implementation: str = "auto") -> Bool[Array, " N"]:
    """Whether any face lies on each ray; a ray of zero `reach` is free."""
    return _asked(_module(implementation).occluded, (geometry,), (rays,))


def projections(
    geometry: Geometry, face_shape: Int[Array, " F"], lines: Lines, capacity: int, implementation: str = "auto"
) -> Projections:
    """All projections of points onto the faces of a shape, by its number in `face_shape`.

    The nearest `capacity` projections are returned. If there are more, a warning says so, except with `jax`.
    """
    query = _module(implementation).projections
    return Projections(*_asked(query, (geometry, face_shape), (lines,), capacity=capacity))


def face_intersections(
    geometry: Geometry,
    moving: Bool[Array, " F"],
    seed: Int[Array, ""],
    capacity: int,
    indirect: bool = False,
    implementation: str = "auto",
) -> FaceIntersections:
    """Where faces pass through each other: pairs of which at least one is `moving`, each pair once.

    Faces that share a vertex don't count, and neither do faces that only touch (`records.TOUCHING`). If there are pairs
    and light is `indirect`, a warning says what the derivative lacks, except with `jax`.
    """
    query = _module(implementation).face_intersections
    options = {"capacity": capacity, "indirect": indirect}
    first, second, start, end, count, weight = _asked(query, (geometry, moving, seed), **options)
    dtype = geometry.vertices.dtype
    return FaceIntersections(first, second, jnp.stack([start, end], 1).astype(dtype), count, weight.astype(dtype))


def edge_tree(
    geometry: Geometry, edges: EdgeSet, counts: Sequence[int] | None = None, implementation: str = "auto"
) -> EdgeTree:
    """The tree over edges for the current vertices, as described in `build_edge_tree`, the plain implementation."""
    vertices = geometry.vertices
    if implementation == "jax":
        return build_edge_tree(vertices, edges.ends, edges.opposite, edges.interior, edges.rank, counts)
    slots = leaf_edges(counts or [edges.ends.shape[0]])
    node = _asked(_module(implementation).edge_tree, (geometry, edges), slots=slots)
    return EdgeTree(jnp.asarray(slots), node.astype(vertices.dtype))


def edge_candidates(
    geometry: Geometry,
    edges: EdgeSet,
    strips: StripQuery,
    seed: Int[Array, ""],
    capacity: int,
    both_sides: bool = False,
    implementation: str = "auto",
) -> Candidates:
    """Silhouette edges, seen from `apex`, whose projection onto the plane (target, normal) passes near `target`.

    An edge counts for a segment if all of these hold:

    - All its faces lie on one side of the plane through apex and edge, and the target on the other (or anywhere, with
      `both_sides`).
    - It lies between the apex and the target's plane.
    - The foot of the perpendicular from the target onto its projection is on the projection, less than the kernel
      radius away; see `StripQuery`. The `rank` of an edge is its radius.
    """
    query = _module(implementation).edge_candidates
    options = {"capacity": capacity, "both_sides": both_sides}
    return Candidates(*_asked(query, (geometry, edges, strips, seed), **options))


def point_candidates(
    geometry: Geometry,
    edges: EdgeSet,
    points: EdgePoints,
    strips: StripQuery,
    seed: Int[Array, ""],
    capacity: int,
    both_sides: bool = False,
    implementation: str = "auto",
) -> Candidates:
    """Points on silhouette edges whose projection from `apex` onto the plane (target, normal) is near `target`.

    Like `edge_candidates`, with a disc around the projected point instead of a strip along the projected edge.
    """
    query = _module(implementation).point_candidates
    options = {"capacity": capacity, "both_sides": both_sides}
    return Candidates(*_asked(query, (geometry, edges, points, strips, seed), **options))


def draw_edges(
    table: EdgeTable, bundles: Bundles, seed: UInt32[Array, " N"], reach: float, implementation: str = "auto"
) -> DrawnEdges:
    """For each bundle one of the edges that it may cross within `reach`, drawn in proportion to their importance.

    The importance is 1 for silhouettes, and that of the table for other edges. Candidates go through a reservoir (Chao
    1982) whose random numbers come from `seed`, so there is no list that could overflow.
    """
    query = _module(implementation).draw_edges
    edge, *rest = _asked(query, (table,), (bundles, seed), reach=reach)
    return DrawnEdges(edge, *(x.astype(bundles.end.dtype) for x in rest))


def closest_silhouettes(
    geometry: Geometry, edges: EdgeSet, cones: ConeQuery, implementation: str = "auto"
) -> ClosestSilhouettes:
    """For each cone the silhouette edge, seen from its apex, nearest to its axis in angle, hidden or not.

    An edge is a silhouette if all its faces lie on one side of the plane through apex and edge. Faces that contain the
    apex, up to rounding, are on neither side. An edge of rank zero is left out. Ties may go to any edge.
    """
    query = _module(implementation).closest_silhouettes
    edge, along = _asked(query, (geometry, edges), (cones,))
    return ClosestSilhouettes(edge, along.astype(cones.reach.dtype))


def silhouettes(
    geometry: Geometry,
    edges: EdgeSet,
    cones: ConeQuery,
    seed: Int[Array, ""],
    capacity: int,
    implementation: str = "auto",
) -> Candidates:
    """All silhouette edges, seen from the apex of each cone, of which some part is in the cone, hidden or not.

    Silhouettes are as in `closest_silhouettes`. A cone with a reach of pi has all directions.
    """
    query = _module(implementation).silhouettes
    return Candidates(*_asked(query, (geometry, edges, cones, seed), capacity=capacity))


def sector_crossings(
    geometry: Geometry,
    edges: EdgeSet,
    face_group: Int[Array, " F"],
    sectors: SectorQuery,
    seed: Int[Array, ""],
    least_layer: int,
    capacity: int,
    implementation: str = "auto",
) -> SectorCrossings:
    """Where silhouettes, seen from `apex`, cross chords from `first` to `last` and bound what is visible of them.

    All edges that cut the planar sector (apex, chord) are found. Quantitative invisibility (Appel 1967) counts the
    layers of surface in front of the chord, in both directions from its point at the fraction `centre`, which should be
    random. A crossing counts if the number of layers changes between zero and more. Surfaces may be open or closed,
    nested or interpenetrating, and several may meet at an edge: they hide the union of their shadows on the chord. Only
    the faces of the chord's `group` may pierce the chord. If other faces do, this is no edge, so its crossing is
    missing, and crossings between it and the centre may be wrong.

    - `rank` of an edge: 0 leaves it out; up to `least_layer` it only hides other edges; above that it counts. If
      `needed` of a chord is larger than `least_layer`, edges of lower rank are not looked at, and a ray past each edge
      decides.
    - `group` of a chord: the number in `face_group` of its plane, whose faces hide nothing; `NO_GROUP` for none;
      `UNBOUNDED` if the sector goes on beyond the chord. Then all visible silhouettes in it count, and rays that stop
      short of the edge find hidden ones.

    The tree of `edges` is `edge_tree` of the same vertices and edges, with `rank` as radius. Rounding may make counts
    inconsistent; then rays past each edge decide.
    """
    query = _module(implementation).sector_crossings
    fixed = geometry, edges, face_group, sectors, seed
    return SectorCrossings(*_asked(query, fixed, least_layer=least_layer, capacity=capacity))
