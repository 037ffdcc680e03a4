"""Ray queries by Warp, on CPU (batches sliced over threads) and CUDA, called from JAX through `warp.jax_callable`.

The functions receive the geometry with every call, and look up its BVH by content (see `bvh_cache`). So a query is a
pure function of its arguments. The functions do host work, so they run outside CUDA graphs.
"""

import contextlib
import warnings

import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdr.geometry.edge_tree import LEAF
from jaxdr.geometry.queries.bvh_cache import HostArrays
from jaxdr.geometry.queries.warp import (
    bundle_kernels,
    cone_kernels,
    intersection_kernels,
    kernels,
    records,
    sector_kernels,
    tree_kernels,
)
from jaxdr.geometry.queries.warp.device_arrays import number_above
from jaxdr.geometry.queries.warp.launch import compact, launch
from jaxdr.geometry.queries.warp.records import Call, Numbers
from jaxdr.geometry.queries.warp.structures import structure_cache

WHOLE, REAL = wp.array(dtype=int), wp.array(dtype=float)
WHOLE_ROWS, REAL_ROWS = wp.array2d(dtype=int), wp.array2d(dtype=float)


@contextlib.contextmanager
def kept_structure(kind: str, device, moving: list, topology: list):
    """A structure over arrays. Inside the context no other code changes it."""
    cache = structure_cache(kind, device)
    if isinstance(cache.arrays, HostArrays):
        moving, topology = [a.numpy() for a in moving], [a.numpy() for a in topology]
    with cache.lock:
        yield cache.find(moving, topology)


@contextlib.contextmanager
def structure(kind: str, device, moving: list, topology: list):
    """The id of a structure over arrays. Inside the context no other code changes the structure."""
    with kept_structure(kind, device, moving, topology) as kept:
        yield kept.id


def _trace(kernel, geometry, rays, outputs: list) -> None:
    device = geometry.vertices.device
    with structure("mesh", device, [geometry.vertices], [geometry.faces]) as mesh:
        launch(kernel, rays.reach.shape[0], [mesh], [rays, *outputs], device)


def _closest_hit(geometry, rays, face, t, barycentric):
    _trace(kernels.closest_hit, geometry, rays, [face, t, barycentric])


def _occluded(geometry, rays, result):
    _trace(kernels.occluded, geometry, rays, [result])


_RAYS = [records.Geometry, records.Rays]
_closest_hit_call = Call(_closest_hit, _RAYS, [WHOLE, REAL, wp.array(dtype=wp.vec3)], kernels)
_occluded_call = Call(_occluded, _RAYS, [WHOLE], kernels)


def closest_hit(geometry, rays):
    """(face, t, barycentric): the nearest face in front of each ray, -1 and a huge t on a miss."""
    n = rays.reach.shape[0]
    return _closest_hit_call(geometry, rays, dims=[n, n, n])


def occluded(geometry, rays):
    """Whether anything lies on the ray before its reach."""
    (result,) = _occluded_call(geometry, rays, dims=[rays.reach.shape[0]])
    return result != 0


def _projections(geometry, face_shape, lines, face, height, count):
    face.fill_(-1)
    height.fill_(kernels.MISS)
    device, lines_there = geometry.vertices.device, lines.depth.shape[0]
    with structure("faces", device, [geometry.vertices], [geometry.faces]) as bvh:
        launch(kernels.projections, lines_there, [bvh], [geometry, face_shape, lines, face, height, count], device)
    over = number_above(count, face.shape[1])
    if over:
        warnings.warn(
            f"jaxdr: {over} of {lines_there} auxiliary points have more projections onto their shape than the "
            f"{face.shape[1]} that fit; the furthest were left out. More room avoids it.",
            stacklevel=2,
        )


_projections_call = Call(
    _projections, [records.Geometry, Numbers, records.Lines], [WHOLE_ROWS, REAL_ROWS, WHOLE], kernels
)


def projections(geometry, face_shape, lines, capacity):
    """(face [N, C], height [N, C], count [N]): see `queries.projections`."""
    n = lines.depth.shape[0]
    return _projections_call(geometry, face_shape, lines, dims=[(n, capacity), (n, capacity), n])


def _edge_tree(slots, geometry, edges, table, scratch):
    device, count = table.device, table.shape[0]
    nodes = wp.array(ptr=scratch.ptr, dtype=tree_kernels.Node, shape=count, device=device)
    first = count // 2
    table.zero_()  # row 0 is not a node
    launch(tree_kernels.tree_leaves, first, [], [slots, geometry, edges, nodes, table], device)
    while first > 1:
        first //= 2
        launch(tree_kernels.tree_parents, first, [], [first, nodes, table], device)


