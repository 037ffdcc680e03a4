"""Reconstruction filters as densities, the splat that adds values with them, and the film's window."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.splat import splat

FILTERS = [jd.Gaussian(), jd.Gaussian(0.8), jd.Box(), jd.Box(1.0), jd.Tent(), jd.Tent(0.7)]


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=str)
def test_pdf_has_mass_one_inside_its_radius(pixel_filter):
    r = pixel_filter.radius
    x = (np.arange(400) + 0.5) / 400 * 2.4 * r - 1.2 * r
    density = np.asarray(pixel_filter.pdf(jnp.stack(jnp.meshgrid(x, x), -1)))
    assert np.all(density >= 0) and abs(density.sum() * (x[1] - x[0]) ** 2 - 1) < 0.01
    assert np.all(density[(np.abs(x) > r)] == 0)


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=str)
def test_samples_follow_the_pdf(pixel_filter):
    """The cumulative distribution of the samples, at every one of them, against the integral of the density."""
    u = (np.arange(5000) + 0.5) / 5000
    samples = np.asarray(pixel_filter.sample(jnp.stack([u, u], -1)))
    assert np.array_equal(samples[:, 0], samples[:, 1]) and np.all(np.abs(samples) <= pixel_filter.radius)
    x = np.linspace(-1, 1, 4001) * pixel_filter.radius
    marginal = np.asarray(pixel_filter.pdf(jnp.stack([x, 0 * x], -1)), float)
    cumulative = np.cumsum(marginal)
    np.testing.assert_allclose(np.interp(samples[:, 0], x, cumulative / cumulative[-1]), u, atol=2e-3)


@pytest.mark.parametrize("pixel_filter", FILTERS, ids=str)
def test_splat_weighs_points_with_the_density(pixel_filter):
    """A single point: every pixel gets its value times the density around the point, also at the film's border."""
    film = jd.Film(9, 7, pixel_filter, crop=(1, 1, 7, 5))
    centres = np.stack(np.meshgrid(np.arange(1, 8) + 0.5, np.arange(1, 6) + 0.5), -1)
    for point in ([4.3, 3.8], [1.1, 1.2], [0.6, 3.1], [8.4, 6.3], [7.99, 0.75]):
        found = splat(film, jnp.asarray([point]), jnp.asarray([[1.0, 2.0, 3.0]]))
        expected = np.asarray(pixel_filter.pdf(jnp.asarray(np.asarray(point) - centres, jnp.float32)))
        np.testing.assert_allclose(found, expected[..., None] * [1.0, 2.0, 3.0], rtol=1e-4, atol=1e-6)


def test_only_smooth_filters_take_material_first_hits():
    assert [f.smooth for f in FILTERS] == [True, True, False, False, False, False]
    scene = jd.Scene(
        {"ball": jd.Shape(jd.shapes.sphere(1))},
        jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(4, 4, jd.Tent())),
    )
    with pytest.raises(ValueError, match="Tent has no derivative of finite variance"):
        jd.render(scene, jax.random.key(0), 1, jd.PathTracer(primary="material"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 4), "at least 1 pixel"),
        ((4, 4, jd.Box(), (2, 0, 3, 4)), "does not lie inside"),
        ((4, 4, jd.Box(), (0, 0, 0, 4)), "does not lie inside"),
    ],
)
def test_wrong_films(arguments, message):
    with pytest.raises(ValueError, match=message):
        jd.Film(*arguments)


@pytest.mark.parametrize("pixel_filter", [jd.Box, jd.Tent, jd.Gaussian])
def test_wrong_filters(pixel_filter):
    with pytest.raises(ValueError, match="must be positive"):
        pixel_filter(0.0)
