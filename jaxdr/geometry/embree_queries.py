"""Nearest hits and occlusion by Embree on the CPU, called as `warp_queries`; all other queries are Warp's own.

On other devices these two are Warp's as well.
"""

import warp as wp

from jaxdr.geometry import embree_kernels as kernels
from jaxdr.geometry import warp_queries
from jaxdr.geometry.bvh_cache import BVHCache
from jaxdr.geometry.embree_scene import EmbreeScene, library
from jaxdr.geometry.warp_launch import SLICE, Call, launch, on_host
from jaxdr.geometry.warp_queries import (  # noqa: F401
    all_hits,
    edge_candidates,
    edge_tree,
    point_candidates,
    sector_crossings,
)

_scenes = BVHCache(lambda moving, topology: EmbreeScene(moving[0], topology[0]), lambda scene, m: scene.refit(m[0]))


def _trace(kernel, function: int, vertices, faces, arrays):
    with _scenes.lock:
        scene = _scenes.find([on_host(vertices)], [on_host(faces)])
        packets = -(-arrays[0].shape[0] // kernels.PACKET)
        leading = [function, scene.handle]
        launch(kernel, packets, leading, arrays, vertices.device, SLICE // kernels.PACKET)


def _closest_hit(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
):
    arrays = [origin, direction, t_max, face, t]
    if not vertices.device.is_cpu:
        return warp_queries._closest_hit(vertices, faces, *arrays)
    _trace(kernels.closest_hit, library().intersect, vertices, faces, arrays)


def _occluded(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    result: wp.array(dtype=int),
):
    arrays = [origin, direction, t_max, result]
    if not vertices.device.is_cpu:
        return warp_queries._occluded(vertices, faces, *arrays)
    _trace(kernels.occluded, library().occluded, vertices, faces, arrays)


_closest_hit_call = Call(_closest_hit, 2, kernels)
_occluded_call = Call(_occluded, 1, kernels)


def closest_hit(vertices, faces, origin, direction, t_max):
    """(face, t): the nearest face in front of each ray, -1 and a huge t on a miss."""
    return _closest_hit_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])


def occluded(vertices, faces, origin, direction, t_max):
    """Whether anything lies on the ray before `t_max`."""
    (result,) = _occluded_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])
    return result != 0
