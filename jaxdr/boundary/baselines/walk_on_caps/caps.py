"""Spherical caps: points in them and on their rims, and the gradient of a mean over a cap by the centre.

Let C(w) be the cap of radius r(w) (an angle) around a unit direction w, and u(w) the mean of a function g over its
area, 2 pi (1 - cos r). If w turns by the tangent t, the rim moves outwards at t . e + t . grad r, where e is the unit
tangent at w towards the point of the rim: the factors cos r of the turn and of the rim's slope add up to one. So by
Leibniz' rule, with the rim's length 2 pi sin r,

    grad u = cot(r / 2) (mean of g (e + grad r) over the rim - mean of g over the cap x grad r).

No derivative of g is needed, and g may jump. A constant in g has no part in it, as the mean of e is zero.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry.vector import normalize, orthonormal_basis, scale
from jaxdr.safe_divide import safe_divide


def tangents(centre: Float[Array, "*n 3"], turn: Float[Array, "*n"]) -> Float[Array, "*n 3"]:
    """Unit tangents at unit directions, `turn` (of one) around them."""
    s, t = orthonormal_basis(centre)
    angle = 2.0 * math.pi * turn
    return scale(s, jnp.cos(angle)) + scale(t, jnp.sin(angle))


def turned(
    centre: Float[Array, "*#n 3"], tangent: Float[Array, "*#n 3"], angle: Float[Array, "*#n"]
) -> Float[Array, "*#n 3"]:
    """Unit directions at an angle from `centre` along a unit tangent."""
    return normalize(scale(centre, jnp.cos(angle)) + scale(tangent, jnp.sin(angle)))


def in_cap(
    centre: Float[Array, "*#n 3"], radius: Float[Array, "*#n"], turn: Float[Array, "*#n"], share: Float[Array, "*#n"]
) -> Float[Array, "*#n 3"]:
    """Directions in caps, even in solid angle for even `turn` and `share` of the area, both from 0 to 1."""
    # 1 - cos is 2 sin^2 of the half: no cancellation in small caps.
    half = jnp.arcsin(jnp.sqrt(share) * jnp.sin(0.5 * radius))
    return turned(centre, tangents(centre, turn), 2.0 * half)


def rim_over_area(radius: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The length of a cap's rim over its area, cot(r / 2); zero for caps without area, which no sample meets."""
    half = 0.5 * radius
    return safe_divide(jnp.cos(half), jnp.sin(half), otherwise=0.0)
