"""Ray queries by Warp, on CPU (batches sliced over threads) and CUDA, called from JAX through `warp.jax_callable`.

The callables below receive the geometry with every call and look its BVH up by content (see `bvh_cache`), so a
query is a pure function of its arguments. They do host work and therefore run outside CUDA graphs.
"""

import warnings
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import warp as wp

from jaxdr.geometry import warp_kernels as kernels
from jaxdr.geometry import warp_sector_kernels as sector_kernels
from jaxdr.geometry import warp_tree_kernels as tree_kernels
from jaxdr.geometry.edge_tree import LEAF
from jaxdr.geometry.warp_launch import Call, compact, launch, on_host
from jaxdr.geometry.warp_projections import projections  # noqa: F401
from jaxdr.geometry.warp_structures import structure_cache


def hit_queries(trace, module) -> tuple[Callable, Callable]:
    """`closest_hit` and `occluded`, by `trace(kernel, vertices, faces, arrays)` for the kernels of those names."""

    def _closest_hit(
        vertices: wp.array(dtype=wp.vec3),
        faces: wp.array(dtype=wp.vec3i),
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
        face: wp.array(dtype=int),
        t: wp.array(dtype=float),
    ):
        trace("closest_hit", vertices, faces, [origin, direction, t_max, face, t])

    def _occluded(
        vertices: wp.array(dtype=wp.vec3),
        faces: wp.array(dtype=wp.vec3i),
        origin: wp.array(dtype=wp.vec3),
        direction: wp.array(dtype=wp.vec3),
        t_max: wp.array(dtype=float),
        result: wp.array(dtype=int),
    ):
        trace("occluded", vertices, faces, [origin, direction, t_max, result])

    closest_hit_call, occluded_call = Call(_closest_hit, 2, module), Call(_occluded, 1, module)

    def closest_hit(vertices, faces, origin, direction, t_max):
        """(face, t): the nearest face in front of each ray, -1 and a huge t on a miss."""
        return closest_hit_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])

    def occluded(vertices, faces, origin, direction, t_max):
        """Whether anything lies on the ray before `t_max`."""
        (result,) = occluded_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])
        return result != 0

    return closest_hit, occluded


def trace(kernel: str, vertices: wp.array, faces: wp.array, arrays: list) -> None:
    """Run one of the two kernels over the rays of `arrays`."""
    cache = structure_cache("mesh", vertices.device)
    with cache.lock:
        mesh = cache.find([on_host(vertices)], [on_host(faces)])
        launch(getattr(kernels, kernel), arrays[0].shape[0], [mesh.id], arrays, vertices.device)


closest_hit, occluded = hit_queries(trace, kernels)


def _edge_candidates(
    leaf_edge: wp.array(dtype=int),
    table: wp.array2d(dtype=wp.vec4),
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array2d(dtype=int),
    radius: wp.array(dtype=float),
    apex: wp.array(dtype=wp.vec3),
    target: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    scale: wp.array(dtype=float),
    widest: wp.array(dtype=float),
    options: wp.array(dtype=int),
    segment: wp.array(dtype=int),
    edge: wp.array(dtype=int),
    count: wp.array(dtype=int),
    weight: wp.array(dtype=float),
):
    seed, both_sides = (int(option) for option in on_host(options))
    rest = [leaf_edge, table, vertices, edges, opposite, radius, apex, target, normal, scale, widest, both_sides]
    found, inverse = compact(
        kernels.edge_candidates, [], rest, apex.shape[0], seed, [segment, edge], 2, vertices.device
    )
    count.assign(found[1:2].astype(np.int32))
    weight.assign(np.array([inverse], np.float32))


def _point_candidates(
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array2d(dtype=int),
    point: wp.array(dtype=wp.vec3),
    point_edge: wp.array(dtype=int),
    radius: wp.array(dtype=float),
    apex: wp.array(dtype=wp.vec3),
    target: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    scale: wp.array(dtype=float),
    widest: wp.array(dtype=float),
    options: wp.array(dtype=int),
    segment: wp.array(dtype=int),
    element: wp.array(dtype=int),
    count: wp.array(dtype=int),
    weight: wp.array(dtype=float),
):
    cache = structure_cache("points", vertices.device)
    with cache.lock:
        bvh = cache.find([on_host(point), on_host(radius)], [])
        seed, both_sides = (int(option) for option in on_host(options))
        rest = [vertices, edges, opposite, point, point_edge, radius, apex, target, normal, scale, widest, both_sides]
        total, device = apex.shape[0], vertices.device
        found, inverse = compact(kernels.point_candidates, [bvh.id], rest, total, seed, [segment, element], 2, device)
    count.assign(found[1:2].astype(np.int32))
    weight.assign(np.array([inverse], np.float32))


