"""Parametrisations: what they start from, what they give, and their derivatives."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxdr.geometry.shapes import box
from jaxdr.optimize.recovery.parameters import Bounded, Motion, Plain, Smoothed, angle_between
from jaxdr.scene.camera import look_at


def test_a_rigid_motion_of_a_camera_turns_it_on_the_spot():
    rest = jnp.asarray(look_at((1, 2, 3), (0, 0, 0), (0, 0, 1)), float)
    offset = jnp.asarray([0.0, 0.0, 0.5, 0.1, 0.2, 0.3])
    motion = Motion(rest, offset, (0.0, 0.0, 1.0), "rigid")
    np.testing.assert_array_equal(motion.value(jnp.zeros(6)), rest)
    moved = motion.value(motion.start())
    np.testing.assert_allclose(moved[:3, 3], (1.1, 2.2, 3.3), rtol=1e-6)
    turn = Rotation.from_euler("z", 0.5).as_matrix()
    np.testing.assert_allclose(moved[:3, :3], turn @ np.asarray(rest)[:3, :3], atol=1e-6)
    moved, rest = np.asarray(moved), np.asarray(rest)
    assert angle_between(moved, rest) == pytest.approx(np.rad2deg(0.5), rel=1e-5)
    assert angle_between(3 * moved, rest) == pytest.approx(np.rad2deg(0.5), rel=1e-5)


def test_vertices_turn_about_their_centre():
    rest = box((1.0, 2.0, 3.0), center=(5.0, 0.0, 0.0)).vertices
    moved = Motion(rest, jnp.asarray([np.pi / 2]), (0.0, 0.0, 2.0), "angle").value(jnp.asarray([np.pi / 2]))
    np.testing.assert_allclose(np.ptp(moved, axis=0), (2.0, 1.0, 3.0), rtol=1e-5)
    np.testing.assert_allclose(moved.mean(0), (5.0, 0.0, 0.0), atol=1e-5)
    shifted = Motion(rest, jnp.zeros(3), (0.0, 0.0, 1.0), "translation").value(jnp.asarray([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(shifted - rest, np.broadcast_to((1.0, 2.0, 3.0), rest.shape), rtol=1e-6)
    turned = Motion(rest, jnp.zeros(3), (0.0, 0.0, 1.0), "rotation").value(jnp.asarray([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(turned, moved, atol=1e-5)


def test_bounded_values_stay_inside_and_start_where_they_should():
    initial = jnp.asarray([0.03, 0.5, 0.89])
    bounded = Bounded(initial, (0.02, 0.9))
    np.testing.assert_allclose(bounded.value(bounded.start()), initial, rtol=1e-5)
    assert (bounded.value(jnp.asarray([-9.0, 9.0])) > 0.02).all() and (
        bounded.value(jnp.asarray([-9.0, 9.0])) < 0.9
    ).all()
    with pytest.raises(ValueError, match=r"initial: must lie strictly between the bounds 0 and 1, is 1"):
        Bounded(jnp.asarray([1.0]), (0.0, 1.0))
    with pytest.raises(ValueError, match=r"bounds: must be two increasing numbers"):
        Bounded(jnp.asarray([1.0]), (2.0, 1.0))


def test_smoothed_vertices_start_as_they_are():
    mesh = box()
    smoothed = Smoothed(mesh, 5.0)
    np.testing.assert_allclose(smoothed.value(smoothed.start()), mesh.vertices, atol=1e-6)
    plain = Plain(jnp.arange(3.0))
    np.testing.assert_array_equal(plain.value(plain.start()), jnp.arange(3.0))
