"""Microfacet distributions (GGX, Beckmann) in the local frame, with Smith's separable masking.

Normal densities D are per solid angle of microfacet normals m and satisfy ∫ D(m) cos(m) dm = 1. Masking is returned
over the cosine, G1(v) / |cos v|, which stays finite at grazing angles, where models divide by that cosine.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import erf_inv, stop_gradient
from jax.scipy.special import erf
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import components, dot, from_components, norm, normalize, scale, z_of
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric

NEWTON_STEPS = 5  # the worst angle takes four to the rounding of float32

# Roughness of facets: one number for all directions, or (along the x axis, along the y axis).
Alpha = Float[Array, "*#n"] | tuple[Float[Array, "*#n"], Float[Array, "*#n"]]


class Distribution(NamedTuple):
    """One distribution of microfacet normals; `alpha` is its roughness (an `Alpha`).

    `density(m, alpha)` = D(m), 1/sr, for unit m with m.z ≥ 0. `masking(v, alpha)` = G1(v) / |v.z| for unit v on either
    side. `sample(v, alpha, u)`: unit m with density D(m) G1(v) max(0, v·m) / v.z (visible normals), for v.z > 0.
    """

    density: Callable
    masking: Callable
    sample: Callable


def _axes(alpha: Alpha) -> tuple[Float[Array, "*#n"], Float[Array, "*#n"]]:
    """Roughness along x and along y; the same array twice where there is but one."""
    return alpha if isinstance(alpha, tuple) else (alpha, alpha)


def _spread(alpha: Alpha, t: Float[Array, "*#n"]) -> Float[Array, "*#n"]:
    """Product of both roughnesses, each times `t`."""
    along, across = _axes(alpha)
    return jnp.square(along * t) if along is across else (along * t) * (across * t)


def _ggx_density(m: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Walter et al. 2007, Eq. 33, written with x and y: 1 - cos² would lose all digits for small alpha in float32.

    With two roughnesses Heitz 2018, Eq. 1.
    """
    x, y, z = components(m)
    along, across = _axes(alpha)
    x, y = x / along, y / across
    stretched = x * x + y * y + z * z
    return 1.0 / (math.pi * _spread(alpha, stretched))


