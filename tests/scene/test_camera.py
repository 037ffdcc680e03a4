"""The pinhole camera: conventions, and projection as the inverse of its rays."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

ORIGIN, TARGET, UP = (1.0, -3.0, 2.0), (0.2, 0.1, 0.3), (0.0, 0.0, 1.0)


def camera(width=40, height=30, fov=50.0, fov_axis="x", scale=1.0) -> jd.Perspective:
    to_world = jd.look_at(ORIGIN, TARGET, UP) @ np.diag([scale, scale, scale, 1.0])
    return jd.Perspective(to_world, fov, jd.Film(width, height), fov_axis)


def test_centre_looks_at_the_target():
    origin, direction = camera().rays(jnp.asarray([20.0, 15.0]))
    np.testing.assert_allclose(origin, ORIGIN, rtol=1e-6)
    towards = np.subtract(TARGET, ORIGIN)
    np.testing.assert_allclose(direction, towards / np.linalg.norm(towards), atol=1e-6)


def test_up_is_row_zero_and_right_is_to_the_right():
    _, directions = camera().rays(jnp.asarray([[20.0, 0.0], [40.0, 15.0]]))
    right = np.cross(np.subtract(TARGET, ORIGIN), UP)
    assert directions[0] @ np.asarray(UP) > directions[1] @ np.asarray(UP)
    assert directions[1] @ right > 0


@pytest.mark.parametrize(
    ("fov_axis", "points"),
    [("x", [[0, 15], [40, 15]]), ("y", [[20, 0], [20, 30]]), ("smaller", [[20, 0], [20, 30]]),
     ("larger", [[0, 15], [40, 15]]), ("diagonal", [[0, 0], [40, 30]])],
)  # fmt: skip
def test_field_of_view(fov_axis, points):
    _, (first, second) = camera(fov_axis=fov_axis).rays(jnp.asarray(points, jnp.float32))
    assert abs(np.degrees(np.arccos(float(first @ second))) - 50.0) < 0.01


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_projection_inverts_rays(scale):
    rng = np.random.default_rng(0)
    film_points = jnp.asarray(rng.uniform([0, 0], [40, 30], (50, 2)), jnp.float32)
    view = camera(scale=scale)
    origin, direction = view.rays(film_points)
    points = origin + jnp.asarray(rng.uniform(0.1, 9, (50, 1)), jnp.float32) * direction
    np.testing.assert_allclose(view.project(points), film_points, atol=2e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"to_world": np.eye(3)}, "4 x 4 matrix"),
        ({"fov_axis": "z"}, "fov_axis must be one of"),
        ({"near_clip": 0.0}, "0 < near_clip < far_clip"),
    ],
)
def test_wrong_cameras(arguments, message):
    with pytest.raises(ValueError, match=message):
        jd.Perspective(**({"to_world": np.eye(4), "fov": 40.0, "film": jd.Film(4, 4)} | arguments))


def test_up_along_the_view():
    with pytest.raises(ValueError, match="parallel to the view direction"):
        jd.look_at((0, 0, 1), (0, 0, 0), (0, 0, 1))
