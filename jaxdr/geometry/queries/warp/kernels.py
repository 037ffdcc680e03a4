"""Warp kernels of the ray queries. They answer discrete questions only: which face, which edge, occluded or not.

Every kernel works on the slice that starts at `start`, so that a CPU launch can be split over threads.
"""

import warp as wp

from jaxdr.geometry import edge_tree
from jaxdr.geometry.queries.warp.records import EdgePoints, EdgeSet, EdgeTree, Geometry, Lines, Rays, StripQuery

wp.set_module_options({"enable_backward": False})  # answers are discrete: no derivative to compile

MISS = wp.constant(wp.float32(3.0e38))
LEAF = wp.constant(edge_tree.LEAF)


@wp.kernel
def closest_hit(
    mesh: wp.uint64,
    start: int,
    rays: Rays,
    face: wp.array(dtype=int),
    t: wp.array(dtype=float),
    barycentric: wp.array(dtype=wp.vec3),
):
    i = start + wp.tid()
    face[i] = -1
    t[i] = MISS
    barycentric[i] = wp.vec3(1.0 / 3.0)
    if rays.reach[i] > 0.0:
        query = wp.mesh_query_ray(mesh, rays.origin[i], rays.direction[i], rays.reach[i])
        if query.result:
            face[i] = query.face
            t[i] = query.t
            # Rounding may put a hit outside of its face.
            inside = wp.max(wp.vec3(query.u, query.v, 1.0 - query.u - query.v), wp.vec3(0.0))
            barycentric[i] = inside / (inside[0] + inside[1] + inside[2])


@wp.kernel
def occluded(
    mesh: wp.uint64,
    start: int,
    rays: Rays,
    result: wp.array(dtype=int),
):
    i = start + wp.tid()
    result[i] = 0
    if rays.reach[i] > 0.0:
        result[i] = int(wp.mesh_query_ray_anyhit(mesh, rays.origin[i], rays.direction[i], rays.reach[i]))


@wp.func
def directed_volume(d: wp.vec3d, p: wp.vec3d, q: wp.vec3d, i: int, j: int):
    """Signed volume of the ray with edge (p, q). The order of the vertex indices makes both faces agree on it.

    Double precision makes the faces around a vertex agree as well.
    """
    if i < j:
        return wp.dot(d, wp.cross(p, q))
    return -wp.dot(d, wp.cross(q, p))


@wp.func
def crossing(geometry: Geometry, f: int, o: wp.vec3d, d: wp.vec3d):
    """Ray parameter where the line (o, d) crosses a face; MISS if it does not."""
    v = geometry.faces[f]
    a = wp.vec3d(geometry.vertices[v[0]]) - o
    b = wp.vec3d(geometry.vertices[v[1]]) - o
    c = wp.vec3d(geometry.vertices[v[2]]) - o
    u0 = directed_volume(d, b, c, v[1], v[2])
    u1 = directed_volume(d, c, a, v[2], v[0])
    u2 = directed_volume(d, a, b, v[0], v[1])
    zero = wp.float64(0.0)
    inside = (u0 >= zero and u1 >= zero and u2 >= zero) or (u0 <= zero and u1 <= zero and u2 <= zero)
    if not inside or u0 + u1 + u2 == zero:
        return MISS
    n = wp.cross(b - a, c - a)
    return wp.float32(wp.dot(a, n) / wp.dot(d, n))


@wp.func
def keep_nearest(face: wp.array2d(dtype=int), at: wp.array2d(dtype=float), i: int, found: int, f: int, t: float):
    """Insert face `f` at `t` into row `i`, sorted by |t|, after `found` faces so far; the nearest are kept."""
    capacity = face.shape[1]
    slot = wp.min(found, capacity)
    while slot > 0 and wp.abs(at[i, slot - 1]) > wp.abs(t):
        if slot < capacity:
            at[i, slot] = at[i, slot - 1]
            face[i, slot] = face[i, slot - 1]
        slot -= 1
    if slot < capacity:
        at[i, slot] = t
        face[i, slot] = f


