"""Points of stereo pairs, and what is carved away before points that cameras saw."""

from pathlib import Path

import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.carving import carved, hollow
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.optimize.reconstruction.stereo import NARROW, WIDE, pairs_of, rectified, stereo_points
from jaxdr.optimize.warp_distances import surface_distances
from jaxdr.scene.camera import look_at
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View

pytest.importorskip("cv2")
pytest.importorskip("gpytoolbox")

CENTRE, RADIUS, SIZE, FOCAL = np.array([0.2, -0.1, 0.4]), 0.3, 160, 320.0
POSE = Pose(CENTRE, 2 * RADIUS)


def arc(degrees, paint) -> list[View]:
    """Photographs of a ball from places on an arc, by exact rays; every other one is held upside down."""
    views = []
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    for number, angle in enumerate(np.radians(degrees)):
        eye = CENTRE + 1.5 * np.array([np.cos(angle), np.sin(angle), 0.3])
        pose = look_at(eye, CENTRE, (0.1, 0.2, 1 - 2 * (number % 2)))
        ray = np.stack([(SIZE / 2 - x) / FOCAL, (SIZE / 2 - y) / FOCAL, np.ones_like(x)], -1) @ pose[:3, :3].T
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        along = ray @ (CENTRE - eye)
        depth = RADIUS**2 - (((CENTRE - eye) ** 2).sum() - along**2)
        point = eye + (along - np.sqrt(np.maximum(depth, 0)))[..., None] * ray
        image = np.where(depth[..., None] > 0, paint(point), 0.0).astype(np.float32)
        picture = Pixels(image, (depth > 0).astype(np.float32))
        views.append(View(str(number), Path(f"{number}.png"), picture, pose, FOCAL, (SIZE / 2, SIZE / 2)))
    return views


def noisy(point) -> np.ndarray:
    """Paint that tells every place from others nearby."""
    waves = np.random.default_rng(0).normal(0, 40, (8, 3))
    return (0.4 + 0.1 * np.sin(point @ waves.T).sum(-1, keepdims=True).clip(-3.5, 3.5)) * np.ones(3)


def test_points_lie_on_the_object():
    views = arc([0, 8, 16, 24], noisy)
    origin, point = stereo_points(views, POSE, 1.2 * RADIUS)
    assert len(point) > 3000
    off = (np.linalg.norm(point - CENTRE, axis=1) - RADIUS) / RADIUS
    assert abs(np.median(off)) < 0.004 and np.quantile(np.abs(off), 0.9) < 0.015
    # Every point is on the side of the camera that it belongs to.
    towards = np.einsum("ni,ni->n", origin - point, point - CENTRE)
    assert (towards > 0).mean() > 0.99
    again = stereo_points(views, POSE, 1.2 * RADIUS)
    np.testing.assert_array_equal(again[1], point)


def test_photographs_far_apart_and_bare_surfaces_tell_nothing():
    for views in (arc([0, 60], noisy), arc([0, 8], lambda point: np.full_like(point, 0.4))):
        assert len(stereo_points(views, POSE, 1.2 * RADIUS)[1]) < 50


def test_pairs_have_useful_angles():
    views = arc([0, 2, 8, 20, 90, 98], noisy)
    chosen = pairs_of(views, POSE)
    away = np.stack([view.to_world[:3, 3] - CENTRE for view in views])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    angles = np.degrees([np.arccos(away[a] @ away[b]) for a, b in chosen])
    assert (angles > NARROW).all() and (angles < WIDE).all()
    assert {(0, 2), (3, 2), (4, 5)} <= set(chosen) and (0, 1) not in chosen


def test_a_camera_inside_of_the_ball_that_holds_the_object_has_no_pairs():
    views = arc([0, 8], noisy)
    assert rectified(*views, POSE, 1.2 * RADIUS) is not None
    assert rectified(*views, POSE, 1.4) is None


def straight_down(depth: float, count: int = 100) -> tuple[np.ndarray, np.ndarray]:
    """Parallel rays along -z to a square at some height."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.2, 0.2, count)] * 2))
    return np.stack([x, y, np.full_like(x, 3.0)], 1), np.stack([x, y, np.full_like(x, depth)], 1)


def test_what_lies_before_points_is_carved_away():
    ball = shapes.sphere(4, radius=0.5)
    vertices, faces = carved(ball, *straight_down(0.2))
    made = Mesh(vertices, faces)
    assert made.closed
    floor = vertices[(np.abs(vertices[:, :2]) < 0.12).all(1) & (vertices[:, 2] > 0)]
    np.testing.assert_allclose(floor[:, 2], 0.2, atol=0.03)
    below = vertices[vertices[:, 2] < 0]
    np.testing.assert_allclose(np.linalg.norm(below, axis=1), 0.5, atol=0.01)


def test_points_deep_under_a_surface_are_counted():
    ball = shapes.sphere(4, radius=0.5)
    assert hollow(ball, *straight_down(0.2)) == 1
    on_top = [np.concatenate([a, b]) for a, b in zip(straight_down(0.49), straight_down(0.2), strict=True)]
    assert 0.5 <= hollow(ball, *on_top) < 0.6
    assert hollow(ball, np.zeros((0, 3)), np.zeros((0, 3))) == 0


def test_few_rays_carve_nothing():
    ball = shapes.sphere(4, radius=0.5)
    vertices, faces = carved(ball, *straight_down(0.2, count=4))
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.5, atol=0.01)
    distance = surface_distances(
        np.asarray(ball.vertices, np.float32), vertices.astype(np.float32), np.asarray(faces, np.int32)
    )
    assert distance.max() < 0.01


def test_rays_through_everything_are_told():
    ball = shapes.sphere(3, radius=0.5)
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-0.6, 0.6, 300)] * 2))
    origin, point = (np.stack([x, y, np.full_like(x, z)], 1) for z in (3.0, -3.0))
    with pytest.raises(ValueError, match="nothing of the first surface"):
        carved(ball, origin, point)
