"""Warp kernel that finds where silhouettes cut planar sectors, and which of the crossings bound what is visible.

Only signs decide about visibility: of a number for each face (does it face the apex), and of a number for each vertex
(on which side of the sector's plane is it). These numbers are computed in double precision from the vertices in stored
order. So neighbouring faces and edges agree on them, and the counts of layers are consistent, even where a mesh folds
within rounding.
"""

import warp as wp

from jaxdr.geometry import edge_tree
from jaxdr.geometry.queries import records
from jaxdr.geometry.queries.warp.kernels import after, faces_all_alike, keeps, part
from jaxdr.geometry.queries.warp.records import EdgeSet, EdgeTree, Geometry, SectorQuery

wp.set_module_options({"enable_backward": False})  # answers are discrete: no derivative to compile

LEAF = wp.constant(edge_tree.LEAF)
MOST = 32  # crossings of a chord that are sorted in one walk; more crossings need more walks
BESIDE = wp.constant(records.BESIDE)

_Places = wp.types.vector(length=MOST, dtype=wp.float64)
_Edges = wp.types.vector(length=MOST, dtype=wp.int32)
_Capacity = wp.constant(MOST)


@wp.func
def oriented_volume(geometry: Geometry, face: int, apex: wp.vec3d):
    """Six times the signed volume of apex and face. Its sign tells on which side of the face the apex is."""
    v = geometry.faces[face]
    p = wp.vec3d(geometry.vertices[v[0]]) - apex
    q = wp.vec3d(geometry.vertices[v[1]]) - apex
    r = wp.vec3d(geometry.vertices[v[2]]) - apex
    return wp.dot(p, wp.cross(q, r))


@wp.func
def faces_on_side(
    geometry: Geometry,
    edges: EdgeSet,
    edge: int,
    v0: int,
    v1: int,
    apex: wp.vec3d,
):
    """(faces at an edge on the positive side of the plane through apex and edge, faces on the negative side).

    The positive side is that of cross(p0 - apex, p1 - apex).
    """
    positive = int(0)
    negative = int(0)
    for k in range(edges.faces.shape[1]):
        f = edges.faces[edge, k]
        if f >= 0:
            v = geometry.faces[f]
            along = (v[0] == v0 and v[1] == v1) or (v[1] == v0 and v[2] == v1) or (v[2] == v0 and v[0] == v1)
            ahead = oriented_volume(geometry, f, apex) >= wp.float64(0.0)
            if along == ahead:
                positive += 1
            else:
                negative += 1
    return wp.vec2i(positive, negative)


@wp.func
def layers(
    bvh: wp.uint64,
    geometry: Geometry,
    face_group: wp.array(dtype=int),
    group: int,
    origin: wp.vec3,
    direction: wp.vec3,
    reach: float,
    most: int,
):
    """How many faces a ray crosses before `reach`, without those of one group; counting stops at `most`."""
    o = wp.vec3d(origin)
    d = wp.vec3d(direction)
    zero = wp.float64(0.0)
    count = int(0)
    f = int(0)
    query = wp.bvh_query_ray(bvh, origin, direction)
    while count < most and wp.bvh_query_next(query, f, reach):
        if group < 0 or face_group[f] != group:
            v = geometry.faces[f]
            a = wp.vec3d(geometry.vertices[v[0]]) - o
            b = wp.vec3d(geometry.vertices[v[1]]) - o
            c = wp.vec3d(geometry.vertices[v[2]]) - o
            # In the order of the edge's vertices, so that both faces at an edge agree.
            u0 = wp.where(v[1] < v[2], wp.dot(d, wp.cross(b, c)), -wp.dot(d, wp.cross(c, b)))
            u1 = wp.where(v[2] < v[0], wp.dot(d, wp.cross(c, a)), -wp.dot(d, wp.cross(a, c)))
            u2 = wp.where(v[0] < v[1], wp.dot(d, wp.cross(a, b)), -wp.dot(d, wp.cross(b, a)))
            if (u0 >= zero and u1 >= zero and u2 >= zero) or (u0 < zero and u1 < zero and u2 < zero):
                n = wp.cross(b - a, c - a)
                slope = wp.dot(d, n)
                if slope != zero:
                    t = wp.dot(a, n) / slope
                    if t > zero and t < wp.float64(reach):
                        count += 1
    return count


@wp.func
def may_cross(
    center: wp.vec3,
    extent: wp.vec3,
    plane: wp.vec3,
    side0: wp.vec3,
    side1: wp.vec3,
    far: wp.vec3,
    reach: float,
    rounding: float,
):
    """Whether a box (relative to the apex) reaches into the sector: its plane, its two sides, its far end."""
    if wp.abs(wp.dot(plane, center)) > wp.dot(wp.abs(plane), extent) + rounding:
        return False
    if wp.dot(side0, center) + wp.dot(wp.abs(side0), extent) < -rounding:
        return False
    if wp.dot(side1, center) + wp.dot(wp.abs(side1), extent) < -rounding:
        return False
    return wp.dot(far, center) - wp.dot(wp.abs(far), extent) <= reach + rounding


