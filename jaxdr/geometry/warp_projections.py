"""Projections of points onto a shape along a line, by Warp: every crossing of the line near the point."""

import sys
import warnings

import numpy as np
import warp as wp

from jaxdr.geometry.warp_kernels import MISS, crossing, keep_nearest
from jaxdr.geometry.warp_launch import Call, launch, on_host
from jaxdr.geometry.warp_structures import structure_cache

wp.set_module_options({"enable_backward": False})


@wp.kernel
def projections_kernel(
    bvh: wp.uint64,
    start: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    face_shape: wp.array(dtype=int),
    point: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
    shape: wp.array(dtype=int),
    face: wp.array2d(dtype=int),
    height: wp.array2d(dtype=float),
    count: wp.array(dtype=int),
):
    """Faces of a shape that a line crosses within `depth` of a point; the nearest are kept, sorted."""
    i = start + wp.tid()
    count[i] = 0
    if depth[i] <= 0.0:
        return
    begin = point[i] - depth[i] * normal[i]
    o = wp.vec3d(begin)
    d = wp.vec3d(normal[i])
    found = int(0)
    f = int(0)
    query = wp.bvh_query_ray(bvh, begin, normal[i])
    while wp.bvh_query_next(query, f, 2.0 * depth[i]):
        if face_shape[f] == shape[i]:
            h = crossing(vertices, faces, f, o, d) - depth[i]
            if wp.abs(h) < depth[i]:
                keep_nearest(face, height, i, found, f, h)
                found += 1
    count[i] = found


def _projections(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    face_shape: wp.array(dtype=int),
    point: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
    shape: wp.array(dtype=int),
    face: wp.array2d(dtype=int),
    height: wp.array2d(dtype=float),
    count: wp.array(dtype=int),
):
    face.fill_(-1)
    height.fill_(MISS)
    cache = structure_cache("faces", vertices.device)
    with cache.lock:
        bvh = cache.find([on_host(vertices)], [on_host(faces)])
        arrays = [vertices, faces, face_shape, point, normal, depth, shape, face, height, count]
        launch(projections_kernel, point.shape[0], [bvh.id], arrays, vertices.device)
    over = int(np.count_nonzero(on_host(count) > face.shape[1]))
    if over:
        warnings.warn(
            f"jaxdr: {over} of {point.shape[0]} auxiliary points have more projections onto their shape than the "
            f"{face.shape[1]} that there is room for; the furthest were left out. More room avoids it.",
            stacklevel=2,
        )


_projections_call = Call(_projections, 3, sys.modules[__name__])


def projections(vertices, faces, face_shape, point, normal, depth, shape, capacity):
    """(face [N, C], height [N, C], count [N]): see `queries.projections`."""
    n = point.shape[0]
    dims = {"face": (n, capacity), "height": (n, capacity), "count": n}
    return _projections_call(vertices, faces, face_shape, point, normal, depth, shape, output_dims=dims)
