"""The spherical warped-area estimator against exact numbers: a floor point under a light that moves, or a blocker."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.baselines import on_directions
from jaxdr.geometry.shapes import box
from tests.gradients import test_environment_shadow as environment
from tests.gradients.floor_point import (
    HALF_PLANE,
    POINT,
    QUADRANGLE,
    RADIANCE,
    REFLECTANCE,
    UP,
    estimates,
    exact,
    mean_and_error,
    scene,
    sheet,
)
from tests.gradients.test_warped_area import check
from tests.references.polygon_shadow import irradiance_derivatives, silhouette

pytestmark = pytest.mark.filterwarnings("ignore::jaxdr.EstimatorWarning")  # that of `RednerWAS` is what this tests

NARROW, WIDE = (jd.RednerWAS("path_space", sigma0=sigma0) for sigma0 in (0.03, 0.1))
CASES = [
    pytest.param(HALF_PLANE, WIDE, 8, id="half plane"),
    pytest.param(QUADRANGLE, NARROW, 64, id="quadrangle", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("blocker", "boundary", "spp"), CASES)
def test_every_derivative_is_the_closed_form(blocker, boundary, spp):
    """Blocker, light (all four corners: its outlines move on the sphere) and floor."""
    blocker = sheet(blocker, 0.1)
    check(estimates(scene(blocker), boundary, keys=32, spp=spp)[1], exact(blocker)[1])


def cube() -> jd.Mesh:
    """A closed light all of whose outlines are edges between two faces."""
    corners = np.asarray(box().vertices, float)
    axis = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(0.7) * cross + (1 - np.cos(0.7)) * cross @ cross
    size = np.ptp(corners[:, 0])
    return jd.Mesh(0.6 / size * corners @ turn.T + [0.3, 0.1, 1.0], box().faces)


def cube_scene() -> jd.Scene:
    of, black = scene(sheet(HALF_PLANE, 0.1)), jd.Diffuse(0.0)
    shapes = {"floor": of.shapes["floor"], "light": jd.Shape(cube(), black, jd.AreaEmitter(RADIANCE))}
    return jd.Scene(shapes=shapes, camera=of.camera)


def cube_derivatives():
    """Of the radiance by translations of the light along x, y, z."""
    vertices = np.asarray(cube().vertices, float)
    outline = vertices[silhouette(POINT, vertices)]
    if np.sum(np.cross(outline, np.roll(outline, -1, axis=0)), axis=0) @ outline[0] >= 0:
        outline = outline[::-1]
    return REFLECTANCE / np.pi * RADIANCE * irradiance_derivatives(POINT, UP, outline, [])[1].sum(0)


@partial(jax.jit, static_argnames=("boundary", "spp"))
def translated(of, key, boundary, spp):
    """Derivatives of the floor point's radiance by translations of the light [3]; and of every pixel [3, pixels]."""
    vertices = of.parameters()["light.vertices"]

    def image(shift):
        integrator = jd.PathTracer(2, boundary, sampling="emitter")
        return jd.render(of.replace({"light.vertices": vertices + shift}), key, spp, integrator)[..., 0].ravel()

    pixels = jax.jacfwd(image)(jnp.zeros(3)).T
    return pixels.mean(1), pixels


def of_cube(boundary, keys=8, spp=16):
    """(mean, its standard error, standard deviation of a pixel) of the three derivatives."""
    rows = [jax.device_get(translated(cube_scene(), key, boundary, spp)) for key in jax.random.split(KEY, keys)]
    mean, error = mean_and_error(np.array([row[0] for row in rows], float))
    return mean, error, np.std([row[1] for row in rows], axis=(0, 2))


KEY = jax.random.key(4)


def test_cube_shaped_light():
    """Its outlines are a jump on the sphere, its other edges are none; B has to vanish at outlines (Fig. 18)."""
    truth = cube_derivatives()
    scale = np.abs(truth).max()
    mean, error, _ = of_cube(NARROW)
    assert error.max() < 0.03 * scale, (error, truth)
    assert np.all(np.abs(mean - truth) < 4 * error + 0.03 * scale), (mean, error, truth)
    wrong, error, _ = of_cube(jd.RednerWAS("path_space", sigma0=NARROW.sigma0, normal_edges=False))
    assert np.abs(wrong - truth).max() > 4 * error.max() + 0.2 * scale, (wrong, error, truth)


@pytest.mark.slow
def test_noise_beside_that_of_the_material_form():
    """No boundary moves over this light in material form: the warp is all noise."""
    truth = cube_derivatives()
    mean, error, deviation = of_cube(jd.WarpedArea(sigma0=NARROW.sigma0))
    assert np.all(np.abs(mean - truth) < 4.5 * error), (mean, error, truth)
    assert np.all(of_cube(NARROW)[2] > 1.2 * deviation)


def test_directions_are_fixed_in_the_world(monkeypatch):
    """Without the warp nothing is left of a derivative by a uniform light's place: F does not change at a direction."""
    without = jd.RednerWAS(sigma0=0.123)  # of its own, for the compiled program
    monkeypatch.setattr(on_directions, "_warp", lambda *_: 0.0)
    _, pixels = translated(cube_scene(), KEY, without, 4)
    assert np.abs(pixels).max() < 1e-5


@pytest.mark.slow
def test_before_a_sky():
    """Translations of a rectangle before an environment map, and turns of the map."""
    image = environment.sky((16, 32), 5.0)
    of, truth = environment.scene(image), environment.exact(image)
    rows = [environment.derivatives(of, key, WIDE, 64) for key in jax.random.split(KEY, 16)]
    mean, deviation = mean_and_error(np.stack(rows).astype(float))
    scale = np.abs(truth).max()
    assert deviation.max() < 0.12 * scale
    assert np.all(np.abs(mean - truth) < 0.05 * scale + 4 * deviation), (mean, deviation, truth)


def test_what_is_not_covered():
    of = cube_scene()
    with pytest.raises(ValueError, match="RednerWAS: direct light only, but max_depth is 3"):
        jax.jit(jax.grad(lambda s: jd.render(s, KEY, 1, jd.PathTracer(3, jd.RednerWAS())).sum(), allow_int=True))(of)
    for wrong in ({"spread": -1.0}, {"sigma0": 0.0}, {"samples": 0}):
        with pytest.raises(ValueError, match="RednerWAS: "):
            jd.RednerWAS(**wrong)