@wp.kernel
def projections(
    bvh: wp.uint64,
    start: int,
    geometry: Geometry,
    face_shape: wp.array(dtype=int),
    lines: Lines,
    face: wp.array2d(dtype=int),
    height: wp.array2d(dtype=float),
    count: wp.array(dtype=int),
):
    """Faces of a shape that a line crosses within `depth` of a point; the nearest are kept, sorted."""
    i = start + wp.tid()
    count[i] = 0
    depth = lines.depth[i]
    if depth <= 0.0:
        return
    normal = lines.normal[i]
    begin = lines.point[i] - depth * normal
    o = wp.vec3d(begin)
    d = wp.vec3d(normal)
    found = int(0)
    f = int(0)
    query = wp.bvh_query_ray(bvh, begin, normal)
    while wp.bvh_query_next(query, f, 2.0 * depth):
        if face_shape[f] == lines.shape[i]:
            h = crossing(geometry, f, o, d) - depth
            if wp.abs(h) < depth:
                keep_nearest(face, height, i, found, f, h)
                found += 1
    count[i] = found


@wp.func
def all_on_one_side(
    vertices: wp.array(dtype=wp.vec3),
    opposite: wp.array2d(dtype=int),
    edge: int,
    p0: wp.vec3,
    p1: wp.vec3,
    plane: wp.vec3,
    apex: wp.vec3,
):
    """+1 or -1 if all faces of an edge lie on this side of the plane through apex and edge, else 0.

    Faces that contain the apex, up to rounding, are on neither side: such a face has its horizon where the next face
    bends away.
    """
    rounding = 5.0e-7 * wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(apex))) + 1.0e-6 * wp.length(p0 - apex)
    limit = rounding * wp.length(p1 - p0)
    side = float(0.0)
    for k in range(opposite.shape[1]):
        v = opposite[edge, k]
        if v >= 0:
            offset = vertices[v] - p0
            height = wp.dot(plane, offset)
            if wp.abs(height) > limit * wp.length(offset):
                if height * side < 0.0:
                    return 0.0
                side = wp.sign(height)
    return side


@wp.func
def keeps(segment: int, element: int, seed: int, probability: float):
    """Unbiased thinning: whether this (segment, element) pair survives. It is a hash, so the choice is reproducible."""
    if probability >= 1.0:
        return True
    return wp.randf(wp.rand_init(seed + 977 * element, segment)) < probability


@wp.func
def kernel_reach(radius: float, magnification: float, widest: float):
    """Kernel radius at the target: the radius at the edge, magnified by the projection, up to `widest`."""
    return wp.max(radius, wp.min(radius * magnification, widest))


@wp.func
def near_silhouette(
    vertices: wp.array(dtype=wp.vec3),
    opposite: wp.array2d(dtype=int),
    edge: int,
    p0: wp.vec3,
    p1: wp.vec3,
    a: wp.vec3,
    b: wp.vec3,
    n: wp.vec3,
    height: float,
    radius: float,
    widest: float,
    both_sides: int,
):
    """Whether an edge is a silhouette from `a` whose projection onto the plane (b, n) passes within the kernel."""
    if radius <= 0.0:
        return False
    plane = wp.cross(p0 - a, p1 - p0)
    side = all_on_one_side(vertices, opposite, edge, p0, p1, plane, a)
    if side == 0.0 or (both_sides == 0 and side * wp.dot(plane, b - a) >= 0.0):
        return False
    # The part of the edge between the apex and the target's plane (0 < f <= 1), projected.
    f0 = wp.dot(n, p0 - a) / height
    f1 = wp.dot(n, p1 - a) / height
    if wp.min(f0, f1) >= 1.0 or wp.max(f0, f1) <= 1.0e-6:
        return False
    c0 = wp.clamp(f0, 1.0e-6, 1.0)
    c1 = wp.clamp(f1, 1.0e-6, 1.0)
    q0 = p0
    q1 = p1
    if c0 != f0:
        q0 = p0 + (c0 - f0) / (f1 - f0) * (p1 - p0)
    if c1 != f1:
        q1 = p1 + (c1 - f1) / (f0 - f1) * (p0 - p1)
    m0 = a + (q0 - a) / c0
    line = a + (q1 - a) / c1 - m0
    length = wp.length(line)
    s = wp.dot(b - m0, line) / length
    if s < 0.0 or s >= length:
        return False
    share = s / length
    # 1/f is linear along the projected edge.
    reach = kernel_reach(radius, (1.0 - share) / c0 + share / c1, widest)
    return wp.length(b - m0 - share * line) < reach


