"""Ray queries: one interface, three implementations (`embree`, `warp`, `jax`), and `auto` for the first there is.

`embree` traces nearest hits and occlusion on the CPU, two to three times as fast as Warp, which does everything else.

Queries answer discrete questions in float32 (which face, which edge, occluded or not) and have no derivative: their
inputs are detached here, and the caller re-evaluates the hit in JAX. Under `vmap` a batch of rays against one geometry
becomes one larger batch of rays.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry import embree_scene, jax_queries, jax_sector
from jaxdr.geometry.edge_tree import EdgeTree, build_edge_tree, leaf_edges

IMPLEMENTATIONS = ("embree", "warp", "jax")
CHOICES = ("auto", *IMPLEMENTATIONS)


class Hit(NamedTuple):
    """Nearest crossing: `face` [N] (-1 for a miss) and ray parameter `t` [N] (meaningless for a miss)."""

    face: Int[Array, " N"]
    t: Float[Array, " N"]


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


class Crossings(NamedTuple):
    """Compacted (chord, edge) pairs with the fraction of the way `along` the edge; unused slots have `chord` -1.

    `weight` as in `Candidates`. `counts`: all crossings found, chords whose layers could not be counted consistently,
    chords of too many crossings (`jax`: crossings left out), nodes of the tree visited, rays cast.
    """

    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    counts: Int[Array, "5"]
    weight: Float[Array, ""]


def _module(implementation: str) -> Any:
    if implementation == "auto":
        implementation = "embree" if embree_scene.available() else "warp"
    if implementation == "jax":
        return jax_queries
    if implementation == "warp":
        from jaxdr.geometry import warp_queries  # imported on use: a GPU that Warp does not know needs only `jax`

        return warp_queries
    if implementation == "embree":
        embree_scene.library()  # here, where an error reaches the caller
        from jaxdr.geometry import embree_queries

        return embree_queries
    raise ValueError(f"unknown query implementation {implementation!r}; expected one of {', '.join(CHOICES)}")


def _discrete(*arrays):
    """Detached, float32 (int32) copies of the inputs of a query."""

    def convert(a):
        a = jax.lax.stop_gradient(jnp.asarray(a))
        return a.astype(jnp.float32 if jnp.issubdtype(a.dtype, jnp.floating) else jnp.int32)

    return tuple(convert(a) for a in arrays)


def _over_rays(query: Callable, geometry_count: int) -> Callable:
    """`query(*geometry, *rays)` whose batches over rays are flattened into one call; other batches run one by one."""

    @custom_vmap
    def call(*args):
        return query(*args)

    @call.def_vmap
    def batched(size, is_batched, *args):
        geometry, rays = args[:geometry_count], args[geometry_count:]
        if any(is_batched[:geometry_count]):
            return _one_by_one(call, size, is_batched, args)
        rays = [
            r if b else jnp.broadcast_to(r, (size, *r.shape))
            for r, b in zip(rays, is_batched[geometry_count:], strict=True)
        ]
        flat = [r.reshape(-1, *r.shape[2:]) for r in rays]
        results = call(*geometry, *flat)
        results = jax.tree.map(lambda r: r.reshape(size, -1, *r.shape[1:]), results)
        return results, jax.tree.map(lambda _: True, results)

    return call


def _sequential(query: Callable) -> Callable:
    """`query` that runs one by one under `vmap`."""

    @custom_vmap
    def call(*args):
        return query(*args)

    @call.def_vmap
    def batched(size, is_batched, *args):
        return _one_by_one(call, size, is_batched, args)

    return call


def _one_by_one(call, size, is_batched, args):
    def one(i):
        return call(*(a[i] if b else a for a, b in zip(args, is_batched, strict=True)))

    results = jax.lax.map(one, jnp.arange(size))
    return results, jax.tree.map(lambda _: True, results)


def closest_hit(
    vertices: Float[Array, "V 3"],
    faces: Int[Array, "F 3"],
    origin: Float[Array, "N 3"],
    direction: Float[Array, "N 3"],
    t_max: Float[Array, " N"],
    implementation: str = "auto",
) -> Hit:
    """The nearest face on each ray `origin + t direction`, 0 < t < `t_max`; t counts in lengths of `direction`."""
    query = _over_rays(_module(implementation).closest_hit, 2)
    return Hit(*query(*_discrete(vertices, faces, origin, direction, t_max)))


def occluded(
    vertices: Float[Array, "V 3"],
    faces: Int[Array, "F 3"],
    origin: Float[Array, "N 3"],
    direction: Float[Array, "N 3"],
    t_max: Float[Array, " N"],
    implementation: str = "auto",
) -> Bool[Array, " N"]:
    """Whether any face lies on each ray before `t_max`; a ray with `t_max` <= 0 is free."""
    query = _over_rays(_module(implementation).occluded, 2)
    return query(*_discrete(vertices, faces, origin, direction, t_max))


def projections(
    vertices: Float[Array, "V 3"],
    faces: Int[Array, "F 3"],
    face_shape: Int[Array, " F"],
    point: Float[Array, "N 3"],
    normal: Float[Array, "N 3"],
    depth: Float[Array, " N"],
    shape: Int[Array, " N"],
    capacity: int,
    implementation: str = "auto",
) -> Projections:
    """All projections of points onto the faces of a shape along unit normals, no further away than `depth`.

    The nearest `capacity` of them and how many there are; but with `jax` a warning tells where there are more. `shape`
    is the number in `face_shape`; a depth of zero leaves a point out.
    """
    module = _module(implementation)
    query = _over_rays(lambda *args: tuple(module.projections(*args, capacity)), 3)
    return Projections(*query(*_discrete(vertices, faces, face_shape, point, normal, depth, shape)))


def edge_candidates(
    tree: EdgeTree,
    vertices: Float[Array, "V 3"],
    edges: Int[Array, "E 2"],
    opposite: Int[Array, "E K"],
    radius: Float[Array, " E"],
    apex: Float[Array, "N 3"],
    target: Float[Array, "N 3"],
    normal: Float[Array, "N 3"],
    scale: Float[Array, " N"],
    widest: Float[Array, " N"],
    seed: Int[Array, ""],
    capacity: int,
    both_sides: bool = False,
    implementation: str = "auto",
) -> Candidates:
    """Silhouette edges, seen from `apex`, whose projection onto the plane (target, normal) passes near `target`.

    An edge counts for a segment when all its faces (their vertices `opposite`, -1 padded) lie on one side of the plane
    through apex and edge and the target on the other (or anywhere, with `both_sides`), it lies between the apex and the
    target's plane, and the foot of the perpendicular from the target onto its projection is on the projection, less
    than the kernel radius away.
    That is r = `radius[edge] * scale[segment]` (scene units) at the edge, magnified by the projection but to no more
    than `widest[segment]` (to none where that is zero). A radius or scale of zero leaves an edge or a segment out.
    `tree` is `edge_tree` of the same vertices, edges and radii.
    """
    query = _sequential(lambda *args: _edge_query(implementation, args, capacity, both_sides))
    arrays = (*tree, vertices, edges, opposite, radius, apex, target, normal, scale, widest, seed)
    return Candidates(*query(*_discrete(*arrays)))


def _edge_query(implementation, args, capacity, both_sides):
    module, nodes = _module(implementation), len(EdgeTree._fields)
    tree, rest = EdgeTree(*args[:nodes]), args[nodes:]
    if implementation == "jax":  # every edge is tried: no tree
        return tuple(module.edge_candidates(*rest, capacity, both_sides))
    return tuple(module.edge_candidates(tree, *rest, capacity, both_sides))


def edge_tree(
    vertices: Float[Array, "V 3"],
    edges: Int[Array, "E 2"],
    opposite: Int[Array, "E K"],
    interior: Bool[Array, " E"],
    radius: Float[Array, " E"],
    counts: Sequence[int] | None = None,
    implementation: str = "auto",
) -> EdgeTree:
    """The tree over edges for the present vertices, as `build_edge_tree` (the plain implementation) describes it."""
    if implementation == "jax":
        return build_edge_tree(vertices, edges, opposite, interior, radius, counts)
    slots = leaf_edges(counts or [edges.shape[0]])
    module = _module(implementation)
    query = _sequential(lambda *args: (module.edge_tree(*args, slots),))
    (node,) = query(*_discrete(vertices, edges, opposite, interior, radius))
    return EdgeTree(jnp.asarray(slots), node.astype(vertices.dtype))


def point_candidates(
    vertices: Float[Array, "V 3"],
    edges: Int[Array, "E 2"],
    opposite: Int[Array, "E K"],
    point: Float[Array, "M 3"],
    point_edge: Int[Array, " M"],
    radius: Float[Array, " M"],
    apex: Float[Array, "N 3"],
    target: Float[Array, "N 3"],
    normal: Float[Array, "N 3"],
    scale: Float[Array, " N"],
    widest: Float[Array, " N"],
    seed: Int[Array, ""],
    capacity: int,
    both_sides: bool = False,
    implementation: str = "auto",
) -> Candidates:
    """Points on silhouette edges whose projection from `apex` onto the plane (target, normal) is near `target`.

    As `edge_candidates`, with a disc around the projected point in place of a strip along the projected edge.
    """
    module = _module(implementation)
    query = _sequential(lambda *args: tuple(module.point_candidates(*args, capacity, both_sides)))
    return Candidates(
        *query(
            *_discrete(vertices, edges, opposite, point, point_edge, radius, apex, target, normal, scale, widest, seed)
        )
    )


# Groups of faces that a chord looks past, beside those of `face_group` (0, 1, ...).
NO_GROUP, UNBOUNDED = -1, -2


def sector_crossings(
    tree: EdgeTree,
    vertices: Float[Array, "V 3"],
    faces: Int[Array, "F 3"],
    edges: Int[Array, "E 2"],
    edge_faces: Int[Array, "E K"],
    rank: Float[Array, " E"],
    face_group: Int[Array, " F"],
    apex: Float[Array, "N 3"],
    first: Float[Array, "N 3"],
    last: Float[Array, "N 3"],
    centre: Float[Array, " N"],
    needed: Float[Array, " N"],
    group: Int[Array, " N"],
    seed: Int[Array, ""],
    least_layer: int,
    capacity: int,
    implementation: str = "auto",
) -> Crossings:
    """Where silhouettes, seen from `apex`, cross chords from `first` to `last` and bound what is visible of them.

    All edges that cut the planar sector (apex, chord) are found; with quantitative invisibility (Appel 1967) the layers
    of surface in front of the chord are counted from its point at the share `centre`, which should be a random one, in
    both directions; a crossing counts where the number of layers changes between zero and more. For that surfaces may
    be open or closed, several at an edge, nested or interpenetrating: what they hide of a chord is the union of their
    shadows. Nothing but the faces of its `group` may pierce the chord itself; if something does, that is no edge and
    missing, and crossings between it and the centre may be judged wrongly.

    - `rank` of an edge: 0 for edges that are left out, up to `least_layer` for those that only hide others, above
      for those that count. `needed` of a chord: the rank from which on edges count for it, 0 to leave it out. Where
      `needed` is larger than `least_layer` lower edges are not even looked at, and a ray past each edge decides.
    - `group` of a chord: the number in `face_group` of the plane that it lies in, whose faces hide nothing; `NO_GROUP`
      for none; `UNBOUNDED` where the sector goes on beyond the chord: then all visible silhouettes in it count, hidden
      ones being told by rays that stop short of the edge.

    `tree` is `edge_tree` of the same vertices and edges with `rank` for its radii. Inconsistent counts, which rounding
    may cause, are resolved by rays past each edge.
    """
    query = _sequential(lambda *args: _sector_query(implementation, args, least_layer, capacity))
    arrays = (*tree, vertices, faces, edges, edge_faces, rank, face_group, apex, first, last, centre, needed, group)
    return Crossings(*query(*_discrete(*arrays, seed)))


def _sector_query(implementation, args, least_layer, capacity):
    nodes = len(EdgeTree._fields)
    tree, rest = EdgeTree(*args[:nodes]), args[nodes:]
    if implementation == "jax":
        return tuple(jax_sector.sector_crossings(*rest, least_layer=least_layer, capacity=capacity))
    return tuple(_module(implementation).sector_crossings(tree, *rest, least_layer, capacity))
