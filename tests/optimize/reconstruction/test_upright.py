"""Which way is up, from how people hold cameras."""

from pathlib import Path

import numpy as np
import pytest

from jaxdr.optimize.reconstruction.upright import circle, upright
from jaxdr.scene.camera import look_at
from jaxdr.views.pictures import Pixels
from jaxdr.views.record import View

UP = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
CENTRE = np.array([5.0, 3.0, -2.0])


def views(poses) -> list[View]:
    picture = Pixels(np.zeros((4, 4, 3), np.float32))
    return [View(f"v{i}", Path(f"v{i}.png"), picture, pose, 4.0, (2.0, 2.0)) for i, pose in enumerate(poses)]


def on_the_side(angle: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    return turn


@pytest.mark.parametrize("angle", [0.0, np.pi / 2, -np.pi / 2])
def test_of_a_walk_around_an_object(angle):
    poses = [pose @ on_the_side(angle) for pose in circle(UP, CENTRE, 3.0, 9)]
    np.testing.assert_allclose(upright(views(poses)), UP, atol=1e-6)


def test_of_half_a_walk_at_several_heights_held_nearly_level():
    random = np.random.default_rng(0)
    poses = []
    for angle in np.linspace(0, np.pi, 20):
        height = random.uniform(-0.3, 2)
        pose = look_at((3 * np.cos(angle), 3 * np.sin(angle), height), (0, 0, 0), (0, 0, 1))
        poses.append(pose @ on_the_side(random.normal(0, 0.05)))
    assert upright(views(poses)) @ [0, 0, 1] > np.cos(np.radians(3))


def test_of_cameras_that_are_not_level_or_few_it_is_what_is_up_in_their_pictures():
    poses = circle(UP, CENTRE, 3.0, 2)
    mean = poses[0][:3, 1] + poses[1][:3, 1]
    np.testing.assert_allclose(upright(views(poses)), mean / np.linalg.norm(mean), atol=1e-9)
    random = np.random.default_rng(1)
    poses = [pose @ on_the_side(random.uniform(-1.2, 1.2)) for pose in circle(UP, CENTRE, 3.0, 40)]
    assert upright(views(poses)) @ UP > 0.8


def test_a_circle_is_around_what_is_up():
    poses = np.stack(circle(UP, CENTRE, 3.0, 8))
    offsets = poses[:, :3, 3] - CENTRE
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), 3.0)
    np.testing.assert_allclose(offsets @ UP, 3.0 * 0.34)
    np.testing.assert_allclose(poses[:, :3, 2], -offsets / 3.0, atol=1e-9)
    np.testing.assert_allclose(poses[:, :3, 0] @ UP, 0, atol=1e-9)
