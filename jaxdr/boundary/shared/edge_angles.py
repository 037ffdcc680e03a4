"""Points on edges by the angle along the edge, as a path vertex sees it."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry.vector import corners, dot, norm, scale
from jaxdr.safe_divide import safe_divide

RIGHT = 1.0 - 1e-6  # cones that reach so near to a right angle from the foot have no end on this side
SHORT = 1e-3  # edges that are seen under less are drawn evenly over their length: sines would cancel


class Cone(NamedTuple):
    """Cones of unit `direction`s with the `cosine` of their half-angles, up to a right angle; -1 for all directions."""

    direction: Float[Array, "n 3"]
    cosine: Float[Array, " n"]


def on_edges(
    ends: Float[Array, "n 2 3"],
    apex: Float[Array, "n 3"],
    u: Float[Array, " n"],
    cone: Cone | None = None,
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """(fractions along edges, angles over the density of the points); zero where no part of an edge is in its cone.

    At the distance h of the apex from the edge's line, a point at the angle a from the line's foot contributes in
    proportion to cos a da: a length of the edge is seen as an angle, and its motion is seen slower the farther it is.
    So sin a is drawn evenly. A short edge is drawn evenly over its length.
    """
    start, end = corners(ends)
    side = end - start
    length = norm(side)
    real = jnp.where(length > 0, length, 1.0)
    tangent = scale(side, 1.0 / real)
    first = dot(start - apex, tangent)
    across = start - apex - scale(tangent, first)
    height = norm(across)
    reach0, reach1 = jnp.hypot(first, height), jnp.hypot(first + length, height)
    there = (height > 0) & (length > 0)
    sine0 = safe_divide(first, reach0, there, 0.0)
    sine1 = safe_divide(first + length, reach1, there, 0.0)
    begin, finish = jnp.zeros_like(length), jnp.ones_like(length)
    if cone is not None:
        # Directions at the angle a are w . (cos a, sin a) = |w| cos(a - middle) from the axis.
        x, y = safe_divide(dot(cone.direction, across), height, there, 0.0), dot(cone.direction, tangent)
        size = jnp.hypot(x, y)
        half = jnp.arccos(jnp.clip(safe_divide(cone.cosine, size, size > 0, 0.0), -1.0, 1.0))
        middle, right = jnp.arctan2(y, x), RIGHT * 0.5 * jnp.pi
        low, high = jnp.clip(middle - half, -right, right), jnp.clip(middle + half, -right, right)
        whole = cone.cosine <= -1.0
        below, beyond = whole | (low <= -right), whole | (high >= right)
        sine0 = jnp.where(below, sine0, jnp.maximum(sine0, jnp.sin(low)))
        sine1 = jnp.where(beyond, sine1, jnp.minimum(sine1, jnp.sin(high)))
        begin = jnp.where(below, 0.0, jnp.clip((height * jnp.tan(low) - first) / real, 0.0, 1.0))
        finish = jnp.where(beyond, 1.0, jnp.clip((height * jnp.tan(high) - first) / real, 0.0, 1.0))
        there = there & (whole | (size > cone.cosine)) & (finish > begin)
    long = there & (sine1 - sine0 > SHORT)
    sine = sine0 + u * (sine1 - sine0)
    cosine = jnp.sqrt(jnp.maximum((1.0 - sine) * (1.0 + sine), 0.0))
    along = (safe_divide(height * sine, cosine, long & (cosine > 0)) - first) / real
    along = jnp.where(long, jnp.clip(along, 0.0, 1.0), begin + u * (finish - begin))
    distance = jnp.hypot(first + along * length, height)
    evenly = safe_divide((finish - begin) * length * height, distance * distance, there, 0.0)
    return along, jnp.where(long, safe_divide(sine1 - sine0, cosine, cosine > 0), evenly)