@wp.kernel
def sector_crossings(
    bvh: wp.uint64,
    start: int,
    geometry: Geometry,
    edges: EdgeSet,
    tree: EdgeTree,
    face_group: wp.array(dtype=int),
    sectors: SectorQuery,
    options: wp.array(dtype=int),
    probability: float,
    segment_out: wp.array(dtype=int),
    edge_out: wp.array(dtype=int),
    along_out: wp.array(dtype=float),
    found: wp.array(dtype=int),
):
    """Visible silhouette crossings of chords (`first`, `last`) seen from apexes; see `queries.sector_crossings`.

    `options` = [seed, least layer]; `found` = [kept, all, chords with inconsistent counts, chords of more than `MOST`
    crossings, nodes visited, rays]. The tree is walked without a stack, as in `kernels.edge_candidates`.
    """
    i = start + wp.tid()
    if sectors.needed[i] <= 0.0:
        return
    a = sectors.apex[i]
    ad = wp.vec3d(a)
    u0 = sectors.first[i] - a
    u1 = sectors.last[i] - a
    plane = wp.cross(u0, u1)
    if wp.length(plane) == 0.0:
        return
    plane = wp.normalize(plane)
    side0 = wp.normalize(wp.cross(plane, u0))
    side1 = wp.normalize(wp.cross(u1, plane))
    far = wp.normalize(wp.cross(u1 - u0, plane))
    reach = wp.dot(far, u0)
    bounded = bool(True)
    if sectors.group[i] < -1:
        bounded = bool(False)
        reach = 3.0e38
    # Double precision for the numbers that tell on which side of the sector's plane a vertex lies.
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    d0 = wp.vec3d(u0)
    d1 = wp.vec3d(u1)
    normal = wp.cross(d0, d1)
    area2 = wp.dot(normal, normal)
    magnitude = wp.max(wp.abs(a))

    nodes = tree.node.shape[0]
    leaves = nodes // 2
    places = _Places()
    crossed = _Edges()
    steps = _Edges()
    count = int(0)
    visited = int(0)
    cast = int(0)
    # Crossings are sorted along the chord, `MOST` at a time, and the number of layers is updated from one to the next.
    # If this number becomes negative, or if not all edges are looked at, a ray decides on each crossing (`by_rays`).
    by_rays = bool(False)
    least_layer = float(options[1])
    least = least_layer
    if not bounded or sectors.needed[i] > least_layer:
        by_rays = bool(True)
        least = sectors.needed[i]
    middle = wp.float64(sectors.centre[i])
    done_place = wp.float64(-1.0)
    done_edge = int(-1)
    now = int(0)
    walks = int(0)
    again = int(1)
    while again > 0:
        again = int(0)
        count = int(0)
        before_middle = int(0)
        node = int(1)
        while node > 0:
            visited += 1
            inside = bool(False)
            box = tree.node[node, 1]
            if box[3] >= least:
                ball = tree.node[node, 0]
                center = part(ball) - a
                rounding = 1.0e-6 * (magnitude + wp.max(wp.abs(center)))
                if may_cross(center, part(box), plane, side0, side1, far, reach, rounding):
                    cone = tree.node[node, 2]
                    inside = not faces_all_alike(center, ball[3], part(cone), cone[3])
            if inside and node < leaves:
                node = 2 * node
            else:
                if inside:
                    begin = (node - leaves) * LEAF
                    for k in range(LEAF):
                        e = tree.edge[begin + k]
                        if e >= 0:
                            if edges.rank[e] >= least:
                                v0 = edges.ends[e][0]
                                v1 = edges.ends[e][1]
                                p0 = wp.vec3d(geometry.vertices[v0]) - ad
                                p1 = wp.vec3d(geometry.vertices[v1]) - ad
                                h0 = wp.dot(normal, p0)
                                h1 = wp.dot(normal, p1)
                                if (h0 >= zero) != (h1 >= zero):
                                    along = h0 / (h0 - h1)
                                    x = p0 + along * (p1 - p0)
                                    alpha = wp.dot(wp.cross(x, d1), normal) / area2
                                    beta = wp.dot(wp.cross(d0, x), normal) / area2
                                    ends_there = bool(False)
                                    if bounded:
                                        ends_there = bool(alpha + beta >= one)
                                    if alpha > zero and beta > zero and not ends_there:
                                        sides = faces_on_side(geometry, edges, e, v0, v1, ad)
                                        own = bool(False)
                                        if sectors.group[i] >= 0:
                                            for m in range(edges.faces.shape[1]):
                                                f = edges.faces[e, m]
                                                if f >= 0:
                                                    if face_group[f] == sectors.group[i]:
                                                        own = bool(True)
                                        place = beta / (alpha + beta)
                                        ahead = place > done_place or (place == done_place and e > done_edge)
                                        if sides[0] != sides[1] and not own and ahead:
                                            if by_rays:
                                                # The other side can be seen past the edge only if all faces are on
                                                # one side.
                                                past_it = bool(sides[0] == 0 or sides[1] == 0)
                                                if past_it and edges.rank[e] >= sectors.needed[i]:
                                                    edge_normal = wp.normalize(wp.vec3(wp.cross(p0, p1)))
                                                    if sides[0] > 0:
                                                        edge_normal = -edge_normal
                                                    past = wp.vec3(x)
                                                    step = BESIDE * wp.max(magnitude, wp.max(wp.abs(past)))
                                                    past = past + step * edge_normal
                                                    ray_end = float(0.999)
                                                    if bounded:
                                                        past = past / float(alpha + beta)
                                                        ray_end = 1.0
                                                    cast += 1
                                                    hidden = layers(
                                                        bvh, geometry, face_group, sectors.group[i], a, past, ray_end, 1
                                                    )
                                                    if hidden == 0:
                                                        wp.atomic_add(found, 1, 1)
                                                        if keeps(i, e, options[0], probability):
                                                            j = wp.atomic_add(found, 0, 1)
                                                            if j < segment_out.shape[0]:
                                                                segment_out[j] = i
                                                                edge_out[j] = e
                                                                along_out[j] = float(along)
                                            else:
                                                # An edge that goes up through the plane is crossed from its positive
                                                # to its negative side on the way to `last`.
                                                hides = sides[0] - sides[1]
                                                if h1 >= zero:
                                                    hides = -hides
                                                if place < middle:
                                                    before_middle += hides
                                                slot = int(count)
                                                if count >= _Capacity:
                                                    slot = _Capacity - 1
                                                    if place > places[slot] or (
                                                        place == places[slot] and e > crossed[slot]
                                                    ):
                                                        slot = _Capacity
                                                if slot < _Capacity:
                                                    # Insertion sort.
                                                    while slot > 0 and (
                                                        places[wp.max(slot - 1, 0)] > place
                                                        or (
                                                            places[wp.max(slot - 1, 0)] == place
                                                            and crossed[wp.max(slot - 1, 0)] > e
                                                        )
                                                    ):
                                                        places[slot] = places[slot - 1]
                                                        crossed[slot] = crossed[slot - 1]
                                                        steps[slot] = steps[slot - 1]
                                                        slot -= 1
                                                    places[slot] = place
                                                    crossed[slot] = e
                                                    steps[slot] = hides
                                                count += 1
                node = after(node)
        if count > 0 and not by_rays:
            if walks == 0:
                # Quantitative invisibility: count the layers in front of the chord's centre, and go back to its start.
                towards = (1.0 - sectors.centre[i]) * u0 + sectors.centre[i] * u1
                cast += 1
                now = layers(bvh, geometry, face_group, sectors.group[i], a, towards, 1.0, 1000000) - before_middle
            walks += 1
            stored = wp.min(count, _Capacity)
            lowest = int(now)
            then = int(now)
            for k in range(stored):
                then += steps[k]
                lowest = wp.min(lowest, then)
            if lowest < 0:
                wp.atomic_add(found, 2, 1)
                by_rays = bool(True)
                again = int(1)
            else:
                for k in range(stored):
                    before = int(now)
                    now += steps[k]
                    e = crossed[k]
                    if (before == 0) != (now == 0) and edges.rank[e] >= sectors.needed[i]:
                        wp.atomic_add(found, 1, 1)
                        if keeps(i, e, options[0], probability):
                            j = wp.atomic_add(found, 0, 1)
                            if j < segment_out.shape[0]:
                                p0 = wp.vec3d(geometry.vertices[edges.ends[e][0]]) - ad
                                p1 = wp.vec3d(geometry.vertices[edges.ends[e][1]]) - ad
                                h0 = wp.dot(normal, p0)
                                h1 = wp.dot(normal, p1)
                                segment_out[j] = i
                                edge_out[j] = e
                                along_out[j] = float(h0 / (h0 - h1))
                if count > _Capacity:
                    if walks == 1:
                        wp.atomic_add(found, 3, 1)
                    done_place = places[_Capacity - 1]
                    done_edge = crossed[_Capacity - 1]
                    again = int(1)
    wp.atomic_add(found, 4, visited)
    wp.atomic_add(found, 5, cast)
