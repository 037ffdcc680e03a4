"""BSDFs: samples follow their densities, energy, sides."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from jaxdr.transport.shading import Scatterer

ALBEDO = (0.2, 0.5, 0.8)
MODELS = {"diffuse": jd.Diffuse(ALBEDO)}
models = pytest.mark.parametrize("bsdf", MODELS.values(), ids=MODELS)


def directions(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)


def sphere_grid(rows, columns):
    """Midpoints of equal cells in (cos θ, φ) over the whole sphere, and their solid angle."""
    z = (np.arange(rows) + 0.5) / rows * 2 - 1
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    z, phi = np.meshgrid(z, phi, indexing="ij")
    return directions(np.arccos(z), phi).astype(np.float32), 4 * np.pi / (rows * columns)


@models
@pytest.mark.parametrize("theta", [0.0, 0.7, 1.4])
def test_samples_follow_the_density(bsdf, theta):
    """Chi² over 16 x 16 cells of the sphere."""
    n, cells, fine = 100_000, 16, 8
    wi = jnp.asarray(directions(theta, 0.4), jnp.float32)
    u = jax.random.uniform(jax.random.key(0), (n, 2))
    wo = np.asarray(bsdf.sample(jnp.broadcast_to(wi, (n, 3)), u))
    np.testing.assert_allclose(np.linalg.norm(wo, axis=1), 1.0, rtol=1e-5)
    row = np.minimum(((wo[:, 2] + 1) / 2 * cells).astype(int), cells - 1)
    column = (np.arctan2(wo[:, 1], wo[:, 0]) / (2 * np.pi) % 1 * cells).astype(int) % cells
    counts = np.bincount(row * cells + column, minlength=cells**2)
    grid, cell = sphere_grid(cells * fine, cells * fine)
    density = np.asarray(bsdf.pdf(jnp.broadcast_to(wi, grid.shape), jnp.asarray(grid)), float)
    assert abs(density.sum() * cell - 1) < 1e-3
    expected = n * cell * density.reshape(cells, fine, cells, fine).sum((1, 3)).ravel()
    assert np.all(counts[expected == 0] == 0)
    common = expected > 20
    statistic = np.sum((counts - expected)[common] ** 2 / expected[common])
    assert statistic < chi2.ppf(1 - 1e-4, common.sum() - 1)


@models
@pytest.mark.parametrize("theta", [0.0, 0.7, 1.4])
def test_energy(bsdf, theta):
    """∫ f cos ≤ 1; for diffuse it is the reflectance. The sampled estimate is the same."""
    wi = directions(theta, 0.4).astype(np.float32)
    grid, cell = sphere_grid(200, 200)
    value = np.asarray(bsdf.eval(jnp.broadcast_to(wi, grid.shape), jnp.asarray(grid)), float)
    albedo = value.sum((0, 1)) * cell
    assert np.all(value >= 0) and np.all(albedo <= 1.001)
    np.testing.assert_allclose(albedo, ALBEDO, rtol=1e-3)
    u = jax.random.uniform(jax.random.key(1), (20_000, 2))
    many = jnp.broadcast_to(wi, (20_000, 3))
    wo = bsdf.sample(many, u)
    weight = np.asarray(bsdf.eval(many, wo) / bsdf.pdf(many, wo)[:, None])
    np.testing.assert_allclose(weight.mean(0), albedo, rtol=0.01)


@models
def test_reciprocity(bsdf):
    """f(wi, wo) |cos wi| = f(wo, wi) |cos wo| with f including the cosine of its second direction."""
    rng = np.random.default_rng(2)
    a, b = (directions(np.arccos(rng.uniform(0.05, 1, 50)), rng.uniform(0, 6.28, 50)) for _ in range(2))
    a, b = (jnp.asarray(x, jnp.float32) for x in (a, b))
    np.testing.assert_allclose(bsdf.eval(a, b) * a[:, 2:], bsdf.eval(b, a) * b[:, 2:], rtol=1e-5)


@models
def test_black_from_behind(bsdf):
    up, down = jnp.asarray([[0.3, 0.0, 0.954]]), jnp.asarray([[0.3, 0.0, -0.954]])
    for wi, wo in ((down, up), (up, down), (down, down)):
        assert np.all(np.asarray(bsdf.eval(wi, wo)) == 0) and np.all(np.asarray(bsdf.pdf(wi, wo)) == 0)
    assert np.all(np.asarray(bsdf.eval(up, up)) > 0)


def scatter(bsdf, wi, wo):
    """eval, pdf and a sample of a BSDF on a rectangle in the plane z = 0 that faces +z."""
    scene = jd.Scene(
        {"patch": jd.Shape(rectangle(), bsdf), "other": jd.Shape(rectangle(), jd.Diffuse(0.9))},
        jd.Perspective(jd.look_at([0, -1, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(2, 2)),
    )
    packed = pack(scene)
    face = jnp.flatnonzero(packed.face_shape == list(scene.shapes).index("patch"))[:1]
    third = jnp.full((1, 3), 1 / 3)
    scatterer = Scatterer(packed, material_point(packed, face, third, jnp.ones(1, bool)), jnp.asarray([wi], float))
    wo = jnp.asarray([wo], float)
    return scatterer.eval(wo)[0], scatterer.pdf(wo)[0], scatterer.sample(jnp.asarray([[0.3, 0.6]]))[0]


ABOVE, BELOW = (0.6, 0.0, 0.8), (0.6, 0.0, -0.8)


def test_one_sided_and_two_sided():
    """World directions; a two-sided surface is turned to the side it is seen from."""
    front = scatter(jd.Diffuse(ALBEDO), ABOVE, ABOVE)
    np.testing.assert_allclose(front[0], np.multiply(ALBEDO, 0.8 / np.pi), rtol=1e-5)
    np.testing.assert_allclose(front[1], 0.8 / np.pi, rtol=1e-5)
    assert front[2][2] > 0
    assert np.all(np.asarray(scatter(jd.Diffuse(ALBEDO), BELOW, BELOW)[0]) == 0)
    both = jd.TwoSided(jd.Diffuse(ALBEDO))
    for side in (ABOVE, BELOW):
        value, pdf, sample = scatter(both, side, side)
        np.testing.assert_allclose(value, front[0], rtol=1e-5)
        np.testing.assert_allclose(pdf, front[1], rtol=1e-5)
        assert sample[2] * side[2] > 0
    for wi, wo in ((ABOVE, BELOW), (BELOW, ABOVE)):  # nothing goes through
        assert np.all(np.asarray(scatter(both, wi, wo)[0]) == 0)


def test_parameters():
    np.testing.assert_allclose(jd.Diffuse(0.3).reflectance, [0.3, 0.3, 0.3])
    np.testing.assert_allclose(jd.Diffuse().reflectance, [0.5, 0.5, 0.5])
    with pytest.raises(ValueError, match="Diffuse: reflectance must be a number or three numbers"):
        jd.Diffuse((0.1, 0.2))
    with pytest.raises(ValueError, match="AreaEmitter: radiance must be"):
        jd.AreaEmitter((0.1, 0.2))
