"""Warp kernels for the CPU that trace packets of 16 rays with Embree, whose functions they call by address.

The structure in the snippets is RTCRayHit16 of Embree 4, which begins with RTCRay16.
"""

import warp as wp

from jaxdr.geometry.queries.warp.records import Rays

wp.set_module_options({"enable_backward": False})  # answers are discrete: no derivative to compile

PACKET = 16

# `valid` lanes are -1. Lanes after the last ray are copies of the first ray, and are not used.
_FILL = """
    struct alignas(64) RayHit16 {
        float ox[16], oy[16], oz[16], tnear[16], dx[16], dy[16], dz[16], time[16], tfar[16];
        unsigned mask[16], id[16], flags[16];
        float ngx[16], ngy[16], ngz[16], u[16], v[16];
        unsigned prim[16], geom[16], inst[16], inst_prim[16];
    };
    RayHit16 ray;
    alignas(64) signed valid[16];
    const signed size = rays.reach.shape[0] - first < 16 ? rays.reach.shape[0] - first : 16;
    for (signed k = 0; k < 16; ++k) {
        const signed i = first + (k < size ? k : 0);
        const wp::vec3 o = *wp::address(rays.origin, i), d = *wp::address(rays.direction, i);
        const float reach = *wp::address(rays.reach, i);
        ray.ox[k] = o[0]; ray.oy[k] = o[1]; ray.oz[k] = o[2];
        ray.dx[k] = d[0]; ray.dy[k] = d[1]; ray.dz[k] = d[2];
        ray.tnear[k] = 0.0f; ray.tfar[k] = reach; ray.time[k] = 0.0f;
        ray.mask[k] = ~0u; ray.id[k] = k; ray.flags[k] = 0;
        ray.prim[k] = ray.geom[k] = ray.inst[k] = ray.inst_prim[k] = ~0u;
        valid[k] = k < size && reach > 0.0f ? -1 : 0;
    }
    ((void (*)(const signed*, void*, void*, void*))function)(valid, (void*)scene, &ray, nullptr);
"""


@wp.func_native(
    _FILL
    + """
    for (signed k = 0; k < size; ++k) {
        const bool hit = ray.geom[k] != ~0u;
        *wp::address(face, first + k) = hit ? (signed)ray.prim[k] : -1;
        *wp::address(t, first + k) = hit ? ray.tfar[k] : 3.0e38f;
        // Rounding may put a hit outside of its face.
        const float u = hit ? ray.u[k] : 1.0f / 3.0f, v = hit ? ray.v[k] : 1.0f / 3.0f;
        const float a = u + v < 1.0f ? 1.0f - u - v : 0.0f, b = u > 0.0f ? u : 0.0f, c = v > 0.0f ? v : 0.0f;
        const float sum = a + b + c;
        *wp::address(barycentric, first + k) = wp::vec3(a / sum, b / sum, c / sum);
    }
"""
)
def _intersect(
    function: wp.uint64,
    scene: wp.uint64,
    first: int,
    rays: Rays,
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
    barycentric: wp.array(dtype=wp.vec3),
): ...


@wp.func_native(
    _FILL
    + """
    for (signed k = 0; k < size; ++k)  // Embree marks rays that something lies on
        *wp::address(result, first + k) = valid[k] && ray.tfar[k] < 0.0f;
"""
)
def _occluded(
    function: wp.uint64,
    scene: wp.uint64,
    first: int,
    rays: Rays,
    result: wp.array(dtype=int),
): ...


@wp.kernel
def closest_hit(
    function: wp.uint64,
    scene: wp.uint64,
    start: int,
    rays: Rays,
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
    barycentric: wp.array(dtype=wp.vec3),
):
    _intersect(function, scene, PACKET * (start + wp.tid()), rays, face, t, barycentric)


@wp.kernel
def occluded(
    function: wp.uint64,
    scene: wp.uint64,
    start: int,
    rays: Rays,
    result: wp.array(dtype=int),
):
    _occluded(function, scene, PACKET * (start + wp.tid()), rays, result)
