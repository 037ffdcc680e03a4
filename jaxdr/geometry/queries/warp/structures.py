"""Warp's structures over faces and points, kept by the content of the geometry that they are over (`bvh_cache`)."""

import numpy as np
import warp as wp

from jaxdr.geometry.queries.bvh_cache import BVHCache
from jaxdr.geometry.queries.warp import tree_kernels
from jaxdr.geometry.queries.warp.launch import launch

# Warp tests boxes without room for rounding; without a margin rays slip past the faces of neighbouring boxes.
BOX_MARGIN = 16 * np.finfo(np.float32).eps


def _on(device, array, dtype) -> wp.array:
    """A host array where kernels can read it: a view on CPU, a copy on CUDA."""
    return wp.array(array, dtype=dtype, device=device, copy=not device.is_cpu)


class _FaceBVH:
    """What structures over faces share: the faces on the device, and their boxes' margin."""

    def __init__(self, topology, device):
        self.device = device
        self.count = len(topology[0])
        self.faces = wp.array(topology[0], dtype=wp.vec3i, device=device)

    def _launch(self, kernel, moving, *rest):
        vertices = _on(self.device, moving[0], wp.vec3)
        launch(kernel, self.count, [], [vertices, self.faces, *rest], self.device)

    def _margin(self, moving) -> float:
        return float(BOX_MARGIN * np.abs(moving[0]).max())

    def _empty(self, count):
        return wp.empty(count, dtype=wp.vec3, device=self.device)


class _MeshBVH(_FaceBVH):
    """A Warp mesh whose boxes have a margin.

    Warp computes boxes from the points it is built (refitted) with and faces from the points it has at a query. So it
    is built with corners pushed apart to the ends of their boxes, and gets the true corners afterwards.
    """

    def __init__(self, moving, topology, device):
        super().__init__(topology, device)
        points = self._empty(3 * self.count)
        self._spread(moving, points)
        self.mesh = wp.Mesh(points=points, indices=wp.array(np.arange(3 * self.count), dtype=int, device=device))
        self._launch(tree_kernels.face_corners, moving, self.mesh.points)

    @property
    def id(self):
        return self.mesh.id

    def refit(self, moving):
        self._spread(moving, self.mesh.points)
        self.mesh.refit()
        self._launch(tree_kernels.face_corners, moving, self.mesh.points)

    def _spread(self, moving, points):
        self._launch(tree_kernels.corners_at_box_ends, moving, self._margin(moving), points)


class _BoxBVH(_FaceBVH):
    """A Warp BVH over the boxes of faces, for queries with intersection tests of their own."""

    def __init__(self, moving, topology, device):
        super().__init__(topology, device)
        lower, upper = self._empty(self.count), self._empty(self.count)
        self._launch(tree_kernels.face_boxes, moving, self._margin(moving), lower, upper)
        self.bvh = wp.Bvh(lower, upper)

    @property
    def id(self):
        return self.bvh.id

    def refit(self, moving):
        self._launch(tree_kernels.face_boxes, moving, self._margin(moving), self.bvh.lowers, self.bvh.uppers)
        self.bvh.refit()


class _PointBVH:
    """A Warp BVH over boxes around points, [point, radius]."""

    def __init__(self, moving, topology, device):
        del topology
        self.bvh = wp.Bvh(*(wp.array(a, dtype=wp.vec3, device=device) for a in self._boxes(moving)))

    @property
    def id(self):
        return self.bvh.id

    def refit(self, moving):
        lower, upper = self._boxes(moving)
        self.bvh.lowers.assign(lower)
        self.bvh.uppers.assign(upper)
        self.bvh.refit()

    def _boxes(self, moving):
        radius = np.maximum(moving[1], 0.0)[:, None]
        return (moving[0] - radius).astype(np.float32), (moving[0] + radius).astype(np.float32)


_caches: dict[tuple[str, str], BVHCache] = {}
_STRUCTURES = {"mesh": _MeshBVH, "faces": _BoxBVH, "points": _PointBVH}


def structure_cache(kind: str, device) -> BVHCache:
    """The structures of one kind that were used last on a device, by the content of the geometry."""
    key = (kind, str(device))
    if key not in _caches:
        make = _STRUCTURES[kind]
        # In one step: another thread may be here, too.
        _caches.setdefault(key, BVHCache(lambda m, t: make(m, t, device), lambda structure, m: structure.refit(m)))
    return _caches[key]