@wp.func
def faces_all_alike(to_center: wp.vec3, size: float, axis: wp.vec3, cosine: float):
    """Whether all faces at the edges of a node face the apex, or all face away: then it holds no silhouette.

    The node, of radius `size`, spans the angle beta around its centre. Let alpha be the half-angle of the cone of the
    faces' normals. All faces face alike if the angle between axis and view differs from 90 degrees by more than
    alpha + beta.
    """
    clear2 = wp.dot(to_center, to_center) - size * size
    if cosine <= 0.0 or clear2 <= 0.0:
        return False
    clear = wp.sqrt(clear2)  # distance x cos(beta); `size` is distance x sin(beta)
    sine = wp.sqrt(wp.max(0.0, 1.0 - cosine * cosine))
    if cosine * clear <= sine * size:
        return False
    return wp.abs(wp.dot(axis, to_center)) > sine * clear + cosine * size


@wp.func
def after(node: int):
    """The node after the subtree of one: n + 1, divided by 2 until it is odd; 0 after the last."""
    following = node + 1
    while following % 2 == 0:
        following = following // 2
    if following == 1:
        following = 0
    return following


@wp.func
def part(row: wp.vec4):
    """The first three numbers of a row."""
    return wp.vec3(row[0], row[1], row[2])


@wp.func
def may_hold_silhouettes(
    center: wp.vec3,
    size: float,
    extent: wp.vec3,
    axis: wp.vec3,
    cosine: float,
    radius: float,
    apex: wp.vec3,
    along: wp.vec3,
    length: float,
    widest: float,
):
    """Whether a node of the edge tree reaches into a segment's kernel, and its faces do not all face alike.

    The kernel around the segment (apex, unit `along`, `length`) has the radius `radius` at an edge, but at most
    `widest` after projection to the far end. So it is a cone near the apex, and a tube further on.
    """
    to_center = center - apex
    t = wp.dot(to_center, along)
    reach_t = wp.dot(extent, wp.vec3(wp.abs(along[0]), wp.abs(along[1]), wp.abs(along[2])))
    far_reach = wp.max(radius, widest)
    fraction = float(1.0)
    if far_reach < length:
        if t + reach_t < 0.0:
            return False
        fraction = wp.min(1.0, (t + reach_t) / (length - far_reach))
    if t - reach_t > length + far_reach:
        return False
    distance = wp.length(to_center - t * along)
    if distance - size > wp.max(radius * fraction, wp.min(radius, widest * fraction)):
        return False
    return not faces_all_alike(to_center, size, axis, cosine)


