"""Warp kernel that finds where faces pass through each other; the reference is `jax.intersections`.

A face is compared with the faces whose boxes its box meets, in double precision.
"""

import warp as wp

from jaxdr.geometry.queries import records
from jaxdr.geometry.queries.warp.kernels import keeps
from jaxdr.geometry.queries.warp.records import Geometry
from jaxdr.geometry.queries.warp.tree_kernels import face_box

wp.set_module_options({"enable_backward": False})  # answers are discrete: no derivative to compile

TOUCHING = wp.constant(wp.float64(records.TOUCHING))
ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Piece:
    """Where a plane cuts a triangle: the ends of the piece; `cut` is 0 if it does not."""

    start: wp.vec3d
    end: wp.vec3d
    cut: int


@wp.func
def shares_vertex(v: wp.vec3i, w: wp.vec3i):
    for i in range(3):
        for j in range(3):
            if v[i] == w[j]:
                return True
    return False


@wp.func
def at_zero(p: wp.vec3d, q: wp.vec3d, h: wp.float64, k: wp.float64):
    """The point of a side where heights that go from `h` to `k` are zero."""
    return p + (h / (h - k)) * (q - p)


@wp.func
def piece_of(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, height: wp.vec3d, rounding: wp.float64):
    """The piece of a triangle at height zero over a plane. It must reach beyond `rounding` on both sides."""
    piece = Piece()
    piece.cut = 0
    if wp.max(height) > rounding and wp.min(height) < -rounding:
        piece.cut = 1
        ab = (height[0] > ZERO) != (height[1] > ZERO)
        bc = (height[1] > ZERO) != (height[2] > ZERO)
        if ab and bc:
            piece.start = at_zero(a, b, height[0], height[1])
            piece.end = at_zero(b, c, height[1], height[2])
        elif ab:
            piece.start = at_zero(a, b, height[0], height[1])
            piece.end = at_zero(c, a, height[2], height[0])
        else:
            piece.start = at_zero(b, c, height[1], height[2])
            piece.end = at_zero(c, a, height[2], height[0])
    return piece


@wp.kernel
def face_intersections(
    bvh: wp.uint64,
    start: int,
    geometry: Geometry,
    moving: wp.array(dtype=int),
    options: wp.array(dtype=int),
    probability: float,
    first_out: wp.array(dtype=int),
    second_out: wp.array(dtype=int),
    start_out: wp.array(dtype=wp.vec3),
    end_out: wp.array(dtype=wp.vec3),
    found: wp.array(dtype=int),
):
    """Pairs of faces and the ends of what they have in common; `options` = [seed, ...], `found` = [kept, all]."""
    f = start + wp.tid()
    if moving[f] == 0:
        return
    v = geometry.faces[f]
    low, high = face_box(geometry.vertices, v, 0.0)
    a = wp.vec3d(geometry.vertices[v[0]])
    b = wp.vec3d(geometry.vertices[v[1]])
    c = wp.vec3d(geometry.vertices[v[2]])
    normal = wp.normalize(wp.cross(b - a, c - a))
    g = int(0)
    query = wp.bvh_query_aabb(bvh, low, high)
    while wp.bvh_query_next(query, g):
        if f != g and (moving[g] == 0 or f < g):
            w = geometry.faces[g]
            if not shares_vertex(v, w):
                p = wp.vec3d(geometry.vertices[w[0]])
                q = wp.vec3d(geometry.vertices[w[1]])
                r = wp.vec3d(geometry.vertices[w[2]])
                far = wp.max(wp.max(wp.abs(low)), wp.max(wp.abs(high)))
                rounding = TOUCHING * wp.float64(far)
                over_first = wp.vec3d(wp.dot(normal, p - a), wp.dot(normal, q - a), wp.dot(normal, r - a))
                other = piece_of(p, q, r, over_first, rounding)
                if other.cut == 1:
                    across = wp.normalize(wp.cross(q - p, r - p))
                    over_second = wp.vec3d(wp.dot(across, a - p), wp.dot(across, b - p), wp.dot(across, c - p))
                    own = piece_of(a, b, c, over_second, rounding)
                    if own.cut == 1:
                        line = wp.cross(normal, across)
                        if wp.dot(line, own.end - own.start) < ZERO:
                            swapped = own.start
                            own.start = own.end
                            own.end = swapped
                        if wp.dot(line, other.end - other.start) < ZERO:
                            swapped = other.start
                            other.start = other.end
                            other.end = swapped
                        begin = own.start
                        if wp.dot(line, other.start - own.start) > ZERO:
                            begin = other.start
                        end = own.end
                        if wp.dot(line, other.end - own.end) < ZERO:
                            end = other.end
                        if wp.dot(line, end - begin) > rounding * wp.length(line):
                            wp.atomic_add(found, 1, 1)
                            if keeps(f, g, options[0], probability):
                                j = wp.atomic_add(found, 0, 1)
                                if j < first_out.shape[0]:
                                    first_out[j] = f
                                    second_out[j] = g
                                    start_out[j] = wp.vec3(begin)
                                    end_out[j] = wp.vec3(end)
