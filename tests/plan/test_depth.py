"""Shares of longer paths against geometric series, in a room that glows all over, and on synthetic numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import box
from jaxdr.plan.depth import DEEPEST, Share, choose_depth, depth_choice, derivative_share, energy_share
from jaxdr.plan.directions import Direction

ALBEDO = 0.5


@pytest.fixture(scope="module")
def furnace():
    """Inside a box whose walls all glow alike: paths of k segments bring ALBEDO^(k - 1) everywhere."""
    mesh = box((2.0, 2.0, 2.0))
    inward = jd.Mesh(mesh.vertices, mesh.faces[:, ::-1])
    camera = jd.Perspective(jd.look_at([0.1, 0.2, 0.1], [1, 0.1, 0], [0, 0, 1]), 60.0, jd.Film(4, 3))
    scene = jd.Scene({"walls": jd.Shape(inward, jd.Diffuse(ALBEDO), jd.AreaEmitter(1.0))}, camera)
    name = "walls.bsdf.reflectance"
    value = scene.parameters()[name]
    along = Direction({name: value}, {name: jnp.ones_like(value)})
    return choose_depth(scene, along, 0.02, jax.random.key(0))


def test_light_is_a_geometric_series(furnace):
    series = ALBEDO ** np.arange(DEEPEST)
    rest = 1 - np.cumsum(series) / series.sum()
    np.testing.assert_allclose(furnace.energy.rest, rest, atol=0.03)
    assert abs(furnace.energy.rest[0] - rest[0]) < 0.02


def test_its_derivative_is_the_series_differentiated(furnace):
    k = np.arange(DEEPEST)
    series = k * ALBEDO ** (k - 1.0)
    rest = 1 - np.cumsum(series) / series.sum()
    np.testing.assert_allclose(furnace.gradient.rest, rest, atol=0.05)


def test_the_depth_of_a_furnace(furnace):
    """Of the light 1.6 % is left behind 6 segments, of the derivative 2 % behind 9."""
    assert furnace.reached and 8 <= furnace.max_depth <= 11
    assert f"depth: {furnace.max_depth} segments" in furnace.line()


def known(rest, error=0.0):
    rest = np.asarray(rest, float)
    return Share(rest, np.full_like(rest, error))


def test_the_smallest_depth_within_the_tolerance():
    light = known([1.0, 0.3, 0.01, 0.001, 0.0])
    assert depth_choice(light, None, 0.05).max_depth == 3
    assert depth_choice(light, None, 0.005).max_depth == 4
    # The derivative may need more than the light, and a standard error counts.
    assert depth_choice(light, known([1.0, 0.5, 0.1, 0.02, 0.0]), 0.05).max_depth == 4
    noisy = depth_choice(light, known([1.0, 0.5, 0.04, 0.03, 0.0], 0.015), 0.05)
    assert noisy.max_depth == 4 and noisy.reached
    hidden = depth_choice(light, known([1.0, 0.5, 0.04, 0.03, 0.0], 0.5), 0.05)
    assert hidden.max_depth == 3 and not hidden.reached and "noise hides" in hidden.line()
    assert depth_choice(known([1.0, 0.9, 0.8]), None, 0.05)[:3] == (3, 0.05, False)


def test_noise_is_no_derivative():
    """Shares come from products of independent calls: noise ten times as large as the rest leaves the rest."""
    rng = np.random.default_rng(0)
    true = np.stack([np.full((40, 40, 3), size) for size in (1.0, 0.1)])
    calls = true + rng.normal(size=(8, *true.shape)) * np.array([0.3, 1.0])[:, None, None, None]
    found = derivative_share(calls)
    assert abs(found.rest[0] - 0.1 / 1.1) < 3 * found.error[0] + 0.01 and found.rest[1] == 0
    assert derivative_share(rng.normal(size=(8, 2, 6, 6, 3))) is None
    assert derivative_share(np.zeros((8, 2, 6, 6, 3))) is None


def test_a_dark_scene_needs_nothing():
    assert depth_choice(energy_share(np.zeros((8, 4, 2, 2, 3))), None, 0.02).max_depth == 1