def _ggx_masking(v: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Walter et al. 2007, Eq. 34, over the cosine."""
    x, y, z = components(v)
    along, across = _axes(alpha)
    x, y = along * x, across * y
    return 2.0 / (jnp.abs(z) + jnp.sqrt(x * x + y * y + z * z))


def _ggx_visible(v: Float[Array, "*#n 3"], u: Float[Array, "*#n 2"]) -> Float[Array, "*#n 3"]:
    """Heitz 2018's density by the simpler map of Dupuy and Benyoub 2023: a spherical cap, shifted by v."""
    first, second = components(u)
    x, y, z = components(v)
    angle = 2 * math.pi * second
    up = 1.0 + z
    raised = (1.0 - first) * up  # of the sum below, without its cancellation
    radius = jnp.sqrt(first * up * (2.0 - first * up))
    return from_components(radius * jnp.cos(angle) + x, radius * jnp.sin(angle) + y, raised)


def _beckmann_density(m: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Walter et al. 2007, Eq. 25; zero where the exponential underflows in float32."""
    x, y, z = components(m)
    z2 = jnp.square(z)
    along, across = _axes(alpha)
    slope2 = jnp.square(x / along) + jnp.square(y / across)
    inside = slope2 < 80.0 * z2
    z2 = jnp.where(inside, z2, 1.0)
    exponent = jnp.where(inside, slope2, 0.0) / z2
    return jnp.where(inside, jnp.exp(-exponent) / (math.pi * _spread(alpha, z2)), 0.0)


def _beckmann_masking(v: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Smith's exact integral over the cosine (Walter et al. 2007, before Eq. 27).

    Mitsuba takes the rational approximation, which is up to 0.4 % off, and so is the density of its sampler.
    """
    x, y, z = components(v)
    along, across = _axes(alpha)
    if along is across:
        wide = along * norm(from_components(x, y))
    else:
        wide = norm(from_components(along * x, across * y))
    z = jnp.abs(z)
    shadows = 10.0 * wide > z  # elsewhere G1 is 1 to the last bit
    wide = jnp.where(shadows, wide, 1.0)
    a = jnp.where(shadows, z / wide, 1.0)
    below = z * (1.0 + erf(a)) + wide * jnp.exp(-a * a) / math.sqrt(math.pi)
    return 2.0 / jnp.where(shadows, below, 2.0 * jnp.where(shadows, 1.0, z))


def _beckmann_visible(v: Float[Array, "*#n 3"], u: Float[Array, "*#n 2"]) -> Float[Array, "*#n 3"]:
    """Heitz and d'Eon 2014 with the inversion of Jakob 2014: Newton's method for erf(slope)."""
    first, second = components(u)
    x, y, cos = components(v)
    cos = jnp.abs(cos)  # from below any unit vector will do, but no NaN
    sin = norm(from_components(x, y))
    tilted = sin > 0
    sin_or_one = jnp.where(tilted, sin, 1.0)
    cos_phi, sin_phi = jnp.where(tilted, x, 1.0) / sin_or_one, jnp.where(tilted, y, 0.0) / sin_or_one
    steepest = jnp.where(tilted, cos / sin_or_one, 10.0)  # slope of normals perpendicular to v; 10 stands for infinity
    steepest = jnp.minimum(steepest, 10.0)
    one = 1.0 - jnp.finfo(v.dtype).epsneg
    top = jnp.minimum(erf(steepest), one)
    share = first * (cos * (1.0 + top) + sin * jnp.exp(-jnp.square(steepest)) / math.sqrt(math.pi))

    def residual(x):
        """(distribution function of slopes at erf(slope) = x, less the share; its derivative), times cos."""
        slope = erf_inv(x)
        value = cos * (1.0 + x) + sin * jnp.exp(-slope * slope) / math.sqrt(math.pi) - share
        return value, cos - slope * sin

    # The function of x is concave: from its second step on, Newton's method approaches the root from below.
    guess = top - (1.0 + top) * erf(jnp.sqrt(-jnp.log(jnp.maximum(first, jnp.finfo(u.dtype).tiny))))
    fixed = stop_gradient
    x = jnp.clip(fixed(guess), -one, fixed(top))
    for _ in range(NEWTON_STEPS):
        value, slope = (fixed(part) for part in residual(x))
        x = jnp.clip(x - value / jnp.where(slope > 0, slope, 1.0), -one, fixed(top))
    # One more step from a fixed point carries the derivative (implicit function theorem).
    value, slope = residual(fixed(x))
    x = x - jnp.where(slope > 0, value - fixed(value), 0.0) / jnp.where(slope > 0, fixed(slope), 1.0)

    along, across = erf_inv(x), erf_inv(jnp.clip(2.0 * second - 1.0, -one, one))
    return from_components(
        -(cos_phi * along - sin_phi * across), -(sin_phi * along + cos_phi * across), jnp.ones_like(along)
    )


def _stretch(v: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n 3"]:
    """Scale x and y by alpha: directions to the space where alpha is 1, and normals back from it. Unit vectors."""
    x, y, z = components(v)
    along, across = _axes(alpha)
    return normalize(from_components(along * x, across * y, z))


def _stretched(visible: Callable) -> Callable:
    """Samples visible normals of any roughness by `visible`: those at roughness 1, of any length."""

    def sample(v: Float[Array, "*#n 3"], alpha: Alpha, u: Float[Array, "*#n 2"]) -> Float[Array, "*#n 3"]:
        return _stretch(visible(_stretch(v, alpha), u), alpha)

    return sample


DISTRIBUTIONS = {
    "ggx": Distribution(_ggx_density, _ggx_masking, _stretched(_ggx_visible)),
    "beckmann": Distribution(_beckmann_density, _beckmann_masking, _stretched(_beckmann_visible)),
}


def reflect(wi: Float[Array, "*#n 3"], m: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """`wi` mirrored at the plane with unit normal m."""
    return scale(m, 2.0 * dot(wi, m)) - wi


def refract(
    wi: Float[Array, "*#n 3"], m: Float[Array, "*#n 3"], eta: Float[Array, "*#n"]
) -> tuple[Float[Array, "*n 3"], Bool[Array, "*n"]]:
    """`wi` refracted at a facet with unit normal m on its side, and whether it is not reflected totally.

    `eta` is the index beyond the facet over that on the side of wi (Walter et al. 2007, Eq. 40).
    """
    cosine = dot(wi, m)
    interface = fresnel_dielectric(jnp.abs(cosine), eta)
    along = interface.eta_ti * cosine - interface.cos_t
    return scale(m, along) - scale(wi, interface.eta_ti), interface.cos_t > 0


def mirrored_width(alpha: Alpha) -> Float[Array, "*n"]:
    """Width (radians, at most 1) of the lobe that facets of roughness alpha reflect: mirroring doubles their angles."""
    return jnp.minimum(2.0 * narrowest(alpha), 1.0)


def along_and_across(alpha: Float[Array, "*n"], alpha_v: Float[Array, "*n"] | None) -> Alpha:
    """Roughness along x and, where it differs, along y."""
    return alpha if alpha_v is None else (alpha, alpha_v)


def narrowest(alpha: Alpha) -> Float[Array, "*n"]:
    """The lesser of two roughnesses."""
    along, across = _axes(alpha)
    return along if along is across else jnp.minimum(along, across)


class Reflection(NamedTuple):
    """Microfacet reflection without its Fresnel factor (Walter et al. 2007, Eq. 20), zero where it is impossible.

    `value` = D G1(wi) G1(wo) / (4 |cos wi|), 1/sr, counts |cos wo|; `pdf` is the density (1/sr) of directions mirrored
    at visible normals; `cosine` = wi·h, between wi and the half-vector.
    """

    value: Float[Array, "*n"]
    pdf: Float[Array, "*n"]
    cosine: Float[Array, "*n"]


def reflection(
    distribution: str,
    alpha: Alpha,
    wi: Float[Array, "*n 3"],
    wo: Float[Array, "*n 3"],
    active: Bool[Array, "*n"],
) -> Reflection:
    """Reflection from wi to wo, both above the surface where `active`."""
    model = DISTRIBUTIONS[distribution]
    active = active & (dot(wi + wo, wi + wo) > 0)  # two grazing directions can cancel to the last bit
    up = jnp.asarray([0.0, 0.0, 1.0], wi.dtype)
    wi, wo = jnp.where(active[..., None], wi, up), jnp.where(active[..., None], wo, up)
    half = normalize(wi + wo)
    pdf = 0.25 * model.density(half, alpha) * model.masking(wi, alpha)
    value = pdf * z_of(wo) * model.masking(wo, alpha)
    zero = jnp.zeros_like(value)
    return Reflection(jnp.where(active, value, zero), jnp.where(active, pdf, zero), dot(wi, half))


class Transmission(NamedTuple):
    """Value (1/sr, without colour) and density (1/sr) of microfacet refraction."""

    value: Float[Array, "*n"]
    pdf: Float[Array, "*n"]


def transmission(
    distribution: str,
    alpha: Alpha,
    wi: Float[Array, "*n 3"],
    wo: Float[Array, "*n 3"],
    eta: Float[Array, "*#n"],
) -> Transmission:
    """Refraction by facets, zero where impossible; wi above the surface, `eta` the index beyond it over this one's.

    `value` is Walter et al. 2007, Eq. 21, times |cos wo| and, for radiance, 1 / eta²; `pdf` is Eq. 17 times the
    density of visible normals.
    """
    model = DISTRIBUTIONS[distribution]
    up = jnp.asarray([0.0, 0.0, 1.0], wi.dtype)
    active = (z_of(wi) > 0) & (z_of(wo) < 0)
    wi, wo = jnp.where(active[..., None], wi, up), jnp.where(active[..., None], wo, -up)
    half = wi + scale(wo, eta)
    length2 = dot(half, half)  # = (wi·m + eta wo·m)²
    active &= length2 > 0
    m = scale(normalize(half), jnp.where(z_of(half) < 0, -1.0, 1.0).astype(wi.dtype))
    cos_i, cos_o = dot(wi, m), -dot(wo, m)
    active &= (cos_i > 0) & (cos_o > 0)  # a facet is seen from the sides that the surface is seen from
    m = jnp.where(active[..., None], m, up)
    density = model.density(m, alpha) * model.masking(wi, alpha) * cos_i * cos_o
    density = density / jnp.where(active, length2, 1.0)
    passing = (1.0 - fresnel_dielectric(jnp.abs(cos_i), eta).reflectance) * -z_of(wo)
    value = density * passing * model.masking(wo, alpha)
    return Transmission(jnp.where(active, value, 0.0), jnp.where(active, density * eta * eta, 0.0))
