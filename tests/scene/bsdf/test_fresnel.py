"""Fresnel equations against known values, limits and finite differences."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.scene.bsdf import fresnel, microfacet
from jaxdr.scene.bsdf.materials import METALS
from jaxdr.scene.bsdf.plastic import Plastic
from tests.scene.bsdf.checks import random_directions

fresnel_dielectric, fresnel_conductor = jax.jit(fresnel.fresnel_dielectric), jax.jit(fresnel.fresnel_conductor)
diffuse_transmittance, refract = jax.jit(fresnel.diffuse_transmittance), jax.jit(microfacet.refract)
COSINES = jnp.linspace(0.0, 1.0, 101)


def test_dielectric_known_values():
    np.testing.assert_allclose(
        fresnel_dielectric(jnp.asarray([1.0, -1.0]), jnp.asarray(1.5)).reflectance, 0.04, rtol=1e-5
    )
    assert float(fresnel_dielectric(jnp.asarray(0.0), jnp.asarray(1.5)).reflectance) == 1.0
    critical = np.sqrt(1 - 1 / 1.5**2)  # seen from inside
    cosines = -jnp.asarray([critical - 1e-3, critical + 1e-3])
    reflectance, cos_t, _ = fresnel_dielectric(cosines, jnp.asarray(1.5))
    assert reflectance[0] == 1 and cos_t[0] == 0 and reflectance[1] < 1 and cos_t[1] > 0
    # At Brewster's angle only the polarisation across the plane of incidence is reflected, ((η² - 1) / (η² + 1))².
    brewster = np.cos(np.arctan(1.5))
    expected = 0.5 * (1.25 / 3.25) ** 2
    np.testing.assert_allclose(
        fresnel_dielectric(jnp.asarray(brewster), jnp.asarray(1.5)).reflectance, expected, rtol=1e-5
    )


def test_dielectric_is_reversible():
    """The reflectance is the same for the ray that arrives along the refracted one."""
    reflectance, cos_t, _ = fresnel_dielectric(COSINES, jnp.asarray(1.7))
    np.testing.assert_allclose(
        fresnel_dielectric(-cos_t, jnp.asarray(1.7)).reflectance, reflectance, atol=4e-3
    )  # at grazing: sqrt


def test_no_interface_reflects_nothing():
    np.testing.assert_allclose(fresnel_dielectric(COSINES[1:], jnp.asarray(1.0)).reflectance, 0.0, atol=1e-8)


def test_conductor_limits():
    """Without absorption a conductor is a dielectric; eta = 0 is a perfect mirror; normal incidence is known."""
    eta = jnp.asarray([1.2, 1.5, 2.5])
    for n in eta:
        conductor = fresnel_conductor(COSINES, jnp.full(3, n), jnp.zeros(3))[:, 0]
        np.testing.assert_allclose(conductor, fresnel_dielectric(COSINES, n).reflectance, atol=1e-5)
    np.testing.assert_allclose(fresnel_conductor(COSINES, jnp.zeros(3), jnp.ones(3)), 1.0, atol=1e-6)
    for eta, k in METALS.values():
        eta, k = np.asarray(eta), np.asarray(k)
        expected = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
        np.testing.assert_allclose(
            fresnel_conductor(jnp.ones(()), jnp.asarray(eta), jnp.asarray(k)), expected, rtol=1e-5
        )


def test_conductor_against_complex_amplitudes():
    """Fresnel's amplitudes with a complex index, in double precision."""
    cosine = np.linspace(0.01, 1, 50)[:, None]
    for eta, k in METALS.values():
        # AlSb's index is zero in red: the amplitudes are 0 / 0 at normal incidence there, and have a limit.
        index = np.maximum(eta, 1e-7) - 1j * np.asarray(k)
        inner = np.sqrt(index**2 - (1 - cosine**2))
        s = (cosine - inner) / (cosine + inner)
        p = (index**2 * cosine - inner) / (index**2 * cosine + inner)
        expected = 0.5 * (abs(s) ** 2 + abs(p) ** 2)
        ours = fresnel_conductor(jnp.asarray(cosine[:, 0]), jnp.asarray(eta), jnp.asarray(k))
        np.testing.assert_allclose(ours, expected, rtol=2e-4)


@pytest.mark.parametrize("eta", [1.05, 1.33, 1.5, 2.4])
def test_diffuse_transmittance_is_the_integral(eta):
    """2 ∫ F(μ) μ dμ from outside; from inside, too, where most of it is total reflection."""
    mu = (np.arange(20_000) + 0.5) / 20_000
    for index in (eta, 1 / eta):
        expected = 2 * np.mean(mu * np.asarray(fresnel_dielectric(jnp.asarray(mu), jnp.asarray(index)).reflectance))
        np.testing.assert_allclose(diffuse_transmittance(jnp.asarray(index)), 1 - expected, atol=6e-4)


