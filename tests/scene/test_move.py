"""Shapes and cameras moved by name: closed forms, and the derivative at rest against `motion`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxdr as jd
from jaxdr.scene.motion import motion

CENTRE = np.array([4.0, 5.0, 6.0])


@pytest.fixture(scope="module")
def scene():
    camera = jd.Perspective(jd.look_at((0, -5, 1), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(8, 8))
    shapes = {"spot": jd.Shape(jd.shapes.box(size=(1, 2, 3), center=CENTRE)), "floor": jd.Shape(jd.shapes.plane(9.0))}
    return jd.Scene(shapes, camera)


def local(scene):
    return np.asarray(scene.parameters()["spot.vertices"], float) - CENTRE


def test_scaled_then_turned_then_translated_whatever_the_order(scene):
    motions = {
        "spot.translate": [0.5, 0.0, 0.0],
        "spot.rotate.z": 0.7,
        "spot.translate.y": -2.0,
        "spot.scale": 2.0,
        "spot.rotate.x": -0.4,
        "spot.scale.z": 0.5,
        "spot.rotate": [0.1, 0.2, 0.3],
    }
    turn = (
        Rotation.from_rotvec([0, 0, 0.7]) * Rotation.from_rotvec([-0.4, 0, 0]) * Rotation.from_rotvec([0.1, 0.2, 0.3])
    )
    expected = (local(scene) * [2, 2, 1]) @ turn.as_matrix().T + CENTRE + [0.5, -2, 0]
    for order in (motions, dict(reversed(motions.items()))):
        moved = jd.move(scene, order)
        np.testing.assert_allclose(moved.parameters()["spot.vertices"], expected, atol=1e-5)
    rest = moved.parameters()
    assert np.array_equal(rest["floor.vertices"], scene.parameters()["floor.vertices"])
    assert np.array_equal(rest["camera.to_world"], scene.parameters()["camera.to_world"])


def test_a_camera_turns_about_its_position(scene):
    pose = np.asarray(scene.parameters()["camera.to_world"], float)
    found = np.asarray(jd.move(scene, {"camera.rotate.z": 0.3, "camera.translate.x": 2.0}).camera.to_world)
    np.testing.assert_allclose(found[:3, :3], Rotation.from_rotvec([0, 0, 0.3]).as_matrix() @ pose[:3, :3], atol=1e-6)
    np.testing.assert_allclose(found[:3, 3], pose[:3, 3] + [2, 0, 0], atol=1e-6)


@pytest.mark.parametrize("owner", ["spot", "camera"])
@pytest.mark.parametrize("kind", ["translate", "rotate"])
@pytest.mark.parametrize("axis", "xyz")
def test_small_motions_are_those_of_derivative_images(scene, owner, kind, axis):
    name = f"{owner}.{kind}.{axis}"
    ((key, (value, tangent)),) = motion(scene, name).items()
    primal, found = jax.jit(
        lambda by: jax.jvp(lambda by: jd.move(scene, {name: by}).parameters()[key], (by,), (jnp.ones(()),))
    )(jnp.zeros(()))
    np.testing.assert_allclose(primal, value, atol=1e-6)
    np.testing.assert_allclose(found, tangent, atol=1e-5)


GROUP = "spot+floor"


def test_a_group_moves_as_one(scene):
    """About the centre of the common box: x and y of the floor's, z between the floor and the top of the box."""
    found = jd.move(scene, {f"{GROUP}.translate.x": 3.0, f"{GROUP}.rotate.z": 0.7, f"{GROUP}.scale": 2.0}).parameters()
    points = [np.asarray(scene.parameters()[f"{name}.vertices"], float) for name in ("spot", "floor")]
    low, high = np.concatenate(points).min(0), np.concatenate(points).max(0)
    about, turn = (low + high) / 2, Rotation.from_rotvec([0, 0, 0.7]).as_matrix()
    for name, before in zip(("spot", "floor"), points, strict=True):
        expected = 2 * (before - about) @ turn.T + about + [3, 0, 0]
        np.testing.assert_allclose(found[f"{name}.vertices"], expected, atol=2e-5)


def test_a_group_moves_after_its_shapes(scene):
    motions = {f"{GROUP}.translate.x": 1.0, "spot.scale": 3.0, f"{GROUP}.rotate.y": 0.2}
    one = jd.move(jd.move(scene, {"spot.scale": 3.0}), {k: v for k, v in motions.items() if k.startswith(GROUP)})
    for name, value in jd.move(scene, motions).parameters().items():
        np.testing.assert_allclose(value, one.parameters()[name], atol=1e-5)


@pytest.mark.parametrize("name", [f"{GROUP}.rotate.y", f"{GROUP}.translate.z"])
def test_small_motions_of_groups_are_those_of_derivative_images(scene, name):
    moved = motion(scene, name)
    found = jax.jvp(lambda by: jd.move(scene, {name: by}).parameters(), (jnp.zeros(()),), (jnp.ones(()),))[1]
    assert set(moved) == {"spot.vertices", "floor.vertices"}
    for key, (_, tangent) in moved.items():
        np.testing.assert_allclose(found[key], tangent, atol=1e-5)


def test_a_name_with_a_plus_is_a_shape_first(scene):
    named = jd.Scene(scene.shapes | {GROUP: scene.shapes["spot"]}, scene.camera)
    assert list(motion(named, f"{GROUP}.translate.x")) == [f"{GROUP}.vertices"]
    moved = jd.move(named, {f"{GROUP}.translate.x": 1.0}).parameters()
    assert np.array_equal(moved["spot.vertices"], named.parameters()["spot.vertices"])


def test_the_image_of_a_translated_shape(scene):
    lit = jd.Scene(scene.shapes, scene.camera, jd.ConstantEnvironment(1.0))
    moved = lit.replace({"spot.vertices": lit.parameters()["spot.vertices"] + jnp.asarray([-4.0, -5.0, -6.0])})
    key = jax.random.key(0)
    np.testing.assert_array_equal(
        jd.render(jd.move(lit, {"spot.translate": -CENTRE}), key, 4), jd.render(moved, key, 4)
    )


@pytest.mark.parametrize(
    ("motions", "message"),
    [
        (
            {"sport.translate.x": 1.0},
            "'sport.translate.x' is no motion of this scene; did you mean 'spot.translate.x'?",
        ),
        ({"camera.scale": 2.0}, "'camera.scale' is no motion"),
        ({"spot+spot.translate.x": 2.0}, "'spot.spot.translate.x' is no motion"),
        ({"spot+roof.translate.x": 2.0}, "'spot.roof.translate.x' is no motion"),
        ({"spot.vertices": 1.0}, "known: floor.scale, .* camera.translate; .x, .y, .z"),
        ({"spot.rotate.": 1.0}, "is no motion"),
        ({"spot.rotate.w": 1.0}, "is no motion"),
        ({"spot.translate": 1.0}, r"spot.translate has shape \[3\], got \[\]"),
        ({"spot.translate.x": [1.0, 2.0]}, r"spot.translate.x has shape \[\], got \[2\]"),
        ({"spot.scale": [1.0, 2.0]}, r"spot.scale has shape \[\] or \[3\], got \[2\]"),
        ({"spot.translate.x": "far"}, "spot.translate.x must be made of numbers, got 'far'"),
        ({"spot.translate.x": float("nan")}, "Scene.replace: spot.vertices"),
    ],
)
def test_mistakes(scene, motions, message):
    with pytest.raises(ValueError, match=message):
        jd.move(scene, motions)
