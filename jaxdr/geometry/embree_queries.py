"""Nearest hits and occlusion by Embree on the CPU, called as `warp_queries`; all other queries are Warp's own.

On other devices these two are Warp's as well.
"""

import warp as wp

from jaxdr.geometry import embree_kernels as kernels
from jaxdr.geometry import warp_queries
from jaxdr.geometry.bvh_cache import BVHCache
from jaxdr.geometry.embree_scene import EmbreeScene, library
from jaxdr.geometry.warp_launch import SLICE, launch, on_host
from jaxdr.geometry.warp_queries import (  # noqa: F401
    edge_candidates,
    edge_tree,
    point_candidates,
    projections,
    sector_crossings,
)

_scenes = BVHCache(lambda moving, topology: EmbreeScene(moving[0], topology[0]), lambda scene, m: scene.refit(m[0]))


def _trace(kernel: str, vertices: wp.array, faces: wp.array, arrays: list) -> None:
    if not vertices.device.is_cpu:
        return warp_queries.trace(kernel, vertices, faces, arrays)
    function = library().intersect if kernel == "closest_hit" else library().occluded
    with _scenes.lock:
        scene = _scenes.find([on_host(vertices)], [on_host(faces)])
        packets = -(-arrays[0].shape[0] // kernels.PACKET)
        leading = [function, scene.handle]
        launch(getattr(kernels, kernel), packets, leading, arrays, vertices.device, SLICE // kernels.PACKET)


closest_hit, occluded = warp_queries.hit_queries(_trace, kernels)