# JAX also allocates the scratch memory for nodes, so it stays until kernels on JAX's stream have finished.
_edge_tree_call = Call(
    _edge_tree, [Numbers, records.Geometry, records.EdgeSet], [wp.array2d(dtype=wp.vec4), REAL_ROWS], tree_kernels
)


def edge_tree(geometry, edges, slots):
    """Nodes of the tree over edges, [n, 3, 4]; see `edge_tree.build_edge_tree`."""
    count = 2 * len(slots) // LEAF
    table, _ = _edge_tree_call(jnp.asarray(slots), geometry, edges, dims=[(count, 3), (count, tree_kernels.NODE_WORDS)])
    return table


def _counted(found, inverse, counts, weight) -> None:
    counts.assign(found.astype(np.int32))
    weight.assign(np.array([inverse], np.float32))


def _edge_candidates(geometry, edges, tree, strips, options, segment, element, count, weight):
    rest, lists = [geometry, edges, tree, strips, options], [segment, element]
    device = segment.device
    found, inverse = compact(kernels.edge_candidates, [], rest, strips.scale.shape[0], lists, 2, device)
    _counted(found[1:2], inverse, count, weight)


def _point_candidates(geometry, edges, points, strips, options, segment, element, count, weight):
    rest, lists = [geometry, edges, points, strips, options], [segment, element]
    device = segment.device
    with structure("points", device, [points.position, points.radius], []) as bvh:
        found, inverse = compact(kernels.point_candidates, [bvh], rest, strips.scale.shape[0], lists, 2, device)
    _counted(found[1:2], inverse, count, weight)


def _sector_crossings(geometry, edges, tree, face_group, sectors, options, segment, element, along, counts, weight):
    rest, lists = [geometry, edges, tree, face_group, sectors, options], [segment, element, along]
    device, total = segment.device, sectors.needed.shape[0]
    with structure("faces", device, [geometry.vertices], [geometry.faces]) as bvh:
        found, inverse = compact(sector_kernels.sector_crossings, [bvh], rest, total, lists, 6, device)
    if found[2] > 1e-3 * found[5]:
        warnings.warn(
            f"jaxdr: in front of some of {total} chords surfaces could not be counted (something pierces an emitter, "
            "or rounding); there rays past each edge decided",
            stacklevel=2,
        )
    _counted(found[1:], inverse, counts, weight)


_over_edges = [records.Geometry, records.EdgeSet]
_pairs = [WHOLE, WHOLE, WHOLE, REAL]
_edge_candidates_call = Call(
    _edge_candidates, [*_over_edges, records.EdgeTree, records.StripQuery, Numbers], _pairs, kernels
)
_point_candidates_call = Call(
    _point_candidates, [*_over_edges, records.EdgePoints, records.StripQuery, Numbers], _pairs, kernels
)
_sector_crossings_call = Call(
    _sector_crossings,
    [*_over_edges, records.EdgeTree, Numbers, records.SectorQuery, Numbers],
    [WHOLE, WHOLE, REAL, WHOLE, REAL],
    sector_kernels,
)


def edge_candidates(geometry, edges, strips, seed, capacity, both_sides):
    """(segment [C], edge [C], count, weight): silhouette edges near segments; see `queries.edge_candidates`."""
    options, dims = jnp.stack([seed, jnp.int32(both_sides)]), [capacity, capacity, 1, 1]
    *lists, count, weight = _edge_candidates_call(geometry, edges, edges.tree, strips, options, dims=dims)
    return *lists, count[0], weight[0]


def point_candidates(geometry, edges, points, strips, seed, capacity, both_sides):
    """(segment [C], point [C], count, weight): points on silhouette edges near segments."""
    options, dims = jnp.stack([seed, jnp.int32(both_sides)]), [capacity, capacity, 1, 1]
    *lists, count, weight = _point_candidates_call(geometry, edges, points, strips, options, dims=dims)
    return *lists, count[0], weight[0]


def _draw_edges(table, tree, bundles, seed, reach, edge, importance, total):
    rest = [table, tree, bundles, seed, reach, edge, importance, total]
    launch(bundle_kernels.draw_edges, bundles.end.shape[0], [], rest, edge.device)


_draw_edges_call = Call(
    _draw_edges,
    [records.EdgeTable, records.EdgeTree, records.Bundles, Numbers, REAL],
    [WHOLE, REAL, REAL],
    bundle_kernels,
)


