"""Thin bundles of rays, that is, rays with their derivatives, and where they cross lines."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import cross, dot, norm, scale
from jaxdr.safe_divide import safe_divide

BEYOND = 1.5  # edges are searched up to so many times the distance of the hit: the ray may hit a face beside them
MARGIN = 1.5  # the first-order t of a crossing may exceed the reach by this factor


class Bundles(NamedTuple):
    """Rays from `origin` in unit `direction`, and their derivatives with respect to t; `end` is their length.

    A length of zero leaves a ray out.
    """

    origin: Float[Array, "*n 3"]
    direction: Float[Array, "*n 3"]
    origin_rate: Float[Array, "*n 3"]
    direction_rate: Float[Array, "*n 3"]
    end: Float[Array, "*n"]


class Crossing(NamedTuple):
    """Where a ray passes a line: fraction `along` the line, `distance` along the ray."""

    along: Float[Array, "*n"]
    distance: Float[Array, "*n"]


def passes(
    origin: Float[Array, "*n 3"],
    direction: Float[Array, "*n 3"],
    start: Float[Array, "*n 3"],
    side: Float[Array, "*n 3"],
) -> Crossing:
    """Nearest points of rays and of lines from `start` along `side`."""
    normal = cross(direction, side)
    squared = dot(normal, normal)
    squared = jnp.where(squared > 0, squared, 1.0)
    offset = start - origin
    distance = dot(cross(offset, side), normal) / squared
    return Crossing(dot(cross(offset, direction), normal) / squared, distance)


def volume(origin, direction, start, side) -> Float[Array, "*n"]:
    """Zero where a ray meets a line; a smooth function of both, with opposite signs on the line's two sides."""
    return dot(cross(direction, side), start - origin)


def may_cross(
    bundle: Bundles, start: Float[Array, "*n 3"], side: Float[Array, "*n 3"], reach: float
) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """(t at which bundles cross the lines of edges, to first order; whether they cross the edge within `reach`)."""
    o, d, do, dd = bundle.origin, bundle.direction, bundle.origin_rate, bundle.direction_rate
    rate = dot(cross(dd, side), start - o) - dot(cross(d, side), do)
    step = safe_divide(-volume(o, d, start, side), rate)
    near = (rate != 0) & (jnp.abs(step) <= MARGIN * reach)
    t = jnp.where(near, step, 0.0)
    at = passes(o + scale(do, t), d + scale(dd, t), start, side)
    point = start + scale(side, at.along)
    inside = (at.along >= 0) & (at.along <= 1) & within(bundle, point, 0.0, reach)
    return step, near & inside


def within(bundle: Bundles, point, radius, reach):
    """Whether a ball of this `radius` around a point may meet what the bundle sweeps, with a margin.

    It is true for the ball if it is true for a point in the ball with radius zero.
    """
    offset = point - bundle.origin
    depth = dot(offset, bundle.direction)
    across = norm(offset - scale(bundle.direction, depth))
    far = jnp.clip(depth + radius, 0.0, BEYOND * bundle.end)
    width = (1.0 + MARGIN) * reach * (norm(bundle.origin_rate) + far * norm(bundle.direction_rate))
    return (depth >= -radius) & (depth <= BEYOND * bundle.end + radius) & (across <= width + radius)