@wp.kernel
def edge_candidates(
    start: int,
    geometry: Geometry,
    edges: EdgeSet,
    tree: EdgeTree,
    strips: StripQuery,
    options: wp.array(dtype=int),
    probability: float,
    segment_out: wp.array(dtype=int),
    edge_out: wp.array(dtype=int),
    found: wp.array(dtype=int),
):
    """Silhouette edges whose projection from the apex onto the target's plane passes within the kernel radius.

    An edge of `rank` (radius) <= 0 is left out, as is a segment of `scale` <= 0. `options` = [seed, both_sides];
    `found` = [kept, all]. The tree is walked without a stack. Nodes are numbered from 1, and the children of n are 2n
    and 2n + 1. After the subtree of n comes `after(n)`.
    """
    i = start + wp.tid()
    if strips.scale[i] <= 0.0:
        return
    a = strips.apex[i]
    b = strips.target[i]
    n = strips.normal[i]
    widest = strips.widest[i]
    height = wp.dot(n, b - a)
    length = wp.length(b - a)
    along = (b - a) / length
    nodes = tree.node.shape[0]
    leaves = nodes // 2
    node = int(1)
    while node > 0:
        inside = bool(False)
        box = tree.node[node, 1]
        if box[3] > 0.0:
            middle = tree.node[node, 0]
            cone = tree.node[node, 2]
            inside = may_hold_silhouettes(
                part(middle),
                middle[3],
                part(box),
                part(cone),
                cone[3],
                box[3] * strips.scale[i],
                a,
                along,
                length,
                widest,
            )
        if inside and node < leaves:
            node = 2 * node
        else:
            if inside:
                first = (node - leaves) * LEAF
                for k in range(LEAF):
                    e = tree.edge[first + k]
                    if e >= 0:
                        p0 = geometry.vertices[edges.ends[e][0]]
                        p1 = geometry.vertices[edges.ends[e][1]]
                        r = edges.rank[e] * strips.scale[i]
                        if near_silhouette(
                            geometry.vertices,
                            edges.opposite,
                            e,
                            p0,
                            p1,
                            a,
                            b,
                            n,
                            height,
                            r,
                            widest,
                            options[1],
                        ):
                            wp.atomic_add(found, 1, 1)
                            if keeps(i, e, options[0], probability):
                                j = wp.atomic_add(found, 0, 1)
                                if j < segment_out.shape[0]:
                                    segment_out[j] = i
                                    edge_out[j] = e
            node = after(node)


@wp.kernel
def point_candidates(
    bvh: wp.uint64,
    start: int,
    geometry: Geometry,
    edges: EdgeSet,
    points: EdgePoints,
    strips: StripQuery,
    options: wp.array(dtype=int),
    probability: float,
    segment_out: wp.array(dtype=int),
    point_out: wp.array(dtype=int),
    found: wp.array(dtype=int),
):
    """Points on silhouette edges whose projection onto the target's plane lies in the disc around the target.

    `options` and `found` are as in `edge_candidates`.
    """
    i = start + wp.tid()
    if strips.scale[i] <= 0.0:
        return
    a = strips.apex[i]
    b = strips.target[i]
    n = strips.normal[i]
    height = wp.dot(n, b - a)
    j = int(0)
    query = wp.bvh_query_ray(bvh, a, b - a)
    while wp.bvh_query_next(query, j, 1.0):
        e = points.edge[j]
        r = points.radius[j] * strips.scale[i]
        p0 = geometry.vertices[edges.ends[e][0]]
        p1 = geometry.vertices[edges.ends[e][1]]
        plane = wp.cross(p0 - a, p1 - p0)
        side = all_on_one_side(geometry.vertices, edges.opposite, e, p0, p1, plane, a)
        if r > 0.0 and side != 0.0 and (options[1] != 0 or side * wp.dot(plane, b - a) < 0.0):
            f = wp.dot(n, points.position[j] - a) / height
            if f > 1.0e-6 and f <= 1.0:
                if wp.length(a + (points.position[j] - a) / f - b) < kernel_reach(r, 1.0 / f, strips.widest[i]):
                    wp.atomic_add(found, 1, 1)
                    if keeps(i, j, options[0], probability):
                        k = wp.atomic_add(found, 0, 1)
                        if k < segment_out.shape[0]:
                            segment_out[k] = i
                            point_out[k] = j
