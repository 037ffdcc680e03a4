"""Warp kernels that find all silhouette edges in cones of directions, or the one nearest to the axis in angle.

The same arithmetic as `queries.jax.cones`, which is the reference of the tests.
"""

import warp as wp

from jaxdr.geometry import edge_tree
from jaxdr.geometry.queries import records as plain
from jaxdr.geometry.queries.warp.kernels import after, all_on_one_side, faces_all_alike, keeps, part
from jaxdr.geometry.queries.warp.records import ConeQuery, EdgeSet, EdgeTree, Geometry

wp.set_module_options({"enable_backward": False})

LEAF = wp.constant(edge_tree.LEAF)
BESIDE = wp.constant(wp.float32(plain.BESIDE))
NEVER = wp.constant(wp.float32(3.0e38))
SLACK = wp.constant(wp.float32(2.0e-6))  # radians: rounding of the bounds


@wp.func
def angle_between(a: wp.vec3, b: wp.vec3):
    """The angle between unit vectors, exact for small ones."""
    return 2.0 * wp.asin(wp.min(1.0, 0.5 * wp.length(a - b)))


@wp.func
def nearest_on_arc(w: wp.vec3, first: wp.vec3, last: wp.vec3):
    """The fraction along an edge, between offsets from the apex, of its point nearest to direction `w` in angle."""
    side = last - first
    normal = wp.cross(first, side)
    to_first = wp.dot(wp.cross(w, last), normal)
    to_last = wp.dot(wp.cross(first, w), normal)
    if to_first >= 0.0 and to_last >= 0.0 and to_first + to_last > 0.0:
        return to_last / (to_first + to_last)
    if wp.dot(w, wp.normalize(last)) > wp.dot(w, wp.normalize(first)):
        return 1.0
    return 0.0


@wp.func
def has_silhouettes(tree: EdgeTree, node: int, apex: wp.vec3, normal: wp.vec3, horizon: float):
    """Whether a node may have silhouettes above the horizon."""
    box = tree.node[node, 1]
    if box[3] <= 0.0:
        return False
    middle = tree.node[node, 0]
    cone = tree.node[node, 2]
    offset = part(middle) - apex
    if faces_all_alike(offset, middle[3], part(cone), cone[3]):
        return False
    reach = wp.dot(part(box), wp.vec3(wp.abs(normal[0]), wp.abs(normal[1]), wp.abs(normal[2])))
    return wp.length_sq(normal) == 0.0 or wp.dot(normal, offset) + reach > horizon


@wp.func
def least_angle(tree: EdgeTree, node: int, apex: wp.vec3, w: wp.vec3, normal: wp.vec3, horizon: float):
    """A lower bound of the angles from `w` to silhouettes of a node; NEVER if it has none above the horizon."""
    if not has_silhouettes(tree, node, apex, normal, horizon):
        return NEVER
    middle = tree.node[node, 0]
    offset = part(middle) - apex
    size = middle[3]
    distance = wp.length(offset)
    if distance <= size:
        return 0.0
    return angle_between(w, offset / distance) - wp.asin(size / distance) - SLACK


