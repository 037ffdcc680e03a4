"""Nearest hits and occlusion by Embree on the CPU, with the interface of `warp.queries`.

All other queries, and these two on other devices, are Warp's own.
"""

from jaxdr.geometry.queries.bvh_cache import BVHCache
from jaxdr.geometry.queries.embree import kernels
from jaxdr.geometry.queries.embree.scene import EmbreeScene, library
from jaxdr.geometry.queries.warp import queries as warp_queries
from jaxdr.geometry.queries.warp.launch import SLICE, launch, on_host
from jaxdr.geometry.queries.warp.queries import (  # noqa: F401
    closest_silhouettes,
    draw_edges,
    edge_candidates,
    edge_tree,
    face_intersections,
    point_candidates,
    projections,
    sector_crossings,
    silhouettes,
)

_scenes = BVHCache(lambda moving, topology: EmbreeScene(moving[0], topology[0]), lambda scene, m: scene.refit(m[0]))


def _trace(kernel: str, geometry, rays, outputs: list) -> None:
    vertices, faces = geometry.vertices, geometry.faces
    if not vertices.device.is_cpu:
        return warp_queries.trace(kernel, geometry, rays, outputs)
    function = library().intersect if kernel == "closest_hit" else library().occluded
    with _scenes.lock:
        scene = _scenes.find([on_host(vertices)], [on_host(faces)])
        packets = -(-rays.reach.shape[0] // kernels.PACKET)
        leading, rest = [function, scene.handle], [rays, *outputs]
        launch(getattr(kernels, kernel), packets, leading, rest, vertices.device, SLICE // kernels.PACKET)


closest_hit, occluded = warp_queries.hit_queries(_trace, kernels)
