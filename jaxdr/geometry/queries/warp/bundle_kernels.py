"""Warp kernel that draws, for each bundle of rays, one of the edges that it may cross.

The same walk and the same arithmetic as `queries.jax.bundles`, which is the reference of the tests.
"""

import warp as wp

from jaxdr.geometry import bundles as bundle_of_rays
from jaxdr.geometry import edge_tree
from jaxdr.geometry.queries.warp.kernels import after, part
from jaxdr.geometry.queries.warp.records import Bundles, EdgeTable, EdgeTree

wp.set_module_options({"enable_backward": False})

LEAF = wp.constant(edge_tree.LEAF)
BEYOND = wp.constant(wp.float32(bundle_of_rays.BEYOND))
MARGIN = wp.constant(wp.float32(bundle_of_rays.MARGIN))


@wp.func
def within(
    origin: wp.vec3,
    direction: wp.vec3,
    origin_speed: float,
    direction_speed: float,
    end: float,
    point: wp.vec3,
    radius: float,
    reach: float,
):
    """See `geometry.bundles.within`."""
    offset = point - origin
    depth = wp.dot(offset, direction)
    across = wp.length(offset - depth * direction)
    far = wp.clamp(depth + radius, 0.0, BEYOND * end)
    width = (1.0 + MARGIN) * reach * (origin_speed + far * direction_speed)
    return depth >= -radius and depth <= BEYOND * end + radius and across <= width + radius


@wp.func
def may_cross(
    o: wp.vec3,
    d: wp.vec3,
    origin_rate: wp.vec3,
    direction_rate: wp.vec3,
    end: float,
    start: wp.vec3,
    side: wp.vec3,
    reach: float,
):
    """See `geometry.bundles.may_cross`."""
    across = wp.cross(d, side)
    rate = wp.dot(wp.cross(direction_rate, side), start - o) - wp.dot(across, origin_rate)
    if rate == 0.0:
        return False
    t = -wp.dot(across, start - o) / rate
    if wp.abs(t) > MARGIN * reach:
        return False
    moved = d + t * direction_rate
    normal = wp.cross(moved, side)
    squared = wp.dot(normal, normal)
    if squared <= 0.0:
        squared = 1.0
    along = wp.dot(wp.cross(start - o - t * origin_rate, moved), normal) / squared
    if along < 0.0 or along > 1.0:
        return False
    return within(o, d, wp.length(origin_rate), wp.length(direction_rate), end, start + along * side, 0.0, reach)


@wp.func
def hashed(seed: int, edge: int):
    """A uniform number in [0, 1) for a bundle and an edge (the output function of PCG, O'Neill 2014, twice)."""
    word = wp.uint32(seed) ^ (wp.uint32(edge) * wp.uint32(0x9E3779B9))
    for _ in range(2):
        word = word * wp.uint32(747796405) + wp.uint32(2891336453)
        word = ((word >> ((word >> wp.uint32(28)) + wp.uint32(4))) ^ word) * wp.uint32(277803737)
        word = (word >> wp.uint32(22)) ^ word
    return float(word >> wp.uint32(8)) * 5.9604645e-8


@wp.kernel
def draw_edges(
    start: int,
    table: EdgeTable,
    tree: EdgeTree,
    bundles: Bundles,
    seed: wp.array(dtype=int),
    reach: wp.array(dtype=float),
    edge_out: wp.array(dtype=int),
    importance_out: wp.array(dtype=float),
    total_out: wp.array(dtype=float),
):
    """The tree is walked without a stack, as in `kernels.edge_candidates`."""
    i = start + wp.tid()
    chosen = int(0)
    of_chosen = float(0.0)
    total = float(0.0)
    node = int(0)
    end = bundles.end[i]
    if end > 0.0:
        node = 1
    o = bundles.origin[i]
    d = bundles.direction[i]
    origin_rate = bundles.origin_rate[i]
    direction_rate = bundles.direction_rate[i]
    origin_speed = wp.length(origin_rate)
    direction_speed = wp.length(direction_rate)
    leaves = tree.node.shape[0] // 2
    while node > 0:
        inside = bool(False)
        if tree.node[node, 1][3] > 0.0:
            box = tree.node[node, 0]
            inside = within(o, d, origin_speed, direction_speed, end, part(box), box[3], reach[0])
        if inside and node < leaves:
            node = 2 * node
        else:
            if inside:
                for k in range(LEAF):
                    e = tree.edge[(node - leaves) * LEAF + k]
                    if e >= 0:
                        importance = table.importance[e]
                        p0 = table.ends[e, 0]
                        crosses = may_cross(o, d, origin_rate, direction_rate, end, p0, table.ends[e, 1] - p0, reach[0])
                        if importance > 0.0 and crosses:
                            one = wp.dot(table.normals[e, 0], d) > 0.0
                            other = wp.dot(table.normals[e, 1], d) > 0.0
                            if table.interior[e] == 0 or one != other:
                                importance = 1.0
                            total += importance
                            if hashed(seed[i], e) < importance / total:
                                chosen = e
                                of_chosen = importance
            node = after(node)
    edge_out[i] = chosen
    importance_out[i] = of_chosen
    total_out[i] = total
