"""Microfacet distributions (GGX, Beckmann) in the local frame, with Smith's separable masking.

The density D of microfacet normals m is per solid angle, with ∫ D(m) cos(m) dm = 1. Masking is returned divided by the
cosine, as G1(v) / |cos v|. Models need this quotient, and it stays finite at grazing angles.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import erf_inv, stop_gradient
from jax.scipy.special import erf
from jaxtyping import Array, Bool, Float

from jaxdr.geometry.vector import components, dot, from_components, norm, normalize, scale, vanishes, z_of
from jaxdr.scene.bsdf.fresnel import fresnel_dielectric
from jaxdr.scene.ranges import at_least

SMOOTHEST = 1e-4  # least alpha: half-vectors in float32 are too coarse for less
NEWTON_STEPS = 5  # at the worst angle four steps converge to the rounding of float32

# Roughness of facets: one number for all directions, or two, (along the x axis, along the y axis).
Alpha = Float[Array, "*#n"] | tuple[Float[Array, "*#n"], Float[Array, "*#n"]]


class Distribution(NamedTuple):
    """One distribution of microfacet normals; `alpha` is its roughness (an `Alpha`).

    - `density(m, alpha)` = D(m), in 1/sr, for unit m with m.z ≥ 0.
    - `masking(v, alpha)` = G1(v) / |v.z| for unit v on either side.
    - `sample(v, alpha, u)`: visible normals, that is, unit m with density D(m) G1(v) max(0, v·m) / v.z, for v.z > 0.
    """

    density: Callable
    masking: Callable
    sample: Callable


def _axes(alpha: Alpha) -> tuple[Float[Array, "*#n"], Float[Array, "*#n"]]:
    """Roughness along x and along y; the same array twice if there is only one."""
    return alpha if isinstance(alpha, tuple) else (alpha, alpha)


def _spread(alpha: Alpha, t: Float[Array, "*#n"]) -> Float[Array, "*#n"]:
    """Product of both roughnesses, each multiplied by `t`."""
    along, across = _axes(alpha)
    return jnp.square(along * t) if along is across else (along * t) * (across * t)


def _ggx_density(m: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Walter et al. 2007, Eq. 33; with two roughnesses Heitz 2018, Eq. 1.

    It is written with x and y, because 1 - cos² would lose all digits in float32 for small alpha.
    """
    x, y, z = components(m)
    along, across = _axes(alpha)
    x, y = x / along, y / across
    stretched = x * x + y * y + z * z
    return 1.0 / (math.pi * _spread(alpha, stretched))


def _ggx_masking(v: Float[Array, "*#n 3"], alpha: Alpha) -> Float[Array, "*#n"]:
    """Walter et al. 2007, Eq. 34, divided by the cosine."""
    x, y, z = components(v)
    along, across = _axes(alpha)
    x, y = along * x, across * y
    return 2.0 / (jnp.abs(z) + jnp.sqrt(x * x + y * y + z * z))