def draw_edges(table, bundles, seed, reach):
    """(edge, importance, total) for each bundle: see `queries.draw_edges`."""
    n = bundles.end.shape[0]
    return _draw_edges_call(table, table.tree, bundles, seed, jnp.full(1, reach, jnp.float32), dims=[n, n, n])


INTERSECTIONS = (
    "more than {capacity} pairs of faces pass through each other. They were thinned without bias. Meshes that pass "
    "through themselves or each other in fewer places avoid it."
)


INDIRECT = (
    "surfaces pass through each other. With indirect light (max_depth of 3 or more) derivatives by motions of one "
    "relative to the other are very noisy there, and miss a part. max_depth=2 has no such trouble"
)


def _face_intersections(geometry, moving, options, first, second, start, end, count, weight):
    lists, device = [first, second, start, end], first.device
    rest, total = [geometry, moving, options], geometry.faces.shape[0]
    question = moving.numpy().tobytes(), first.shape[0]
    kernel = intersection_kernels.face_intersections
    with kept_structure("faces", device, [geometry.vertices], [geometry.faces]) as faces:
        if question in faces.answers:
            rows, found = faces.answers[question]
            inverse = 1.0
            for table, row in zip(lists, rows, strict=True):
                table.assign(row)
        else:
            found, inverse = compact(kernel, [faces.id], rest, total, lists, 2, device, INTERSECTIONS)
            if inverse == 1.0:  # all pairs: no random numbers are in the answer
                faces.answers[question] = [table.numpy().copy() for table in lists], found
    if found[1] > 0 and options.numpy()[1]:
        warnings.warn(f"jaxdr: {INDIRECT}", stacklevel=2)
    _counted(found[1:2], inverse, count, weight)


_POINTS = wp.array(dtype=wp.vec3)
_face_intersections_call = Call(
    _face_intersections,
    [records.Geometry, Numbers, Numbers],
    [WHOLE, WHOLE, _POINTS, _POINTS, WHOLE, REAL],
    intersection_kernels,
)


def face_intersections(geometry, moving, seed, capacity, indirect):
    """(first [C], second [C], start [C, 3], end [C, 3], count, weight): see `queries.face_intersections`."""
    dims = [capacity, capacity, capacity, capacity, 1, 1]
    options = jnp.stack([seed, jnp.int32(indirect)])
    *lists, count, weight = _face_intersections_call(geometry, moving, options, dims=dims)
    return *lists, count[0], weight[0]


def _closest_silhouettes(geometry, edges, tree, cones, edge, along):
    rest = [geometry, edges, tree, cones, edge, along]
    launch(cone_kernels.closest_silhouettes, cones.reach.shape[0], [], rest, edge.device)


_closest_silhouettes_call = Call(
    _closest_silhouettes, [*_over_edges, records.EdgeTree, records.ConeQuery], [WHOLE, REAL], cone_kernels
)


def closest_silhouettes(geometry, edges, cones):
    """(edge [N], along [N]): see `queries.closest_silhouettes`."""
    n = cones.reach.shape[0]
    return _closest_silhouettes_call(geometry, edges, edges.tree, cones, dims=[n, n])


def _silhouettes(geometry, edges, tree, cones, options, cone, edge, count, weight):
    rest, lists = [geometry, edges, tree, cones, options], [cone, edge]
    found, inverse = compact(cone_kernels.silhouettes, [], rest, cones.reach.shape[0], lists, 2, cone.device)
    _counted(found[1:2], inverse, count, weight)


_silhouettes_call = Call(
    _silhouettes, [*_over_edges, records.EdgeTree, records.ConeQuery, Numbers], _pairs, cone_kernels
)


def silhouettes(geometry, edges, cones, seed, capacity):
    """(cone [C], edge [C], count, weight): see `queries.silhouettes`."""
    dims = [capacity, capacity, 1, 1]
    *lists, count, weight = _silhouettes_call(geometry, edges, edges.tree, cones, seed[None], dims=dims)
    return *lists, count[0], weight[0]


def sector_crossings(geometry, edges, face_group, sectors, seed, least_layer, capacity):
    """(segment [C], edge [C], along [C], counts [5], weight): see `queries.sector_crossings`."""
    options, dims = jnp.stack([seed, jnp.int32(least_layer)]), [capacity, capacity, capacity, 5, 1]
    call = _sector_crossings_call
    *lists, counts, weight = call(geometry, edges, edges.tree, face_group, sectors, options, dims=dims)
    return *lists, counts, weight[0]
