"""Ray queries in plain JAX: a reference for tests, for tiny scenes, and for devices that Warp does not support.

A loop visits faces or edges in blocks, so memory is rays x block and not rays x faces.
"""

import jax
import jax.numpy as jnp

from jaxdr import loops
from jaxdr.geometry.queries.jax.bundles import draw_edges  # noqa: F401
from jaxdr.geometry.queries.jax.cones import closest_silhouettes as closest_silhouettes
from jaxdr.geometry.queries.jax.cones import silhouette_angles
from jaxdr.geometry.queries.jax.edge_sides import side_of_faces
from jaxdr.geometry.queries.jax.intersections import face_intersections  # noqa: F401
from jaxdr.geometry.queries.jax.sector import sector_crossings  # noqa: F401
from jaxdr.geometry.vector import dot, norm

BLOCK = 32
MISS = 3.0e38


def _blocks(*arrays):
    """Rows padded with copies of row 0 to whole blocks, stacked as [blocks, BLOCK, ...], and the row numbers."""
    count = arrays[0].shape[0]
    index = jnp.arange(-(-count // BLOCK) * BLOCK).reshape(-1, BLOCK)
    source = jnp.where(index < count, index, 0)
    return index, source, tuple(a[source] for a in arrays)


def _edge_function(p, q, i, j):
    """Twice the signed area of the triangle (0, p, q) in the plane across the ray, in the order of the vertex indices.

    Then both faces of an edge get the same number up to its sign, also after rounding: no ray slips between them.
    """
    swap = i > j
    first, second = jnp.where(swap[..., None], q, p), jnp.where(swap[..., None], p, q)
    return jnp.where(swap, -1.0, 1.0) * (first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def _crossings(vertices, faces, origin, direction, reach):
    """(t [N, BLOCK] of every ray with every face of a block, MISS without a hit; areas opposite its corners).

    It is watertight (Woop et al. 2013). Corners are sheared into the plane across the ray one by one, so the faces
    around a vertex agree on its place. The test itself is done in this plane.
    """
    corners = vertices[faces]  # [B, 3, 3]
    largest = jnp.argmax(jnp.abs(direction), axis=1)

    def turned(v):
        """Coordinates [N, ...] in cyclic order with the largest of the direction last."""
        axis = largest.reshape(-1, *(1,) * (v.ndim - 1))
        x, y, z = v[..., :1], v[..., 1:2], v[..., 2:]
        return [jnp.where(axis == 0, p, jnp.where(axis == 1, q, r)) for p, q, r in ((y, z, x), (z, x, y), (x, y, z))]

    dx, dy, dz = turned(direction[:, None, None])
    x, y, z = turned(corners[None] - origin[:, None, None])  # [N, B, 3, 1]
    flat = jnp.concatenate([x - dx / dz * z, y - dy / dz * z], -1)
    a, b, c = (flat[:, :, k] for k in range(3))
    i, j, k = (faces[None, :, k] for k in range(3))
    u0 = _edge_function(b, c, j, k)
    u1 = _edge_function(c, a, k, i)
    u2 = _edge_function(a, b, i, j)
    inside = ((u0 >= 0) & (u1 >= 0) & (u2 >= 0)) | ((u0 <= 0) & (u1 <= 0) & (u2 <= 0))
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[None]
    slope = dot(direction[:, None], normal)
    t = dot(corners[None, :, 0] - origin[:, None], normal) / jnp.where(slope == 0, 1.0, slope)
    hit = inside & (u0 + u1 + u2 != 0) & (slope != 0) & (t > 0) & (t < reach[:, None])
    return jnp.where(hit, t, MISS), jnp.stack([u0, u1, u2], -1)


def closest_hit(geometry, rays):
    """(face, t, barycentric): the nearest face in front of each ray."""

    def visit(best, block):
        index, _, (f,) = block
        t, areas = _crossings(geometry.vertices, f, *rays)
        nearest = jnp.argmin(t, axis=1)[:, None]
        t = jnp.take_along_axis(t, nearest, 1)[:, 0]
        areas = jnp.take_along_axis(areas, nearest[..., None], 1)[:, 0]
        found = index[nearest[:, 0]], t, areas
        closer = t < best[1]
        columns = closer, closer, closer[:, None]
        return tuple(jnp.where(c, a, b) for c, a, b in zip(columns, found, best, strict=True)), None

    n = rays.reach.shape[0]
    start = (jnp.full(n, -1, jnp.int32), jnp.full(n, MISS, jnp.float32), jnp.ones((n, 3), jnp.float32))
    face, t, areas = loops.scan(visit, start, _blocks(geometry.faces))[0]
    return face, t, areas / areas.sum(-1, keepdims=True)


def occluded(geometry, rays):
    """Whether anything lies on the ray before its reach."""

    def visit(found, block):
        return found | (_crossings(geometry.vertices, block[2][0], *rays)[0] < MISS).any(1), None

    return loops.scan(visit, jnp.zeros(rays.reach.shape[0], bool), _blocks(geometry.faces))[0]


def projections(geometry, face_shape, lines, capacity):
    """(face [N, C], height [N, C], count [N]): see `queries.projections`."""
    point, normal, depth, shape = lines
    begin = point - depth[:, None] * normal

    def crossings(block):
        face, of = block
        t, _ = _crossings(geometry.vertices, face, begin, normal, 2.0 * depth)
        return jnp.where((t < MISS) & (of[None] == shape[:, None]), t - depth[:, None], MISS)

    return _nearest(crossings, _blocks(geometry.faces, face_shape), point.shape[0], capacity)


def _nearest(crossings, blocks, lines, capacity):
    """(face, t, count): the `capacity` crossings [N, C] of smallest |t| among those of all blocks, sorted by it."""

    def visit(kept, block):
        index, source, data = block
        t = jnp.where((index == source)[None], crossings(data), MISS)  # padding repeats row 0
        count = kept[2] + (t < MISS).sum(1, dtype=jnp.int32)
        face = jnp.broadcast_to(index[None], t.shape)
        t, face = jnp.concatenate([kept[1], t], 1), jnp.concatenate([kept[0], face], 1)
        order = jnp.argsort(jnp.abs(t), axis=1)[:, :capacity]
        t, face = jnp.take_along_axis(t, order, 1), jnp.take_along_axis(face, order, 1)
        return (jnp.where(t < MISS, face, -1), t, count), None

    start = (
        jnp.full((lines, capacity), -1, jnp.int32),
        jnp.full((lines, capacity), MISS, jnp.float32),
        jnp.zeros(lines, jnp.int32),
    )
    return loops.scan(visit, start, blocks)[0]


def _project(point, apex, height, normal):
    """(fraction of the way to the target's plane, projection onto that plane) of points [N, B, 3]."""
    offset = point - apex[:, None]
    f = dot(offset, normal[:, None]) / height[:, None]
    return f, apex[:, None] + offset / f[..., None]


def _reach(radius, magnification, widest):
    """Kernel radius at the target: the radius at the edge, magnified by the projection, up to `widest`."""
    return jnp.maximum(radius, jnp.minimum(radius * magnification, widest[:, None]))


def _gather(near, count, segment, element, index, source):
    """Append the pairs of a block to the compacted lists. Pairs beyond the capacity are counted but not stored."""
    near = near & (index == source)[None]
    position = count + jnp.cumsum(near.reshape(-1)).reshape(near.shape) - 1
    slot = jnp.where(near, position, segment.shape[0])
    rows = jnp.broadcast_to(jnp.arange(near.shape[0], dtype=jnp.int32)[:, None], near.shape)
    segment = segment.at[slot].set(rows, mode="drop")
    element = element.at[slot].set(jnp.broadcast_to(index[None], near.shape).astype(jnp.int32), mode="drop")
    return count + near.sum(dtype=jnp.int32), segment, element


def _candidates(near_block, blocks, seed, capacity):
    """Compact the pairs of all blocks. If they exceed the capacity, do it again with unbiased random thinning."""

    def run(probability):
        def visit(state, block):
            kept, every, segment, element = state
            index, source, data = block
            near = near_block(*data)
            every = every + (near & (index == source)[None]).sum(dtype=jnp.int32)
            key = jax.random.fold_in(jax.random.key(seed), index[0])
            near = near & (jax.random.uniform(key, near.shape) < probability)
            kept, segment, element = _gather(near, kept, segment, element, index, source)
            return (kept, every, segment, element), None

        empty = jnp.zeros(capacity, jnp.int32)
        state = (jnp.int32(0), jnp.int32(0), empty - 1, empty)
        return loops.scan(visit, state, blocks)[0]

    full = run(1.0)
    share = max(capacity - 8.0 * capacity**0.5, 0.5 * capacity)
    probability = jnp.where(full[1] > capacity, share / jnp.maximum(full[1], 1), 1.0).astype(jnp.float32)
    state = loops.cond(full[1] > capacity, lambda: run(probability), lambda: full)
    return state[2], state[3], state[1], 1.0 / probability


def edge_candidates(geometry, edges, strips, seed, capacity, both_sides):
    """(segment, edge, count, weight): see `queries.edge_candidates`. Every edge is tried, without a tree."""
    vertices, (apex, target, normal, scale, widest) = geometry.vertices, strips
    height = dot(normal, target - apex)
    b, n = target[:, None], normal[:, None]

    def near_block(edge, opp, r):
        p0, p1 = vertices[edge[:, 0]][None], vertices[edge[:, 1]][None]
        plane = jnp.cross(p0 - apex[:, None], p1 - p0)
        side = side_of_faces(vertices, opp, p0[0], p1[0], plane, apex)
        f0, f1 = (dot(p - apex[:, None], n) / height[:, None] for p in (p0, p1))
        c0, c1 = jnp.clip(f0, 1e-6, 1.0), jnp.clip(f1, 1e-6, 1.0)
        rise = jnp.where(f0 == f1, 1.0, f1 - f0)
        q0 = p0 + ((c0 - f0) / rise)[..., None] * (p1 - p0)
        q1 = p1 + ((f1 - c1) / rise)[..., None] * (p0 - p1)
        m0 = apex[:, None] + (q0 - apex[:, None]) / c0[..., None]
        along = apex[:, None] + (q1 - apex[:, None]) / c1[..., None] - m0
        length = norm(along)
        s = dot(b - m0, along) / length
        distance = norm(b - m0 - (s / length)[..., None] * along)
        share = s / length
        reach = _reach(r[None] * scale[:, None], (1 - share) / c0 + share / c1, widest)
        between = (jnp.minimum(f0, f1) < 1.0) & (jnp.maximum(f0, f1) > 1e-6)
        opposite_side = (side * dot(plane, b - apex[:, None]) < 0) | (both_sides & (side != 0))
        return between & opposite_side & (reach > 0) & (s >= 0) & (s < length) & (distance < reach)

    return _candidates(near_block, _blocks(edges.ends, edges.opposite, edges.rank), seed, capacity)


def point_candidates(geometry, edges, points, strips, seed, capacity, both_sides):
    """(segment, point, count, weight): see `queries.point_candidates`."""
    vertices, (apex, target, normal, scale, widest) = geometry.vertices, strips
    height = dot(normal, target - apex)

    def near_block(p, e, r):
        p0, p1 = vertices[edges.ends[e, 0]][None], vertices[edges.ends[e, 1]][None]
        plane = jnp.cross(p0 - apex[:, None], p1 - p0)
        side = side_of_faces(vertices, edges.opposite[e], p0[0], p1[0], plane, apex)
        f, projected = _project(p[None], apex, height, normal)
        reach = _reach(r[None] * scale[:, None], 1.0 / jnp.where(f == 0, 1.0, f), widest)
        opposite_side = (side * dot(plane, (target - apex)[:, None]) < 0) | (both_sides & (side != 0))
        near = norm(projected - target[:, None]) < reach
        return (f > 1e-6) & (f <= 1.0) & opposite_side & (reach > 0) & near

    return _candidates(near_block, _blocks(*points), seed, capacity)


def silhouettes(geometry, edges, cones, seed, capacity):
    """(cone, edge, count, weight): see `queries.silhouettes`."""
    reach = jnp.where(cones.reach >= jnp.pi, jnp.finfo(jnp.float32).max, cones.reach)[:, None]

    def near_block(ends, opposite, rank):
        return silhouette_angles(geometry, ends, opposite, rank, cones)[0] < reach

    return _candidates(near_block, _blocks(edges.ends, edges.opposite, edges.rank), seed, capacity)