def _sector_crossings(
    leaf_edge: wp.array(dtype=int),
    table: wp.array2d(dtype=wp.vec4),
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    edges: wp.array(dtype=wp.vec2i),
    edge_faces: wp.array2d(dtype=int),
    rank: wp.array(dtype=float),
    face_group: wp.array(dtype=int),
    apex: wp.array(dtype=wp.vec3),
    first: wp.array(dtype=wp.vec3),
    last: wp.array(dtype=wp.vec3),
    centre: wp.array(dtype=float),
    needed: wp.array(dtype=float),
    group: wp.array(dtype=int),
    options: wp.array(dtype=int),
    segment: wp.array(dtype=int),
    edge: wp.array(dtype=int),
    along: wp.array(dtype=float),
    counts: wp.array(dtype=int),
    weight: wp.array(dtype=float),
):
    cache, device = structure_cache("faces", vertices.device), vertices.device
    with cache.lock:
        bvh = cache.find([on_host(vertices)], [on_host(faces)])
        seed, least_layer = (int(option) for option in on_host(options))
        rest = [
            leaf_edge, table, vertices, faces, edges, edge_faces, rank, face_group,
            apex, first, last, centre, needed, group, float(least_layer),
        ]  # fmt: skip
        lists, total = [segment, edge, along], apex.shape[0]
        found, inverse = compact(sector_kernels.sector_crossings, [bvh.id], rest, total, seed, lists, 6, device)
    if found[2] > 1e-3 * found[5]:
        warnings.warn(
            f"jaxdr: before some of {total} chords surfaces could not be counted (something that pierces an emitter, "
            "or rounding); rays past each edge decided there",
            stacklevel=2,
        )
    counts.assign(found[1:].astype(np.int32))
    weight.assign(np.array([inverse], np.float32))


def _edge_tree(
    slots: wp.array(dtype=int),
    vertices: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.vec2i),
    opposite: wp.array2d(dtype=int),
    interior: wp.array(dtype=int),
    radius: wp.array(dtype=float),
    table: wp.array2d(dtype=wp.vec4),
):
    device, count = vertices.device, table.shape[0]
    nodes = wp.empty(count, dtype=tree_kernels.Node, device=device)
    first = count // 2
    table.zero_()  # row 0 is no node
    rest = [slots, vertices, edges, opposite, interior, radius, nodes, table]
    launch(tree_kernels.tree_leaves, first, [], rest, device)
    while first > 1:
        first //= 2
        launch(tree_kernels.tree_parents, first, [], [first, nodes, table], device)


_edge_candidates_call = Call(_edge_candidates, 4, kernels)
_point_candidates_call = Call(_point_candidates, 4, kernels)
_sector_crossings_call = Call(_sector_crossings, 5, sector_kernels)
_edge_tree_call = Call(_edge_tree, 1, tree_kernels)


def edge_tree(vertices, edges, opposite, interior, radius, slots):
    """Nodes of the tree over edges, [n, 3, 4]; see `edge_tree.build_edge_tree`."""
    count = 2 * len(slots) // LEAF
    slots, interior = jnp.asarray(slots), interior.astype(jnp.int32)
    (table,) = _edge_tree_call(slots, vertices, edges, opposite, interior, radius, output_dims=(count, 3))
    return table


def edge_candidates(
    tree, vertices, edges, opposite, radius, apex, target, normal, scale, widest, seed, capacity, both_sides
):
    """(segment [C], edge [C], count, weight): silhouette edges near segments; see `queries.edge_candidates`."""
    dims = {"segment": capacity, "edge": capacity, "count": 1, "weight": 1}
    table = (*tree, vertices, edges, opposite, radius)
    options = jnp.stack([seed, jnp.int32(both_sides)])
    call = _edge_candidates_call(*table, apex, target, normal, scale, widest, options, output_dims=dims)
    segment, edge, count, weight = call
    return segment, edge, count[0], weight[0]


def point_candidates(
    vertices,
    edges,
    opposite,
    point,
    point_edge,
    radius,
    apex,
    target,
    normal,
    scale,
    widest,
    seed,
    capacity,
    both_sides,
):
    """(segment [C], point [C], count, weight): points on silhouette edges near segments."""
    dims = {"segment": capacity, "element": capacity, "count": 1, "weight": 1}
    args = (
        vertices,
        edges,
        opposite,
        point,
        point_edge,
        radius,
        apex,
        target,
        normal,
        scale,
        widest,
        jnp.stack([seed, jnp.int32(both_sides)]),
    )
    segment, element, count, weight = _point_candidates_call(*args, output_dims=dims)
    return segment, element, count[0], weight[0]


def sector_crossings(
    tree, vertices, faces, edges, edge_faces, rank, face_group, apex, first, last, centre, needed, group, seed,
    least_layer, capacity,
):  # fmt: skip
    """(segment [C], edge [C], along [C], counts [5], weight): see `queries.sector_crossings`."""
    dims = {"segment": capacity, "edge": capacity, "along": capacity, "counts": 5, "weight": 1}
    table = (*tree, vertices, faces, edges, edge_faces, rank, face_group)
    options = jnp.stack([seed, jnp.int32(least_layer)])
    call = _sector_crossings_call
    *lists, counts, weight = call(*table, apex, first, last, centre, needed, group, options, output_dims=dims)
    return *lists, counts, weight[0]
