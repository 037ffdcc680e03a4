"""Arcs of directions that BSDFs sample, around boundary points seen from surfaces that scatter to both sides.

A kernel over sampled directions must be zero where no direction is sampled. Else a part of its integral is lost. An
opaque surface samples nothing below the horizon. Rough glass refracts light into a part of the other hemisphere only
(`BSDF.rims`). On a great circle through a boundary point μ, cos t μ + sin t e, each bound gives an interval of t.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import dot, scale, z_of
from jaxdr.safe_divide import safe_divide
from jaxdr.transport.shading import Scatterer


class SampledArc(NamedTuple):
    """The part low < t < high of a great circle in which directions are sampled, and a kernel there.

    The kernel a cos t + b sin t - least is positive at the boundary point, t = 0. Where the density of directions goes
    to zero, the kernel does so at about the same rate.
    """

    low: Float[Array, " C"]
    high: Float[Array, " C"]
    a: Float[Array, " C"]
    b: Float[Array, " C"]
    least: Float[Array, " C"]

    def at(self, t: Float[Array, " C"]) -> Float[Array, " C"]:
        """The kernel at t."""
        return self.a * jnp.cos(t) + self.b * jnp.sin(t) - self.least

    def integral(self) -> Float[Array, " C"]:
        """The kernel's integral over the arc."""
        low, high = self.low, self.high
        rest = self.least * (high - low)
        return self.a * (jnp.sin(high) - jnp.sin(low)) - self.b * (jnp.cos(high) - jnp.cos(low)) - rest

    def strip(self) -> Float[Array, " C"]:
        """The integral of the kernel times cos t over the arc: over a strip, per length at t = 0."""

        def primitive(t):
            sine, cosine = jnp.sin(t), jnp.cos(t)
            return 0.5 * self.a * (t + sine * cosine) + 0.5 * self.b * sine**2 - self.least * sine

        return primitive(self.high) - primitive(self.low)

    def contains(self, t: Float[Array, " C"]) -> Bool[Array, " C"]:
        return (t > self.low) & (t < self.high)


def sampled_arc(
    scatterer: Scatterer, boundary: Float[Array, "C 3"], along: Float[Array, "C 3"], reach: Float[Array, " C"]
) -> SampledArc:
    """Arcs within `reach` (radians) of boundary points, on great circles along the unit tangents `along`."""
    mu, e = scatterer.frame.to_local(boundary), scatterer.frame.to_local(along)
    side = scatterer.sampled_side(jnp.sign(z_of(mu)))
    low, high = -reach, reach
    for rim in side:
        low, high = _within(dot(rim.axis, mu), dot(rim.axis, e), rim.least, low, high)
    first = side.first
    return SampledArc(low, high, dot(first.axis, mu), dot(first.axis, e), first.least)


def on_same_side(
    scatterer: Scatterer,
    boundary: Float[Array, "C 3"],
    along: Float[Array, "C 3"],
    centre: Float[Array, "C 3"],
    low: Float[Array, " C"],
    high: Float[Array, " C"],
) -> tuple[Float[Array, " C"], Float[Array, " C"]]:
    """(low, high), cut to the side of the face that `centre` is on, for faces that scatter to both sides.

    The search for edges starts on that side. From there the face hides the rest of a chord.
    """
    through = scatterer.spreads_through()
    assert through is not None  # called only if some surface scatters to both sides
    normal = scale(scatterer.normal, jnp.sign(dot(scatterer.normal, centre)))
    start, end = _within(dot(normal, boundary), dot(normal, along), jnp.zeros_like(low), low, high)
    return jnp.where(through, start, low), jnp.where(through, end, high)


def place(boundary: Float[Array, "C 3"], along: Float[Array, "C 3"], centre: Float[Array, "C 3"]) -> Float[Array, " C"]:
    """t of directions on great circles."""
    return jnp.arctan2(dot(centre, along), dot(centre, boundary))


def _within(a, b, least, low, high):
    """(low, high), cut to the interval around (or nearest to) 0 in which a cos t + b sin t > least."""
    size = jnp.sqrt(a * a + b * b)
    middle = jnp.arctan2(b, a)
    half = jnp.arccos(jnp.clip(safe_divide(least, size), -1.0, 1.0))
    return jnp.maximum(low, middle - half), jnp.minimum(high, middle + half)
