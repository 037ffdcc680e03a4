"""Where faces pass through each other, from all pairs of faces."""

import jax
import jax.numpy as jnp

from jaxdr import loops
from jaxdr.geometry.queries.records import TOUCHING
from jaxdr.geometry.vector import cross, dot, norm, normalize

BLOCK = 32


def face_intersections(geometry, moving, seed, capacity, indirect):
    """(first [C], second [C], start [C, 3], end [C, 3], count, weight): see `queries.face_intersections`."""
    del indirect  # no warnings from here
    vertices, faces = geometry
    count = faces.shape[0]
    every = jnp.arange(-(-count // BLOCK) * BLOCK).reshape(-1, BLOCK)

    def run(probability):
        def visit(state, number):
            kept, found, *lists = state
            other = jnp.minimum(number, count - 1)
            there, *ends = _pairs(vertices, faces, faces[other])
            order = (moving[other] == 0)[None] | (jnp.arange(count)[:, None] < number[None])
            there &= (moving != 0)[:, None] & order & (number < count)[None]
            found += there.sum(dtype=jnp.int32)
            key = jax.random.fold_in(jax.random.key(seed), number[0])
            there &= jax.random.uniform(key, there.shape) < probability
            slot = jnp.where(there, kept + jnp.cumsum(there.reshape(-1)).reshape(there.shape) - 1, capacity)
            rows = jnp.broadcast_to(jnp.arange(count)[:, None], there.shape), jnp.broadcast_to(number, there.shape)
            lists = [
                table.at[slot].set(value.astype(table.dtype), mode="drop")
                for table, value in zip(lists, (*rows, *ends), strict=True)
            ]
            return (kept + there.sum(dtype=jnp.int32), found, *lists), None

        numbers, points = jnp.zeros(capacity, jnp.int32), jnp.zeros((capacity, 3), jnp.float32)
        start = (jnp.int32(0), jnp.int32(0), numbers - 1, numbers, points, points)
        return loops.scan(visit, start, every)[0]

    full = run(1.0)
    share = max(capacity - 8.0 * capacity**0.5, 0.5 * capacity)
    probability = jnp.where(full[1] > capacity, share / jnp.maximum(full[1], 1), 1.0).astype(jnp.float32)
    _, _, first, second, start, end = loops.cond(full[1] > capacity, lambda: run(probability), lambda: full)
    return first, second, start, end, full[1], 1.0 / probability


def _pairs(vertices, faces, others):
    """(whether faces [F] and others [B] pass through each other [F, B], start and end of what they share [F, B, 3])."""
    own, there = vertices[faces][:, None], vertices[others][None]
    normal = normalize(cross(own[..., 1, :] - own[..., 0, :], own[..., 2, :] - own[..., 0, :]))
    across = normalize(cross(there[..., 1, :] - there[..., 0, :], there[..., 2, :] - there[..., 0, :]))
    rounding = TOUCHING * jnp.abs(own).max((-1, -2))
    over_own = dot(normal[..., None, :], there - own[..., :1, :])
    over_there = dot(across[..., None, :], own - there[..., :1, :])
    line = cross(normal, across)
    pieces = [_piece(own, over_there, rounding, line), _piece(there, over_own, rounding, line)]
    (cut0, start0, end0), (cut1, start1, end1) = pieces
    start = jnp.where((dot(line, start1 - start0) > 0)[..., None], start1, start0)
    end = jnp.where((dot(line, end1 - end0) < 0)[..., None], end1, end0)
    apart = (faces[:, None, :, None] != others[None, :, None, :]).all((-1, -2))
    return apart & cut0 & cut1 & (dot(line, end - start) > rounding * norm(line)), start, end


def _piece(triangle, height, rounding, line):
    """(whether a plane cuts triangles that reach beyond `rounding` on both sides, ends of the pieces along `line`)."""
    cut = (height.max(-1) > rounding) & (height.min(-1) < -rounding)
    above = height > 0
    changes = above != jnp.roll(above, -1, axis=-1)
    drop = height - jnp.roll(height, -1, axis=-1)
    share = height / jnp.where(changes, drop, 1.0)
    points = triangle + share[..., None] * (jnp.roll(triangle, -1, axis=-2) - triangle)
    one = jnp.argmax(changes, axis=-1)  # exactly two sides change their sign if the plane cuts
    two = 2 - jnp.argmax(changes[..., ::-1], axis=-1)
    start, end = (jnp.take_along_axis(points, i[..., None, None], -2)[..., 0, :] for i in (one, two))
    turned = (dot(line, end - start) < 0)[..., None]
    return cut, jnp.where(turned, end, start), jnp.where(turned, start, end)
