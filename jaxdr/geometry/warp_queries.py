"""Ray queries by Warp, on CPU (batches sliced over threads) and CUDA, called from JAX through `warp.jax_callable`.

The callables below receive the geometry with every call and look its BVH up by content (see `bvh_cache`), so a
query is a pure function of its arguments. They do host work and therefore run outside CUDA graphs.
"""

import os
import warnings
from concurrent.futures import ThreadPoolExecutor, wait

import jax.numpy as jnp
import numpy as np
import warp as wp
from warp import JaxCallableGraphMode, jax_callable

from jaxdr.geometry import warp_kernels as kernels
from jaxdr.geometry.bvh_cache import BVHCache

THREADS = os.cpu_count() or 1
# Slices are a fixed number of rays, not a share: results come back in the same order on any number of threads.
SLICE = 8192

# Warp tests boxes without room for rounding; without a margin rays slip past the faces of neighbouring boxes.
BOX_MARGIN = 16 * np.finfo(np.float32).eps

_pool = ThreadPoolExecutor(THREADS, thread_name_prefix="jaxdr-query")


def _host(array: wp.array) -> np.ndarray:
    """The array on the host: a view on CPU, a copy from CUDA."""
    return array.numpy()


def _face_boxes(moving, topology):
    """Bounds of the faces, grown by what rounding in a ray-box test amounts to."""
    corners = moving[0][topology[0]]
    margin = BOX_MARGIN * np.abs(moving[0]).max()
    return corners.min(1) - margin, corners.max(1) + margin


class _MeshBVH:
    """A Warp mesh whose boxes are those of `_face_boxes`.

    Warp computes boxes from the points it is built (refitted) with and faces from the points it has at a query. So it
    is built with corners pushed apart to the ends of their boxes, and gets the true corners afterwards.
    """

    def __init__(self, moving, topology, device):
        self.topology = topology
        points = wp.array(self._spread(moving), dtype=wp.vec3, device=device)
        indices = wp.array(np.arange(topology[0].size), dtype=int, device=device)
        self.mesh = wp.Mesh(points=points, indices=indices)
        self.mesh.points.assign(self._corners(moving))

    @property
    def id(self):
        return self.mesh.id

    def refit(self, moving):
        self.mesh.points.assign(self._spread(moving))
        self.mesh.refit()
        self.mesh.points.assign(self._corners(moving))

    def _corners(self, moving):
        return moving[0][self.topology[0]].reshape(-1, 3)

    def _spread(self, moving):
        """Three points a face that span its box: the first holds the lower end, the last the upper one."""
        lower, upper = _face_boxes(moving, self.topology)
        return np.stack([lower, lower, upper], 1).reshape(-1, 3)


def _point_boxes(moving, topology):
    radius = np.maximum(moving[1], 0.0)[:, None]
    return moving[0] - radius, moving[0] + radius


class _BoxBVH:
    """A Warp BVH over boxes that are computed from the arrays of a query."""

    def __init__(self, boxes, moving, topology, device):
        self.boxes, self.topology = boxes, topology
        lower, upper = boxes(moving, topology)
        self.bvh = wp.Bvh(*(wp.array(a.astype(np.float32), dtype=wp.vec3, device=device) for a in (lower, upper)))

    @property
    def id(self):
        return self.bvh.id

    def refit(self, moving):
        lower, upper = self.boxes(moving, self.topology)
        self.bvh.lowers.assign(lower.astype(np.float32))
        self.bvh.uppers.assign(upper.astype(np.float32))
        self.bvh.refit()


def _box_cache(boxes):
    def cache(device):
        return BVHCache(lambda m, t: _BoxBVH(boxes, m, t, device), lambda structure, m: structure.refit(m))

    return cache


def _mesh_cache(device):
    return BVHCache(lambda m, t: _MeshBVH(m, t, device), lambda structure, m: structure.refit(m))