def _ggx_visible(v: Float[Array, "*#n 3"], u: Float[Array, "*#n 2"]) -> Float[Array, "*#n 3"]:
    """Visible normals (Heitz 2018) by the simpler map of Dupuy and Benyoub 2023: a spherical cap, shifted by v."""
    first, second = components(u)
    x, y, z = components(v)
    angle = 2 * math.pi * second
    up = 1.0 + z
    raised = (1.0 - first) * up  # z of the cap plus z of v, without the cancellation of that sum
    # first up (2 - first up), without a difference: it could be negative, because z is above 1 if a GPU rounds it up.
    radius = jnp.sqrt(first * (up * raised + x * x + y * y))
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
    """Smith's exact integral, divided by the cosine (Walter et al. 2007, before Eq. 27).

    Mitsuba uses the rational approximation of Eq. 27. It is off by up to 0.4 %, and so is the density of its sampler.
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
    """Visible normals (Heitz and d'Eon 2014) by the inversion of Jakob 2014: Newton's method for erf(slope)."""
    first, second = components(u)
    x, y, cos = components(v)
    cos = jnp.abs(cos)  # for v from below the result means nothing, but it must not be NaN
    sin = norm(from_components(x, y))
    tilted = sin > 0
    sin_or_one = jnp.where(tilted, sin, 1.0)
    cos_phi, sin_phi = jnp.where(tilted, x, 1.0) / sin_or_one, jnp.where(tilted, y, 0.0) / sin_or_one
    steepest = jnp.where(tilted, cos / sin_or_one, 10.0)  # slope of normals at right angles to v; 10 means infinity
    steepest = jnp.minimum(steepest, 10.0)
    one = 1.0 - jnp.finfo(v.dtype).epsneg
    top = jnp.minimum(erf(steepest), one)
    share = first * (cos * (1.0 + top) + sin * jnp.exp(-jnp.square(steepest)) / math.sqrt(math.pi))

    def residual(x):
        """(cumulative distribution of slopes at erf(slope) = x, minus the share; its derivative), up to a factor."""
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
    """Unit vectors with x and y scaled by alpha.

    It takes directions to the space where alpha is 1, and normals back from there.
    """
    x, y, z = components(v)
    along, across = _axes(alpha)
    return normalize(from_components(along * x, across * y, z))


def _stretched(visible: Callable) -> Callable:
    """Sampler of visible normals of any roughness, from one for roughness 1 whose normals may have any length."""

    def sample(v: Float[Array, "*#n 3"], alpha: Alpha, u: Float[Array, "*#n 2"]) -> Float[Array, "*#n 3"]:
        return _stretch(visible(_stretch(v, alpha), u), alpha)

    return sample


DISTRIBUTIONS = {
    "ggx": Distribution(_ggx_density, _ggx_masking, _stretched(_ggx_visible)),
    "beckmann": Distribution(_beckmann_density, _beckmann_masking, _stretched(_beckmann_visible)),
}


def reflect(wi: Float[Array, "*#n 3"], m: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """The mirror direction of `wi` about the unit normal m."""
    return scale(m, 2.0 * dot(wi, m)) - wi


def refract(
    wi: Float[Array, "*#n 3"], m: Float[Array, "*#n 3"], eta: Float[Array, "*#n"]
) -> tuple[Float[Array, "*n 3"], Bool[Array, "*n"]]:
    """(`wi` refracted at a facet with unit normal m on its side, whether there is no total internal reflection).

    `eta` is the index beyond the facet over that on the side of wi (Walter et al. 2007, Eq. 40).
    """
    cosine = dot(wi, m)
    interface = fresnel_dielectric(jnp.abs(cosine), eta)
    along = interface.eta_ti * cosine - interface.cos_t
    return scale(m, along) - scale(wi, interface.eta_ti), interface.cos_t > 0


def mirrored_width(alpha: Alpha) -> Float[Array, "*n"]:
    """Width (radians, at most 1) of the lobe that facets of roughness alpha reflect. Reflection doubles angles."""
    return jnp.minimum(2.0 * narrowest(alpha), 1.0)


def along_and_across(alpha: Float[Array, "*n"], alpha_v: Float[Array, "*n"] | None = None) -> Alpha:
    """Roughness along x and, where it differs, along y; at least `SMOOTHEST`, as in Mitsuba, also for traced values."""
    along = at_least(alpha, SMOOTHEST)
    return along if alpha_v is None else (along, at_least(alpha_v, SMOOTHEST))


def narrowest(alpha: Alpha) -> Float[Array, "*n"]:
    """The smaller roughness."""
    along, across = _axes(alpha)
    return along if along is across else jnp.minimum(along, across)


class Reflection(NamedTuple):
    """Microfacet reflection without its Fresnel factor (Walter et al. 2007, Eq. 20), zero where it is impossible.

    - `value` = D G1(wi) G1(wo) / (4 |cos wi|), in 1/sr: the factor |cos wo| is in it.
    - `pdf`: density (1/sr) of directions mirrored at visible normals.
    - `cosine` = wi·h, between wi and the half-vector.
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
    active = active & ~vanishes(wi + wo)  # two grazing directions can cancel to the last bit
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
    """Refraction by facets, zero where it is impossible.

    wi is above the surface. `eta` is the index beyond the surface over the index on the side of wi. `value` is Walter
    et al. 2007, Eq. 21, times |cos wo|, and times 1 / eta² since it is for radiance. `pdf` is Eq. 17 times the density
    of visible normals.
    """
    model = DISTRIBUTIONS[distribution]
    up = jnp.asarray([0.0, 0.0, 1.0], wi.dtype)
    active = (z_of(wi) > 0) & (z_of(wo) < 0)
    wi, wo = jnp.where(active[..., None], wi, up), jnp.where(active[..., None], wo, -up)
    half = wi + scale(wo, eta)
    length2 = dot(half, half)  # = (wi·m + eta wo·m)²
    active &= ~vanishes(half)
    m = scale(normalize(half), jnp.where(z_of(half) < 0, -1.0, 1.0).astype(wi.dtype))
    cos_i, cos_o = dot(wi, m), -dot(wo, m)
    active &= (cos_i > 0) & (cos_o > 0)  # wi sees the front of the facet as of the surface, and wo the back
    m = jnp.where(active[..., None], m, up)
    density = model.density(m, alpha) * model.masking(wi, alpha) * cos_i * cos_o
    density = density / jnp.where(active, length2, 1.0)
    passing = (1.0 - fresnel_dielectric(jnp.abs(cos_i), eta).reflectance) * -z_of(wo)
    value = density * passing * model.masking(wo, alpha)
    return Transmission(jnp.where(active, value, 0.0), jnp.where(active, density * eta * eta, 0.0))
