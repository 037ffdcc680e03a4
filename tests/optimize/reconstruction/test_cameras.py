"""Corrections of camera poses: what they do, and the gradient of the loss by them against finite differences."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.optimize.reconstruction import objective
from jaxdr.optimize.reconstruction.cameras import corrected, sizes, with_corrections
from jaxdr.optimize.reconstruction.config import Samples
from jaxdr.optimize.reconstruction.objective import Photograph
from jaxdr.optimize.reconstruction.pictures import Pose, cuts
from jaxdr.optimize.reconstruction.unknowns import Unknowns
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View, Views
from jaxdr.views.rendering import Pinhole

AT = jd.look_at((2.0, 1.0, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
CORRECTION = np.array([0.02, -0.03, 0.05, 0.1, -0.2, 0.3])
SIZE, SAMPLES, KEYS = 24, 16, 64
STEP, ROWS = 0.003, 8  # steps of a fraction of a pixel: the loss wavers with the pixels


def test_a_camera_turns_and_moves_in_its_own_frame():
    moved = np.asarray(corrected(AT, jnp.asarray(CORRECTION, float)))
    np.testing.assert_allclose(moved[:3, :3], AT[:3, :3] @ Rotation.from_rotvec(CORRECTION[:3]).as_matrix(), atol=1e-6)
    np.testing.assert_allclose(moved[:3, 3], AT[:3, 3] + AT[:3, :3] @ CORRECTION[3:], atol=1e-6)
    np.testing.assert_allclose(corrected(AT, jnp.zeros(6)), AT, atol=1e-7)


def views() -> Views:
    pixels = Pixels(np.full((8, 8, 3), 0.5, np.float32), np.ones((8, 8), np.float32))
    made = [View(f"v{i}", Path(f"v{i}.png"), pixels, AT, 10.0, (4.0, 4.0), held_out=i == 1) for i in range(3)]
    return Views(Path("."), tuple(made))


def test_only_fitted_cameras_are_corrected_and_shifts_are_in_longest_sides():
    corrections = jnp.stack([jnp.zeros(6), jnp.asarray(CORRECTION, float)])
    moved = with_corrections(views(), corrections, scale=5.0)
    np.testing.assert_allclose(moved.views[0].to_world, AT, atol=1e-6)
    assert moved.views[1].to_world is AT
    away = moved.views[2].to_world[:3, 3] - AT[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(away), 5 * np.linalg.norm(CORRECTION[3:]), rtol=1e-5)
    found = sizes(corrections, 5.0)
    np.testing.assert_allclose(found["largest_turn_degrees"], np.degrees(np.linalg.norm(CORRECTION[:3])), rtol=1e-5)
    np.testing.assert_allclose(found["largest_shift"], np.linalg.norm(away), rtol=1e-5)


def test_paint_is_looked_up_with_corrected_cameras():
    fitted = cuts(views().fitted, Pose(np.array([1.0, 0.0, 0.0]), 2.0), 8)
    corrections = jnp.stack([jnp.zeros(6), jnp.asarray(CORRECTION, float)])
    moved = fitted.with_corrections(corrections)
    some = moved.spread(1)
    np.testing.assert_allclose(some.camera(0).to_world, fitted.camera(0).to_world, atol=1e-6)
    expected = corrected(fitted.camera(1).to_world, corrections[1])
    np.testing.assert_allclose(moved.camera(1).to_world, expected, atol=1e-6)


@pytest.mark.slow
def test_gradient_by_corrections_is_that_of_the_loss(monkeypatch):
    """A ball before a sky, with a photograph of other things: outline, shading and sky move.

    The loss is made quadratic: then the gradient is that of the noiseless loss, which many samples estimate.
    """
    for limit in ("OUTLIER", "WHITE"):
        monkeypatch.setattr(objective, limit, 1e3)
    mesh = shapes.sphere(2, radius=0.5, center=(0.1, 0.0, 0.0)).smooth()
    count, random = len(mesh.vertices), np.random.default_rng(0)
    light = jnp.asarray(np.log(random.uniform(0.1, 1.5, (5, 8, 3))), float)
    flat = jnp.zeros((count, 3)), jnp.zeros((count, 1))
    unknowns = Unknowns(jnp.asarray(mesh.vertices), *flat, light, jnp.zeros((1, 3)), jnp.zeros((1, 6)))
    pinhole = Pinhole(*(jnp.asarray(x, float) for x in (AT, 35.0, (0.0, 0.0))))
    column, row = jnp.meshgrid(jnp.arange(SIZE), jnp.arange(SIZE))
    alpha = ((column < 11) & (row < 13)).astype(float)
    photograph = Photograph(
        0.4 * alpha[..., None] * jnp.ones(3), alpha, jnp.ones((SIZE, SIZE)), jnp.int32(0), jnp.ones((SIZE, SIZE))
    )
    tracer = jd.PathTracer(max_depth=2, primary="fixed_ray")
    of_view = objective.view_gradient(tracer, Samples(image=SAMPLES, gradient=SAMPLES), 1.0, cameras=True)
    gradient = jax.jit(lambda key: of_view(mesh, unknowns, pinhole, photograph, key)[1].cameras[0])
    found = np.asarray([gradient(key) for key in jax.random.split(jax.random.key(0), KEYS)], float)
    mean, error = found.mean(0), found.std(0, ddof=1) / np.sqrt(KEYS)

    many = Samples(image=1024, gradient=1)
    of_many = objective.view_gradient(replace(tracer, boundary=None), many, 1.0, cameras=True)

    @jax.jit
    def loss(correction, key):
        return of_many(mesh, unknowns._replace(cameras=correction[None]), pinhole, photograph, key)[0]

    rows = []
    for key in jax.random.split(jax.random.key(1), ROWS):
        ends = [[loss(sign * STEP * jnp.eye(6)[k], key) for sign in (1, -1)] for k in range(6)]
        rows.append([float(one - other) / (2 * STEP) for one, other in ends])
    truth, unsure = np.mean(rows, 0), np.std(rows, 0, ddof=1) / np.sqrt(ROWS)
    assert np.all(error < 0.04 * np.abs(truth).max()), (error, truth)
    assert np.all(np.abs(mean - truth) < 4 * np.hypot(error, unsure)), (mean, error, truth, unsure)