_caches: dict[tuple[str, str], BVHCache] = {}
_MAKERS = {
    "mesh": _mesh_cache,
    "faces": _box_cache(_face_boxes),
    "points": _box_cache(_point_boxes),
}


def _cache(kind: str, device) -> BVHCache:
    key = (kind, str(device))
    if key not in _caches:
        _caches[key] = _MAKERS[kind](device)
    return _caches[key]


def _launch(kernel, count: int, leading: list, rest: list, device) -> None:
    """Run `kernel(*leading, start, *rest)` over `count` rays: in slices on a thread pool on CPU, whole on CUDA."""
    if count == 0:
        return
    if not device.is_cpu:
        wp.launch(kernel, dim=count, inputs=[*leading, 0, *rest], device=device, record_tape=False)
        return
    wp.load_module(kernel.module, device=device)

    def run(start):
        size = min(SLICE, count - start)
        wp.launch(kernel, dim=size, inputs=[*leading, start, *rest], device=device, record_tape=False)

    jobs = [_pool.submit(run, start) for start in range(0, count, SLICE)]
    wait(jobs)
    for job in jobs:
        job.result()


def _closest_hit(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
):
    cache = _cache("mesh", vertices.device)
    with cache.lock:
        mesh = cache.find([_host(vertices)], [_host(faces)])
        arrays = [origin, direction, t_max, face, t]
        _launch(kernels.closest_hit, origin.shape[0], [mesh.id], arrays, vertices.device)


def _occluded(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    result: wp.array(dtype=int),
):
    cache = _cache("mesh", vertices.device)
    with cache.lock:
        mesh = cache.find([_host(vertices)], [_host(faces)])
        _launch(kernels.occluded, origin.shape[0], [mesh.id], [origin, direction, t_max, result], vertices.device)


def _all_hits(
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    origin: wp.array(dtype=wp.vec3),
    direction: wp.array(dtype=wp.vec3),
    t_max: wp.array(dtype=float),
    face: wp.array2d(dtype=int),
    t: wp.array2d(dtype=float),
    count: wp.array(dtype=int),
):
    face.fill_(-1)
    t.fill_(kernels.MISS)
    cache = _cache("faces", vertices.device)
    with cache.lock:
        bvh = cache.find([_host(vertices)], [_host(faces)])
        arrays = [vertices, faces, origin, direction, t_max, face, t, count]
        _launch(kernels.all_hits, origin.shape[0], [bvh.id], arrays, vertices.device)


def _compact(kernel, leading, rest, total, seed, segment, element, count, weight, device):
    """Run a candidate kernel over `total` segments and gather its pairs; when they overflow, thin them without bias.

    The thinning probability depends on the number of pairs alone, not on which of them survive, so weighting the
    survivors by its inverse is unbiased; eight standard deviations of slack keep them within the capacity.
    """
    capacity, probability = segment.shape[0], 1.0
    kept, every = _run_candidates(kernel, leading, rest, total, seed, probability, segment, element, device)
    if kept > capacity:
        probability = max(capacity - 8.0 * capacity**0.5, 0.5 * capacity) / every
        warnings.warn(
            f"jaxdr: {every} (segment, edge) pairs of {total} segments exceed the capacity of {capacity}; "
            f"thinned without bias to {probability:.0%}. A smaller kernel radius or a larger capacity avoids it.",
            stacklevel=2,
        )
        kept, _ = _run_candidates(kernel, leading, rest, total, seed, probability, segment, element, device)
        if kept > capacity:
            raise RuntimeError(f"jaxdr: thinning {every} pairs left {kept}, more than the capacity of {capacity}")
    count.assign(np.array([every], np.int32))
    weight.assign(np.array([1.0 / probability], np.float32))


