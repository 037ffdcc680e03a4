"""Warp kernels that refit bounding volumes: the tree over edges level by level, and boxes of faces.

The tree is that of `edge_tree.build_edge_tree`, which is slower and the reference of the tests.
"""

import warp as wp

from jaxdr.geometry import edge_tree
from jaxdr.geometry.queries.warp.records import EdgeSet, Geometry

wp.set_module_options({"enable_backward": False})

LEAF = wp.constant(edge_tree.LEAF)
INFINITY = wp.constant(wp.float32(3.0e38))
EPSILON = wp.constant(wp.float32(1.1920929e-07))
HALF_PI = wp.constant(wp.float32(1.5707963))


@wp.struct
class Node:
    """Box, cone of normals (cosine of its half-angle, -1 without a cone) and largest radius, 0 if no edge counts."""

    lower: wp.vec3
    upper: wp.vec3
    axis: wp.vec3
    cosine: float
    radius: float


NODE_WORDS = wp.types.type_size_in_bytes(Node) // 4


@wp.func
def nothing():
    node = Node()
    node.lower = wp.vec3(INFINITY, INFINITY, INFINITY)
    node.upper = wp.vec3(-INFINITY, -INFINITY, -INFINITY)
    node.axis = wp.vec3(0.0, 0.0, 0.0)
    node.cosine = 1.0
    node.radius = 0.0
    return node


@wp.func
def angle_of(cosine: float):
    return wp.acos(wp.clamp(cosine, -1.0, 1.0))


@wp.func
def union(a: Node, b: Node):
    """The box around both boxes, and a cone around both cones, a little wider because the arithmetic rounds."""
    if a.radius <= 0.0:
        return b
    if b.radius <= 0.0:
        return a
    node = Node()
    node.lower = wp.min(a.lower, b.lower)
    node.upper = wp.max(a.upper, b.upper)
    node.radius = wp.max(a.radius, b.radius)
    node.axis = wp.normalize(a.axis + b.axis)
    angle_a = angle_of(wp.dot(node.axis, a.axis)) + angle_of(a.cosine)
    angle_b = angle_of(wp.dot(node.axis, b.axis)) + angle_of(b.cosine)
    angle = wp.max(angle_a, angle_b)
    node.cosine = -1.0
    if wp.length_sq(node.axis) > 0.0 and angle < HALF_PI:
        node.cosine = wp.cos(angle) - 1.0e-5
    return node


@wp.func
def turned_by_rounding(p0: wp.vec3, p1: wp.vec3, p2: wp.vec3):
    """Angle by which rounding of the coordinates may turn the normal of a face: large for slivers."""
    side0 = p1 - p0
    side1 = p2 - p0
    area = wp.length(wp.cross(side0, side1))
    if area <= 0.0:
        return 2.0 * HALF_PI
    largest = wp.max(wp.max(wp.abs(p0)), wp.max(wp.abs(p2)))
    return 4.0 * EPSILON * largest * (wp.length(side0) + wp.length(side1)) / area


@wp.func
def edge_node(p0: wp.vec3, p1: wp.vec3, q0: wp.vec3, q1: wp.vec3, interior: bool, radius: float):
    """The node of one edge; `q0`, `q1`: third corners of its faces. Edges that are not interior have no cone."""
    node = nothing()
    if radius > 0.0:
        node.lower = wp.min(p0, p1)
        node.upper = wp.max(p0, p1)
        node.radius = radius
        node.cosine = -1.0
        if interior:
            n0 = wp.normalize(wp.cross(p1 - p0, q0 - p0))
            n1 = wp.normalize(wp.cross(p0 - p1, q1 - p1))
            node.axis = wp.normalize(n0 + n1)
            slack = wp.max(turned_by_rounding(p0, p1, q0), turned_by_rounding(p1, p0, q1))
            angle = angle_of(wp.dot(node.axis, n0)) + slack
            if wp.length_sq(node.axis) > 0.0 and angle < HALF_PI:
                node.cosine = wp.cos(angle)
    return node


