"""Fresnel equations for unpolarised light, and refractive indices by name.

`eta` of a dielectric is its interior index over its exterior one. The normal points to the exterior.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry.vector import from_components
from jaxdr.scene.ranges import at_least, within

ETA = 1e-3, 1e3  # range of the ratio of two indices of refraction, each from 0.1 to 100


class Interface(NamedTuple):
    """Reflection and refraction of a ray at a dielectric interface.

    - `reflectance`, in [0, 1].
    - `cos_t` ≥ 0: cosine of the refracted ray to the normal, zero under total internal reflection.
    - `eta_ti`: index on the side of the incoming ray over the index on the other side.
    """

    reflectance: Float[Array, "*n"]
    cos_t: Float[Array, "*n"]
    eta_ti: Float[Array, "*n"]


def fresnel_dielectric(cosine: Float[Array, "*#n"], eta: Float[Array, "*#n"]) -> Interface:
    """Reflectance and Snell's law for a ray that arrives at signed `cosine` to the normal (negative: from inside).

    It is differentiable in both. The derivative of `cos_t` is infinite where total internal reflection begins, and zero
    beyond. Walter et al. 2007, Eq. 22, is the same in other variables.
    """
    eta = index(eta)
    eta_ti = jnp.where(cosine >= 0, 1.0 / eta, eta)
    cos_i = jnp.abs(cosine)
    squared = 1.0 - eta_ti * eta_ti * (1.0 - cosine * cosine)
    transmits = squared > 0
    cos_t = jnp.where(transmits, jnp.sqrt(jnp.where(transmits, squared, 1.0)), 0.0)
    t = jnp.where(transmits, cos_t, 1.0)
    s = (eta_ti * cos_i - t) / (eta_ti * cos_i + t)
    p = (cos_i - eta_ti * t) / (cos_i + eta_ti * t)
    return Interface(jnp.where(transmits, 0.5 * (s * s + p * p), 1.0), cos_t, eta_ti)


def index(eta: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The ratio of two indices, or the nearest that there is: beyond them are divisions by zero."""
    return within(eta, *ETA)


def fresnel_conductor(
    cosine: Float[Array, "*n"], eta: Float[Array, "*#n 3"], k: Float[Array, "*#n 3"]
) -> Float[Array, "*n 3"]:
    """Reflectance of a conductor with complex index eta - i k, RGB, for a ray at `cosine` ≥ 0 to the normal.

    Born and Wolf, Principles of Optics, 14.2. eta = 0, k > 0 is a perfect mirror. Negative values count as zero.
    """
    eta, k = at_least(eta, 0.0), at_least(k, 0.0)
    cos = from_components(cosine, cosine, cosine)
    cos2 = cos * cos
    sin2 = 1.0 - cos2
    real = eta * eta - k * k - sin2
    imaginary = eta * k
    squared = real * real + 4.0 * imaginary * imaginary
    modulus = jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)
    # a + i b = sqrt(real + 2 i imaginary). The larger of |a| and |b| is computed by a square root, and `a` from it. So
    # it is accurate in float32, and has finite derivatives.
    larger2 = 0.5 * (modulus + jnp.abs(real))
    positive = larger2 > 0
    larger = jnp.sqrt(jnp.where(positive, larger2, 1.0))
    a = jnp.where(positive, jnp.where(real > 0, larger, imaginary / larger), 0.0)
    term = 2.0 * cos * a
    s = _ratio(modulus + cos2 - term, modulus + cos2 + term)
    sin4 = sin2 * sin2
    p = s * _ratio(cos2 * modulus + sin4 - term * sin2, cos2 * modulus + sin4 + term * sin2)
    return 0.5 * (s + p)


def _ratio(a, b):
    """a / b, one where both vanish."""
    positive = b > 0
    return jnp.where(positive, a / jnp.where(positive, b, 1.0), 1.0)


def diffuse_transmittance(eta: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """1 - ∫ F cos dω / π: share of diffuse light that a smooth interface lets through.

    `eta` is the index on the far side over that on the side of the light. For eta > 1 it is the fit of d'Eon and Irving
    2011, within 0.2 % of the reflectance up to eta = 10. For eta < 1 it follows from that by reciprocity: the share is
    as small as eta^2, which is why this is not one minus the reflectance.
    """
    dense = eta > 1  # at 1 the side of 1 / eta, for coats, whose index is at least 1
    n = jnp.where(dense, eta, 1.0 / eta)
    v = 1.0 / n
    into_dense = 1.0 - (0.919317 + v * (-3.4793 + v * (6.75335 + v * (-7.80989 + v * (4.98554 - v * 1.36881)))))
    return jnp.where(dense, into_dense, into_dense * v * v)


def schlick_weight(cosine: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """(1 - cos)^5 (Schlick 1994)."""
    return jnp.square(jnp.square(1.0 - cosine)) * (1.0 - cosine)
