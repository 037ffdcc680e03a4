"""On which side of the plane through a point and an edge the edge's faces lie."""

import jax.numpy as jnp

from jaxdr.geometry.vector import dot, norm


def side_of_faces(vertices, opposite, p0, p1, plane, apex):
    """[N, B]: +1 or -1 if all faces of an edge lie on this side of the plane through apex and edge, else 0.

    Faces that contain the apex, up to rounding, are on neither side.
    """
    largest = jnp.maximum(jnp.abs(p0).max(-1)[None], jnp.abs(apex).max(-1)[:, None])
    rounding = 5e-7 * largest + 1e-6 * norm(p0[None] - apex[:, None])
    offset = vertices[opposite] - p0[:, None]  # [B, K]
    height = dot(plane[:, :, None], offset[None])
    counts = jnp.abs(height) > (rounding * norm(p1 - p0)[None])[..., None] * norm(offset)[None]
    sides = jnp.where(counts & (opposite >= 0)[None], jnp.sign(height), 0.0)
    low, high = sides.min(-1), sides.max(-1)
    return jnp.where(low * high < 0, 0.0, jnp.sign(low + high))