@wp.func
def store(nodes: wp.array(dtype=Node), rows: wp.array2d(dtype=wp.vec4), i: int, node: Node):
    """Store a node in two forms: for further merging, and as queries read it."""
    nodes[i] = node
    lower = node.lower
    upper = node.upper
    if node.radius <= 0.0:
        lower = wp.vec3(0.0, 0.0, 0.0)
        upper = lower
    center = 0.5 * (lower + upper)
    extent = wp.max(upper - center, center - lower)  # halves of the sum and of the difference round differently
    rows[i, 0] = wp.vec4(center[0], center[1], center[2], wp.length(extent))
    rows[i, 1] = wp.vec4(extent[0], extent[1], extent[2], node.radius)
    rows[i, 2] = wp.vec4(node.axis[0], node.axis[1], node.axis[2], node.cosine)


@wp.kernel
def tree_leaves(
    start: int,
    slots: wp.array(dtype=int),
    geometry: Geometry,
    edges: EdgeSet,
    nodes: wp.array(dtype=Node),
    rows: wp.array2d(dtype=wp.vec4),
):
    leaf = start + wp.tid()
    node = nothing()
    pair = nothing()
    for k in range(LEAF):
        one = nothing()
        e = slots[leaf * LEAF + k]
        if e >= 0:
            p0 = geometry.vertices[edges.ends[e][0]]
            p1 = geometry.vertices[edges.ends[e][1]]
            q0 = p0
            q1 = p1
            if edges.interior[e] != 0:
                q0 = geometry.vertices[edges.opposite[e, 0]]
                q1 = geometry.vertices[edges.opposite[e, 1]]
            one = edge_node(p0, p1, q0, q1, edges.interior[e] != 0, edges.rank[e])
        # Merge in pairs: cones grow least if similar edges are merged first.
        if k % 2 == 0:
            pair = one
        else:
            node = union(node, union(pair, one))
    store(nodes, rows, rows.shape[0] // 2 + leaf, node)


@wp.kernel
def tree_parents(start: int, first: int, nodes: wp.array(dtype=Node), rows: wp.array2d(dtype=wp.vec4)):
    """Nodes of one level, from number `first` on, from their children."""
    i = first + start + wp.tid()
    store(nodes, rows, i, union(nodes[2 * i], nodes[2 * i + 1]))


@wp.func
def face_box(vertices: wp.array(dtype=wp.vec3), face: wp.vec3i, margin: float):
    """(lower, upper) ends of the box of a face, grown by a margin."""
    a = vertices[face[0]]
    b = vertices[face[1]]
    c = vertices[face[2]]
    grown = wp.vec3(margin, margin, margin)
    return wp.min(wp.min(a, b), c) - grown, wp.max(wp.max(a, b), c) + grown


@wp.kernel
def face_boxes(
    start: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    margin: float,
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    f = start + wp.tid()
    low, high = face_box(vertices, faces[f], margin)
    lower[f] = low
    upper[f] = high


@wp.kernel
def point_boxes(
    start: int,
    point: wp.array(dtype=wp.vec3),
    radius: wp.array(dtype=float),
    lower: wp.array(dtype=wp.vec3),
    upper: wp.array(dtype=wp.vec3),
):
    i = start + wp.tid()
    grown = wp.max(radius[i], 0.0)
    lower[i] = point[i] - wp.vec3(grown, grown, grown)
    upper[i] = point[i] + wp.vec3(grown, grown, grown)


@wp.kernel
def corners_at_box_ends(
    start: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    margin: float,
    points: wp.array(dtype=wp.vec3),
):
    """Three points for each face that span its box: twice the lower end, then the upper end."""
    f = start + wp.tid()
    low, high = face_box(vertices, faces[f], margin)
    points[3 * f] = low
    points[3 * f + 1] = low
    points[3 * f + 2] = high


@wp.kernel
def face_corners(
    start: int,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3),
):
    f = start + wp.tid()
    for k in range(3):
        points[3 * f + k] = vertices[faces[f][k]]