def test_refraction_obeys_snell():
    m, wi = random_directions(200, 0, lowest=0.0), random_directions(200, 1)
    wi = wi * jnp.sign((wi * m).sum(-1, keepdims=True))
    for eta in (1.5, 1 / 1.5):
        wo, passes = refract(wi, m, jnp.asarray(eta))
        assert bool(passes.all()) == (eta > 1)
        wi_, wo, m_ = (np.asarray(x, float)[np.asarray(passes)] for x in (wi, wo, m))
        np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1, rtol=1e-5)
        sines = (np.linalg.norm(np.cross(w, m_), axis=1) for w in (wi_, wo))
        np.testing.assert_allclose(next(sines), eta * next(sines), atol=1e-5)
        np.testing.assert_allclose(np.cross(wi_, m_), -eta * np.cross(wo, m_), atol=1e-5)


def test_derivatives():
    """Reflectance and refracted cosine in angle and index, against central differences in float64."""
    with jax.enable_x64(True):
        cosine = jnp.asarray([0.999, 0.5, 0.05, -0.9])
        conductor = jnp.asarray([[0.1, 1.0, 2.0], [4.0, 0.3, 0.0]])

        @jax.jit
        def all_of_them(cosine, eta):
            dielectric = fresnel_dielectric(cosine, eta)
            metal = fresnel_conductor(jnp.abs(cosine), eta * conductor[0], conductor[1])
            return jnp.concatenate([dielectric.reflectance[:, None], dielectric.cos_t[:, None], metal], -1)

        point, step = (cosine, jnp.asarray(1.5)), 1e-6
        for tangent in ((jnp.ones_like(cosine), jnp.asarray(0.0)), (jnp.zeros_like(cosine), jnp.asarray(1.0))):
            _, derivative = jax.jvp(all_of_them, point, tangent)
            a, b = (
                all_of_them(*(x + sign * step * t for x, t in zip(point, tangent, strict=True))) for sign in (1, -1)
            )
            np.testing.assert_allclose(derivative, (a - b) / (2 * step), rtol=1e-5, atol=1e-7)


def test_gradients_are_finite_at_the_edges():
    """Grazing and normal incidence, total internal reflection, perfect mirrors, indices that match."""
    cosines = jnp.asarray([0.0, 1.0, -1.0, -0.3, 1e-7, np.sqrt(1 - 1 / 1.5**2), -np.sqrt(1 - 1 / 1.5**2)])

    @jax.jit
    @functools.partial(jax.grad, argnums=(0, 1))
    def dielectric(cosine, eta):
        return fresnel_dielectric(cosine, eta).reflectance.sum()

    @jax.jit
    @functools.partial(jax.grad, argnums=(0, 1, 2))
    def conductor(cosine, eta, k):
        return fresnel_conductor(cosine, eta, k).sum()

    for eta in (1.0, 1.5, 1 / 1.5):
        assert all(np.all(np.isfinite(g)) for g in dielectric(cosines, jnp.asarray(eta)))
    for k in (0.0, 1.0):
        gradients = conductor(jnp.abs(cosines), jnp.asarray([0.0, 1.0, 1.5]), jnp.full(3, k))
        assert all(np.all(np.isfinite(g)) for g in gradients)


def test_coats_of_index_one():
    """A coat asks for the light that comes from inside. At index 1 its slope is that of indices just above."""
    inside = jax.jit(jax.value_and_grad(lambda eta: fresnel.diffuse_transmittance(1.0 / eta)))
    (at, slope), (above, slope_above) = inside(1.0), inside(1.0001)
    np.testing.assert_allclose(slope, slope_above, rtol=0.01)
    np.testing.assert_allclose((above - at) / 1e-4, slope, rtol=0.05)


@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("eta", [1.0, 1.5, 10.0, 100.0, 990.0, 1000.0])
def test_coats_keep_their_digits(eta, nonlinear):
    """Of light inside a dense coat the share 1 / eta^2 leaves. As one minus the rest it would be lost in rounding."""
    w = jnp.asarray([[0.3, 0.1, math.sqrt(0.9)]])
    coat = Plastic(0.5, "water", nonlinear=nonlinear)

    def value(eta, dtype):
        traced = eqx.tree_at(lambda coat: coat.eta, coat, jnp.asarray(eta, dtype))
        return jax.tree.map(lambda x: x.astype(dtype), traced).eval(w.astype(dtype), w.astype(dtype)).sum()

    found = jax.value_and_grad(value)(jnp.float32(eta), jnp.float32)
    with jax.enable_x64(True):
        expected = jax.value_and_grad(value)(jnp.float64(eta), jnp.float64)
    np.testing.assert_allclose(found, expected, rtol=2e-3)