def _run_candidates(kernel, leading, rest, total, seed, probability, segment, element, device):
    """Fill `segment` and `element` with pairs; returns how many were kept and how many there are."""
    capacity = segment.shape[0]
    segment.fill_(-1)
    element.zero_()
    if not device.is_cpu:
        found = wp.zeros(2, dtype=int, device=device)
        inputs = [*leading, 0, *rest, seed, probability, segment, element, found]
        wp.launch(kernel, dim=total, inputs=inputs, device=device, record_tape=False)
        return tuple(int(n) for n in found.numpy())
    wp.load_module(kernel.module, device=device)

    def run(start):
        size = min(SLICE, total - start)
        out = [wp.empty(capacity, dtype=int, device=device) for _ in range(2)]
        found = wp.zeros(2, dtype=int, device=device)
        inputs = [*leading, start, *rest, seed, probability, *out, found]
        wp.launch(kernel, dim=size, inputs=inputs, device=device, record_tape=False)
        kept, every = (int(n) for n in found.numpy())
        return [a.numpy()[: min(kept, capacity)] for a in out], kept, every

    # Each slice fills its own list and the lists are joined in order: the result does not depend on timing.
    parts = list(_pool.map(run, range(0, total, SLICE)))
    for target, index in ((segment, 0), (element, 1)):
        joined = np.concatenate([part[0][index] for part in parts])[:capacity]
        target.numpy()[: len(joined)] = joined
    return sum(part[1] for part in parts), sum(part[2] for part in parts)


def _edge_candidates(
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
    axis: wp.array(dtype=wp.vec3),
    cosine: wp.array(dtype=float),
    node_radius: wp.array(dtype=float),
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
    seed, both_sides = (int(option) for option in _host(options))
    tree = [lower, upper, axis, cosine, node_radius]
    rest = [*tree, vertices, edges, opposite, radius, apex, target, normal, scale, widest, both_sides]
    _compact(kernels.edge_candidates, [], rest, apex.shape[0], seed, segment, edge, count, weight, vertices.device)


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
    cache = _cache("points", vertices.device)
    with cache.lock:
        bvh = cache.find([_host(point), _host(radius)], [])
        seed, both_sides = (int(option) for option in _host(options))
        rest = [vertices, edges, opposite, point, point_edge, radius, apex, target, normal, scale, widest, both_sides]
        total, device = apex.shape[0], vertices.device
        _compact(kernels.point_candidates, [bvh.id], rest, total, seed, segment, element, count, weight, device)


class _Call:
    """A `jax_callable` whose lowered form does not depend on how often it was traced before.

    Warp numbers the traced calls and writes the number into the program, which would defeat JAX's compilation cache.
    The number only tells static arguments apart, and these callables have none.
    """

    def __init__(self, function, num_outputs):
        function.__module__ = kernels.__name__  # Warp loads the module of the function: let it be the kernels' own
        self.call = jax_callable(function, num_outputs=num_outputs, graph_mode=JaxCallableGraphMode.NONE)

    def __call__(self, *args, output_dims):
        self.call.call_id = 0
        return self.call(*args, output_dims=output_dims)


_closest_hit_call = _Call(_closest_hit, 2)
_occluded_call = _Call(_occluded, 1)
_all_hits_call = _Call(_all_hits, 3)
_edge_candidates_call = _Call(_edge_candidates, 4)
_point_candidates_call = _Call(_point_candidates, 4)


def closest_hit(vertices, faces, origin, direction, t_max):
    """(face, t): the nearest face in front of each ray, -1 and a huge t on a miss."""
    return _closest_hit_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])


def occluded(vertices, faces, origin, direction, t_max):
    """Whether anything lies on the ray before `t_max`."""
    (result,) = _occluded_call(vertices, faces, origin, direction, t_max, output_dims=origin.shape[0])
    return result != 0


def all_hits(vertices, faces, origin, direction, t_max, capacity):
    """(face [N, C], t [N, C], count [N]): the nearest `capacity` crossings, sorted; `count` counts all of them."""
    n = origin.shape[0]
    dims = {"face": (n, capacity), "t": (n, capacity), "count": n}
    return _all_hits_call(vertices, faces, origin, direction, t_max, output_dims=dims)


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
