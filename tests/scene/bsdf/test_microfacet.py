"""Microfacet distributions: normalised, masked consistently, sampled as they say, in float32 down to alpha = 0.001."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

from jaxdr.scene.bsdf import microfacet
from tests.scene.bsdf.checks import QUICK, direction, random_directions, repeated, uniform

DISTRIBUTIONS = {n: microfacet.Distribution(*map(jax.jit, model)) for n, model in microfacet.DISTRIBUTIONS.items()}
reflection = jax.jit(microfacet.reflection, static_argnums=0)
each_distribution = pytest.mark.parametrize("name", DISTRIBUTIONS)
ALPHAS = [0.001, 1.0]


def slope_grid(alpha, reach, cells):
    """Normals at the midpoints of a grid of slopes (x/z, y/z) / alpha in [-reach, reach]², and their solid angles."""
    s = ((np.arange(cells) + 0.5) / cells * 2 - 1) * reach
    slopes = np.stack(np.meshgrid(s, s, indexing="ij"), -1).reshape(-1, 2) * alpha
    cosine = 1 / np.sqrt(1 + (slopes**2).sum(-1))
    normals = np.concatenate([slopes, np.ones_like(slopes[:, :1])], -1) * cosine[:, None]
    return jnp.asarray(normals, float), (2 * reach / cells * alpha) ** 2 * cosine**3


def visible_density(model, v, alpha, normals):
    """D(m) G1(v) max(0, v·m) / v.z in float64."""
    facing = np.maximum(np.asarray(normals, float) @ np.asarray(v, float), 0)
    d = np.asarray(model.density(normals, jnp.asarray(alpha)), float)
    return d * float(model.masking(jnp.asarray(v, float), jnp.asarray(alpha))) * facing


@each_distribution
@pytest.mark.parametrize("alpha", ALPHAS)
def test_projected_area_of_the_facets_is_that_of_the_surface(name, alpha):
    """∫ D(m) cos(m) dm = 1. GGX leaves the share 1 / (1 + r²) outside a disc of slopes of radius r."""
    normals, area = slope_grid(alpha, reach := 40.0 if name == "ggx" else 5.0, 800)
    normals64 = np.asarray(normals, float)
    inside = np.hypot(*normals64[:, :2].T) / normals64[:, 2] < reach * alpha
    d = np.asarray(DISTRIBUTIONS[name].density(normals, jnp.asarray(alpha)), float)
    expected = 1 - 1 / (1 + reach**2) if name == "ggx" else 1.0
    assert abs((d * normals64[:, 2] * area)[inside].sum() - expected) < 5e-4


@each_distribution
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("theta", [0.0, 0.8, 1.5])
def test_visible_facets_project_to_the_surface(name, alpha, theta):
    """G1(v) ∫ D(m) max(0, v·m) dm = v.z: the density of visible normals integrates to one (Heitz 2014, Eq. 14)."""
    normals, area = slope_grid(alpha, 150.0 if name == "ggx" else 6.0, 1000)
    density = visible_density(DISTRIBUTIONS[name], direction(theta, 0.3), alpha, normals)
    assert abs((density * area).sum() - 1) < 0.012 if name == "ggx" else 2e-4


@each_distribution
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("theta", [0.0, 0.8, 1.5])
def test_sampled_normals_follow_the_density(name, alpha, theta):
    """Chi² over 20 x 20 cells of slopes / alpha in [-3, 3]², the rest in one more cell."""
    count, reach, cells, fine = 50_000, 3.0, 20, 16
    v = direction(theta, 0.3)
    m = DISTRIBUTIONS[name].sample(repeated(v, count), jnp.asarray(alpha), uniform(count, 1))
    m = np.asarray(m, float)
    np.testing.assert_allclose(np.linalg.norm(m, axis=1), 1, rtol=1e-5)
    slopes = m[:, :2] / m[:, 2:] / alpha
    counts, _, _ = np.histogram2d(*slopes.T, bins=cells, range=[[-reach, reach]] * 2)
    normals, area = slope_grid(alpha, reach, cells * fine)
    density = visible_density(DISTRIBUTIONS[name], v, alpha, normals) * area
    expected = count * density.reshape(cells, fine, cells, fine).sum((1, 3))
    counts, expected = (np.append(x.ravel(), count - x.sum()) for x in (counts, expected))
    used = expected > 10
    statistic = np.sum((counts - expected)[used] ** 2 / expected[used])
    assert statistic < chi2.ppf(1 - 1e-5, used.sum() - 1)


@each_distribution
def test_sampled_normals_move_with_alpha(name):
    """Derivative of a normal at fixed random numbers against central differences in float64."""
    with jax.enable_x64(True):
        v, u = random_directions(200, 2, lowest=0.02), uniform(200, 3)
        v, u = jnp.asarray(v, jnp.float64), jnp.asarray(u, jnp.float64)

        @jax.jit
        def normal(alpha):
            return DISTRIBUTIONS[name].sample(v, alpha, u)

        alpha, step = jnp.asarray(0.3), 1e-5
        _, derivative = jax.jvp(normal, (alpha,), (jnp.ones(()),))
        difference = (normal(alpha + step) - normal(alpha - step)) / (2 * step)
        np.testing.assert_allclose(derivative, difference, atol=1e-5)


@each_distribution
@pytest.mark.parametrize("alpha", [1e-4, 0.001])
def test_float32_is_enough_for_narrow_lobes(name, alpha):
    """Reflection into the lobe compared with float64."""
    wi = random_directions(500, 4, lowest=0.1)
    m = DISTRIBUTIONS[name].sample(wi, jnp.asarray(alpha), uniform(500, 5))
    wo = 2 * (wi * m).sum(-1, keepdims=True) * m - wi
    inside = (wo[:, 2] > 0) & (m[:, 2] > 1 / np.sqrt(1 + (4 * alpha) ** 2))
    single = reflection(name, jnp.asarray(alpha), wi, wo, inside)
    with jax.enable_x64(True):
        double = reflection(name, *(jnp.asarray(x, jnp.float64) for x in (np.float32(alpha), wi, wo)), inside)
    np.testing.assert_allclose(single.value, double.value, rtol=3e-3 * 1e-3 / min(alpha, 1e-3) + 1e-3)


@each_distribution
def test_finite_at_the_edges(name):
    """At the pole, at grazing angles, for directions that cancel, and outside; the samplers too."""
    near = [0.0, 1e-20, 1e-7, 1e-3]
    up, flat = [0.0, 0.0, 1.0], [[np.sqrt(1 - z * z), 0.0, z] for z in near]
    edges = jnp.asarray([up, *flat, *([-x, y, z] for x, y, z in flat), [0.6, 0.0, 0.8], [0.0, 0.0, -1.0]])
    wi, wo = (x.reshape(-1, 3) for x in jnp.broadcast_arrays(edges[:, None], edges[None]))

    @functools.partial(jax.jit, compiler_options=QUICK)
    @functools.partial(jax.value_and_grad, argnums=(0, 1, 2))
    def total(alpha, wi, wo):
        active = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return sum(part.sum() for part in reflection(name, alpha, wi, wo, active))

    for alpha in ALPHAS:
        value, gradients = total(jnp.asarray(alpha), wi, wo)
        assert np.isfinite(value)
        assert all(np.all(np.isfinite(g)) for g in gradients)
    u = jnp.asarray([[a, b] for a in (0.0, 0.5, 1 - 2**-24) for b in (0.0, 0.5, 1 - 2**-24)])
    for alpha in ALPHAS:
        m = DISTRIBUTIONS[name].sample(edges[:9, None], jnp.asarray(alpha), u[None])
        np.testing.assert_allclose(jnp.linalg.norm(m, axis=-1), 1.0, rtol=1e-5)