@wp.kernel
def closest_silhouettes(
    start: int,
    geometry: Geometry,
    edges: EdgeSet,
    tree: EdgeTree,
    cones: ConeQuery,
    edge_out: wp.array(dtype=int),
    along_out: wp.array(dtype=float),
):
    """The tree is walked depth first, the nearer child first, without a stack.

    `trail` has a bit for each level below the root: whether the sibling of the node on the way waits to be visited.
    """
    i = start + wp.tid()
    best = cones.reach[i]
    closest = int(-1)
    fraction = float(0.0)
    apex = cones.apex[i]
    w = cones.direction[i]
    normal = cones.normal[i]
    largest = wp.max(wp.abs(apex))
    leaves = tree.node.shape[0] // 2
    trail = int(0)
    node = int(0)
    if best > 0.0:
        node = 1
    while node > 0:
        down = bool(False)
        if least_angle(tree, node, apex, w, normal, BESIDE * largest) < best:
            if node < leaves:
                here = least_angle(tree, 2 * node, apex, w, normal, BESIDE * largest)
                there = least_angle(tree, 2 * node + 1, apex, w, normal, BESIDE * largest)
                trail = trail << 1
                if wp.max(here, there) < best:
                    trail = trail | 1
                node = 2 * node
                if there < here:
                    node = node + 1
                down = True
            else:
                for k in range(LEAF):
                    e = tree.edge[(node - leaves) * LEAF + k]
                    if e >= 0 and edges.rank[e] > 0.0:
                        p0 = geometry.vertices[edges.ends[e][0]]
                        p1 = geometry.vertices[edges.ends[e][1]]
                        first = p0 - apex
                        last = p1 - apex
                        horizon = BESIDE * wp.max(largest, wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(p1))))
                        above = wp.max(wp.dot(normal, first), wp.dot(normal, last)) > horizon
                        if above or wp.length_sq(normal) == 0.0:
                            t = nearest_on_arc(w, first, last)
                            angle = angle_between(w, wp.normalize(first + t * (last - first)))
                            plane = wp.cross(first, p1 - p0)
                            if angle < best:
                                if all_on_one_side(geometry.vertices, edges.opposite, e, p0, p1, plane, apex) != 0.0:
                                    best = angle
                                    closest = e
                                    fraction = t
        if not down:
            while node > 1 and (trail & 1) == 0:
                node = node >> 1
                trail = trail >> 1
            if node > 1:
                node = node ^ 1
                trail = trail ^ 1
            else:
                node = 0
    edge_out[i] = closest
    along_out[i] = fraction


@wp.kernel
def silhouettes(
    start: int,
    geometry: Geometry,
    edges: EdgeSet,
    tree: EdgeTree,
    cones: ConeQuery,
    options: wp.array(dtype=int),
    probability: float,
    cone_out: wp.array(dtype=int),
    edge_out: wp.array(dtype=int),
    found: wp.array(dtype=int),
):
    """All silhouette edges in each cone. `options` = [seed]; `found` = [kept, all].

    Cones of pi and more have every direction: then no angle is computed.
    """
    i = start + wp.tid()
    reach = cones.reach[i]
    apex = cones.apex[i]
    w = cones.direction[i]
    normal = cones.normal[i]
    all_around = reach >= wp.pi
    largest = wp.max(wp.abs(apex))
    leaves = tree.node.shape[0] // 2
    node = int(0)
    if reach > 0.0:
        node = 1
    while node > 0:
        inside = bool(False)
        if all_around:
            inside = has_silhouettes(tree, node, apex, normal, BESIDE * largest)
        else:
            inside = least_angle(tree, node, apex, w, normal, BESIDE * largest) < reach
        if inside and node < leaves:
            node = 2 * node
        else:
            if inside:
                for k in range(LEAF):
                    e = tree.edge[(node - leaves) * LEAF + k]
                    if e >= 0 and edges.rank[e] > 0.0:
                        p0 = geometry.vertices[edges.ends[e][0]]
                        p1 = geometry.vertices[edges.ends[e][1]]
                        first = p0 - apex
                        last = p1 - apex
                        horizon = BESIDE * wp.max(largest, wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(p1))))
                        above = wp.max(wp.dot(normal, first), wp.dot(normal, last)) > horizon
                        if above or wp.length_sq(normal) == 0.0:
                            close = all_around
                            if not close:
                                t = nearest_on_arc(w, first, last)
                                close = angle_between(w, wp.normalize(first + t * (last - first))) < reach
                            if close:
                                plane = wp.cross(first, p1 - p0)
                                if all_on_one_side(geometry.vertices, edges.opposite, e, p0, p1, plane, apex) != 0.0:
                                    wp.atomic_add(found, 1, 1)
                                    if keeps(i, e, options[0], probability):
                                        slot = wp.atomic_add(found, 0, 1)
                                        if slot < cone_out.shape[0]:
                                            cone_out[slot] = i
                                            edge_out[slot] = e
            node = after(node)
