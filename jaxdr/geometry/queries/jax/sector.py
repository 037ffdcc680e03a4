"""Silhouettes that cut planar sectors, in plain JAX: every edge is tried, and a ray decides on every crossing.

For tests, tiny scenes and devices that Warp does not support.
"""

import jax
import jax.numpy as jnp

from jaxdr.geometry.queries.records import BESIDE
from jaxdr.geometry.vector import dot, normalize

MOST = 48  # crossings of one chord; more are left out
BATCH = 64  # chords at once


def sector_crossings(geometry, edge_set, face_group, sectors, seed, least_layer, capacity):
    """(segment [C], edge [C], along [C], counts [5], weight): see `queries.sector_crossings`."""
    del least_layer  # layers are not counted here
    (vertices, faces), edges, edge_faces, rank = geometry, edge_set.ends, edge_set.faces, edge_set.rank
    most = min(MOST, edges.shape[0])
    ends = jnp.arange(3)
    runs = edges[:, None, None]  # a face runs along its edge or against it
    there = faces[edge_faces]
    along = (there == runs[..., 0]) & (there[..., (ends + 1) % 3] == runs[..., 1])
    along = along.any(-1)

    def chord(a, u0, u1, needed, group):
        relative = vertices - a
        u0, u1 = u0 - a, u1 - a
        normal = jnp.cross(u0, u1)
        area2 = dot(normal, normal)
        area2 = jnp.where(area2 > 0, area2, 1.0)
        height = relative @ normal
        p0, p1 = relative[edges[:, 0]], relative[edges[:, 1]]
        h0, h1 = height[edges[:, 0]], height[edges[:, 1]]
        share = h0 / jnp.where(h0 == h1, 1.0, h0 - h1)
        x = p0 + share[:, None] * (p1 - p0)
        alpha = dot(jnp.cross(x, jnp.broadcast_to(u1, x.shape)), normal[None]) / area2
        beta = dot(jnp.cross(jnp.broadcast_to(u0, x.shape), x), normal[None]) / area2
        bounded = group >= -1
        crosses = ((h0 >= 0) != (h1 >= 0)) & (alpha > 0) & (beta > 0) & (~bounded | (alpha + beta < 1))

        q = relative[faces]
        ahead = dot(q[:, 0], jnp.cross(q[:, 1], q[:, 2])) >= 0
        exists = edge_faces >= 0
        positive = exists & (along == ahead[edge_faces])
        negative = exists & (along != ahead[edge_faces])
        one_sided = ~positive.any(-1) | ~negative.any(-1)
        own = (exists & (face_group[edge_faces] == group)).any(-1) & (group >= 0)
        found = crosses & one_sided & ~own & (rank >= needed) & (needed > 0)
        count = found.sum()
        chosen = jnp.argsort(~found, stable=True)[:most]
        found = found[chosen]

        edge_normal = normalize(jnp.cross(p0[chosen], p1[chosen]))
        edge_normal = jnp.where(positive[chosen].any(-1)[:, None], -edge_normal, edge_normal)
        step = BESIDE * jnp.maximum(jnp.abs(x[chosen]).max(-1), jnp.abs(a).max())
        past = x[chosen] + step[:, None] * edge_normal
        whole = (alpha + beta)[chosen]
        past = jnp.where(bounded, past / jnp.where(found, whole, 1.0)[:, None], past)
        hidden = _blocked(q, past, jnp.where(bounded, 1.0, 0.999), (face_group == group) & (group >= 0))
        return chosen, share[chosen], found & ~hidden, jnp.maximum(count - most, 0)

    rows = (sectors.apex, sectors.first, sectors.last, sectors.needed, sectors.group)
    edge, share, found, lost = jax.lax.map(lambda row: chord(*row), rows, batch_size=BATCH)
    total = found.sum(dtype=jnp.int32)
    room = max(capacity - 8.0 * capacity**0.5, 0.5 * capacity)
    probability = jnp.where(total > capacity, room / jnp.maximum(total, 1), 1.0).astype(jnp.float32)
    found = found & (jax.random.uniform(jax.random.key(seed), found.shape) < probability)
    row, column = jnp.nonzero(found, size=capacity, fill_value=-1)
    used = row >= 0
    counts = jnp.stack([total, jnp.int32(0), lost.sum(dtype=jnp.int32), jnp.int32(0), jnp.int32(0)])
    edge, share = (jnp.where(used, table[row, column], 0) for table in (edge, share))
    return row.astype(jnp.int32), edge.astype(jnp.int32), share.astype(jnp.float32), counts, 1.0 / probability


def _blocked(corners, direction, reach, excluded):
    """[C]: whether rays from the origin meet any triangle [F, 3, 3] before `reach`."""
    a, b, c = (corners[None, :, k] for k in range(3))
    d = direction[:, None]
    u0, u1, u2 = dot(d, jnp.cross(b, c)), dot(d, jnp.cross(c, a)), dot(d, jnp.cross(a, b))
    inside = ((u0 >= 0) & (u1 >= 0) & (u2 >= 0)) | ((u0 < 0) & (u1 < 0) & (u2 < 0))
    normal = jnp.cross(b - a, c - a)
    slope = dot(d, normal)
    t = dot(a, normal) / jnp.where(slope == 0, 1.0, slope)
    return (inside & (slope != 0) & (t > 0) & (t < reach) & ~excluded[None]).any(-1)
