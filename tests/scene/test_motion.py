"""Motions by name against finite differences of the motion itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxdr.geometry.shapes import box
from jaxdr.scene.bsdf import Diffuse
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.film import Film
from jaxdr.scene.motion import motion
from jaxdr.scene.scene import Scene, Shape

STEP = 1e-3


@pytest.fixture(scope="module")
def scene():
    camera = Perspective(look_at((0, -5, 1), (0, 0, 0), (0, 0, 1)), 30.0, Film(8, 8))
    return Scene({"spot": Shape(box(size=(1, 2, 3), center=(4, 5, 6)), Diffuse(0.5))}, camera)


def only(moved: dict, name: str):
    """Value and derivative of the one parameter that moves."""
    assert list(moved) == [name]
    return moved[name]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_shapes(scene, axis):
    direction = np.eye(3)[axis]
    value, tangent = only(motion(scene, f"spot.translate.{'xyz'[axis]}"), "spot.vertices")
    np.testing.assert_array_equal(tangent, np.broadcast_to(direction, value.shape))

    value, tangent = only(motion(scene, f"spot.rotate.{'xyz'[axis]}"), "spot.vertices")
    turned = [
        (np.asarray(value) - [4, 5, 6]) @ Rotation.from_rotvec(angle * direction).as_matrix().T
        for angle in (-STEP, STEP)
    ]
    np.testing.assert_allclose(tangent, (turned[1] - turned[0]) / (2 * STEP), atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_camera(scene, axis):
    direction = np.eye(3)[axis]
    value, tangent = only(motion(scene, f"camera.translate.{'xyz'[axis]}"), "camera.to_world")
    np.testing.assert_array_equal(tangent[:3, 3], direction)
    assert not np.any(tangent[:, :3]) and not np.any(tangent[3])

    value, tangent = only(motion(scene, f"camera.rotate.{'xyz'[axis]}"), "camera.to_world")
    turned = [
        Rotation.from_rotvec(angle * direction).as_matrix() @ np.asarray(value, float)[:3, :3]
        for angle in (-STEP, STEP)
    ]
    np.testing.assert_allclose(tangent[:3, :3], (turned[1] - turned[0]) / (2 * STEP), atol=1e-5)
    assert not np.any(tangent[:, 3])


@pytest.mark.parametrize("name", ["spot.bsdf.reflectance", "camera.fov"])
def test_plain_parameters_grow_together(scene, name):
    value, tangent = only(motion(scene, name), name)
    np.testing.assert_array_equal(tangent, np.ones_like(value))


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("spot.translat.x", "did you mean 'spot.translate.x'?"),
        ("spot.translate.w", "did you mean 'spot.translate"),
        ("Spot.rotate.x", "did you mean 'spot.rotate.x'?"),
        ("spot.vertices", "known: spot.translate|rotate.x|y|z, camera.translate"),
        ("nonsense", "known: spot.translate|rotate.x|y|z, camera.translate"),
    ],
)
def test_unknown_names(scene, name, hint):
    with pytest.raises(ValueError) as caught:
        motion(scene, name)
    assert str(caught.value).startswith(f"'{name}' is not a motion or parameter of this scene")
    assert hint in str(caught.value)
