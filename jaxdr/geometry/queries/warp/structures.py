"""Warp's structures over faces and points, kept by the content of their geometry (`bvh_cache`)."""

import numpy as np
import warp as wp

from jaxdr.geometry.queries.bvh_cache import BVHCache, HostArrays
from jaxdr.geometry.queries.warp import tree_kernels
from jaxdr.geometry.queries.warp.device_arrays import DeviceArrays, largest
from jaxdr.geometry.queries.warp.launch import launch

# Warp tests boxes without tolerance for rounding. Without a margin rays slip between the faces of neighbouring boxes.
BOX_MARGIN = 16 * np.finfo(np.float32).eps
# Warp walks trees with a stack of 32 nodes. Its default for GPUs ("lbvh") builds trees of any depth. Then, if the stack
# is full, rays miss the remaining nodes, and other queries write past its end. This constructor, on the host, keeps to
# the limit.
CONSTRUCTOR = "sah"


def _for_kernels(array, dtype) -> wp.array:
    """A kept array for kernels; an array on the host becomes a view."""
    return array if isinstance(array, wp.array) else wp.array(array, dtype=dtype, device="cpu", copy=False)


class _FaceBVH:
    """Base of structures over faces: the faces, and the margin of their boxes."""

    def __init__(self, topology, device):
        self.device = device
        self.count = len(topology[0])
        self.faces = _for_kernels(topology[0], wp.vec3i)

    def _launch(self, kernel, moving, *rest):
        vertices = _for_kernels(moving[0], wp.vec3)
        launch(kernel, self.count, [], [vertices, self.faces, *rest], self.device)

    def _margin(self, moving) -> float:
        far = largest(moving[0]) if isinstance(moving[0], wp.array) else np.abs(moving[0]).max()
        return float(BOX_MARGIN * far)

    def _empty(self, count):
        return wp.empty(count, dtype=wp.vec3, device=self.device)


class _MeshBVH(_FaceBVH):
    """A Warp mesh whose boxes have a margin.

    Warp computes boxes from the points at the time of building or refitting, and faces from the points at the time of a
    query. So the mesh is built with corners pushed apart to the ends of their boxes, and gets the true corners
    afterwards.
    """

    def __init__(self, moving, topology, device):
        super().__init__(topology, device)
        points = self._empty(3 * self.count)
        self._spread(moving, points)
        indices = wp.array(np.arange(3 * self.count), dtype=int, device=device)
        self.mesh = wp.Mesh(points=points, indices=indices, bvh_constructor=CONSTRUCTOR)
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
    """A Warp BVH over the boxes of faces, for queries with their own intersection tests.

    `answers` has answers to questions about the faces alone, by the question; they go when the faces move.
    """

    def __init__(self, moving, topology, device):
        super().__init__(topology, device)
        self.answers = {}
        lower, upper = self._empty(self.count), self._empty(self.count)
        self._launch(tree_kernels.face_boxes, moving, self._margin(moving), lower, upper)
        self.bvh = wp.Bvh(lower, upper, constructor=CONSTRUCTOR)

    @property
    def id(self):
        return self.bvh.id

    def refit(self, moving):
        self.answers = {}
        self._launch(tree_kernels.face_boxes, moving, self._margin(moving), self.bvh.lowers, self.bvh.uppers)
        self.bvh.refit()


class _PointBVH:
    """A Warp BVH over boxes around points, [point, radius]."""

    def __init__(self, moving, topology, device):
        del topology
        lower, upper = (wp.empty(len(moving[0]), dtype=wp.vec3, device=device) for _ in range(2))
        self._boxes(moving, lower, upper)
        self.bvh = wp.Bvh(lower, upper, constructor=CONSTRUCTOR)

    @property
    def id(self):
        return self.bvh.id

    def refit(self, moving):
        self._boxes(moving, self.bvh.lowers, self.bvh.uppers)
        self.bvh.refit()

    def _boxes(self, moving, lower, upper):
        point, radius = _for_kernels(moving[0], wp.vec3), _for_kernels(moving[1], float)
        launch(tree_kernels.point_boxes, len(moving[0]), [], [point, radius, lower, upper], lower.device)


_caches: dict[tuple[str, str], BVHCache] = {}
_STRUCTURES = {"mesh": _MeshBVH, "faces": _BoxBVH, "points": _PointBVH}


def structure_cache(kind: str, device) -> BVHCache:
    """The structures of one kind that were used last on a device, by the content of the geometry.

    Its arrays are NumPy's on a CPU and Warp's elsewhere.
    """
    key = (kind, str(device))
    if key not in _caches:
        make, arrays = _STRUCTURES[kind], arrays_on(device)
        cache = BVHCache(lambda m, t: make(m, t, device), lambda structure, m: structure.refit(m), arrays)
        _caches.setdefault(key, cache)  # atomic: another thread may be here at the same time
    return _caches[key]


def arrays_on(device) -> HostArrays | DeviceArrays:
    """How caches on a device compare and copy arrays."""
    return HostArrays() if device.is_cpu else DeviceArrays(device)
