"""What stands still leaves the candidates of segments that stand still: derivatives are the same, pairs are fewer."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.kernel_density.moving_edges import _joined
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.geometry.queries import Candidates
from jaxdr.geometry.shapes import box, plane, rectangle, transformed
from jaxdr.scene.camera import look_at

KEY = jax.random.key(3)
BALL = (True, False, False, False)  # of ball, floor, lamp, post


@pytest.fixture(scope="module")
def scene():
    """A post whose shadow falls on the ball, and both shadows on the floor."""
    lamp = transformed(rectangle(0.6, 0.6), look_at((2.0, 0.0, 2.5), (0, 0, 0), (0, 0, 1)))
    shapes = {
        "ball": jd.Shape(box((0.8, 0.8, 0.8), center=(-0.4, 0.0, 0.5))),
        "floor": jd.Shape(plane(6.0)),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(10.0)),
        "post": jd.Shape(box((0.2, 0.2, 1.6), center=(0.5, 0.0, 0.8))),
    }
    return jd.Scene(shapes, jd.Perspective(look_at((0.5, -4, 2.5), (0, 0, 0.4), (0, 0, 1)), 40.0, jd.Film(24, 24)))


def boundary(scene, estimator, moving, names=("ball",)):
    """Derivative of the boundary term for a translation of some shapes, with those edges that `moving` leaves."""
    values = {f"{name}.vertices": scene.parameters()[f"{name}.vertices"] for name in names}
    tracer = jd.PathTracer(max_depth=2, boundary=estimator)
    flags = jd.Moving(moving, False)

    @jax.jit
    def derivative(scene, key):
        def term(t):
            moved = scene.replace({name: value + t * jnp.array([0.3, 1.0, 0.2]) for name, value in values.items()})
            return jd.derivative_terms(moved, key, 16, tracer, flags)["boundary"]

        return jax.jvp(term, (0.0,), (1.0,))[1]

    return np.asarray(derivative(scene, KEY))


def test_derivatives_are_the_same(scene):
    every, fewer = (boundary(scene, jd.KernelDensity(0.05), moving) for moving in ((True,) * 4, BALL))
    size = np.sqrt(np.mean(every**2))
    assert size > 0.01
    np.testing.assert_allclose(fewer, every, atol=2e-4 * size, rtol=1e-3)


def test_it_matters_which_ends_move(scene, monkeypatch):
    """The edges of the post bound what the ball, which moves, sees of the lamp: without them something is missing."""
    right = boundary(scene, jd.KernelDensity(0.05), BALL)

    def everything(self, moving):
        return jnp.ones(self.count, bool)

    monkeypatch.setattr(PathSegments, "stand_still", everything)
    wrong = boundary(scene, jd.KernelDensity(0.05), BALL)
    assert np.sqrt(np.mean((right - wrong) ** 2)) > 0.02 * np.sqrt(np.mean(right**2))


def lists(one, two, capacity):
    def listed(numbers, weight):
        room = jnp.full(capacity, -1).at[: len(numbers)].set(jnp.asarray(numbers, jnp.int32))
        return Candidates(room.astype(jnp.int32), room * 10, jnp.asarray(len(numbers)), jnp.asarray(weight))

    return listed(one, 1.0), listed(two, 2.0)


def test_two_lists_in_the_room_of_one():
    joined = _joined(*lists([0, 1, 2], [3, 4], 6), jax.random.key(0))
    np.testing.assert_array_equal(joined.segment, [0, 1, 2, 3, 4, -1])
    np.testing.assert_array_equal(joined.element[:5], [0, 10, 20, 30, 40])
    np.testing.assert_array_equal(joined.weight[:5], [1, 1, 1, 2, 2])
    assert joined.count == 5


def test_what_does_not_fit_is_thinned_without_bias():
    one, two = lists([0, 1, 2, 3], [4, 5, 6], 4)
    keys = jax.random.split(jax.random.key(1), 4000)
    joined = jax.vmap(lambda key: _joined(one, two, key))(keys)
    assert (joined.segment >= 0).all() and joined.segment.shape == (4000, 4)
    mean = np.zeros(7)
    np.add.at(mean, np.asarray(joined.segment).ravel(), np.asarray(joined.weight).ravel() / len(keys))
    np.testing.assert_allclose(mean, [1, 1, 1, 1, 2, 2, 2], rtol=0.08)
