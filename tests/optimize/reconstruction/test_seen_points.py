"""Sparse points of the object: which are taken, how far the surface is from them, and a start that is near them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.pictures import Pose
from jaxdr.optimize.reconstruction.seen_points import (
    FEW,
    MOST,
    WIDTH,
    SeenPoints,
    in_frame,
    of_sparse_points,
    point_loss,
    seen_points,
    settled,
)
from jaxdr.views.record import View, Views
from jaxdr.views.sparse_points import SparsePoints
from tests.optimize.reconstruction.test_start import CENTRE, RADIUS, all_around

DIRECTIONS = np.random.default_rng(0).normal(size=(2000, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
BALL = shapes.sphere(4, radius=0.5)
POSE = Pose(CENTRE, 2 * RADIUS)


def seen(radius) -> SeenPoints:
    """Points at some distance from the origin, straight ahead of cameras."""
    return SeenPoints(jnp.asarray(3 * DIRECTIONS, float), jnp.asarray(radius * DIRECTIONS, float))


@pytest.mark.parametrize("off", [0.01, -0.015])
def test_the_loss_is_the_squared_distance(off):
    loss, gradient = jax.value_and_grad(lambda v: point_loss(BALL, v, seen(0.5 + off)))(BALL.vertices)
    np.testing.assert_allclose(loss, off**2, rtol=0.1)  # the ball has faces
    # Moving all vertices outward by one changes the distance by one.
    outward = (gradient * BALL.vertices / 0.5).sum()
    np.testing.assert_allclose(outward, -2 * off, rtol=0.1)


def test_far_points_count_by_their_distance_and_missed_ones_not():
    np.testing.assert_allclose(point_loss(BALL, BALL.vertices, seen(0.8)), WIDTH * (2 * 0.3 - WIDTH), rtol=0.01)
    beside = SeenPoints(*(jnp.asarray(each) + jnp.asarray([0.0, 0.0, 500.0]) for each in seen(0.6)))
    loss, gradient = jax.value_and_grad(lambda v: point_loss(BALL, v, beside))(BALL.vertices)
    assert loss == 0 and (gradient == 0).all()


def test_the_surface_settles_where_points_were_seen():
    """A dent of a tenth of the ball, which no outline shows."""
    dent = np.where(DIRECTIONS[:, 2:] > 0.7, 0.4, 0.5)
    points = SeenPoints(jnp.asarray(3 * DIRECTIONS, float), jnp.asarray(dent * DIRECTIONS, float))
    start = Mesh(BALL.vertices, BALL.faces)
    found = settled(start, points)
    before, after = (float(point_loss(start, mesh.vertices, points)) for mesh in (start, found))
    assert after < 0.1 * before
    middle = np.asarray(found.vertices)[np.asarray(BALL.vertices)[:, 2] > 0.48]
    np.testing.assert_allclose(np.linalg.norm(middle, axis=1), 0.4, atol=0.015)


def views_with_points() -> tuple[Views, SparsePoints]:
    """Photographs of a ball, the first one held out. Points: of the ball, and two of what is behind it."""
    views = [View(**{**vars(view), "held_out": i == 0}) for i, view in enumerate(all_around())]
    behind = CENTRE + np.array([[0.0, 0.0, 3 * RADIUS], [3 * RADIUS, 0.0, 0.0]])
    points = np.concatenate([CENTRE + RADIUS * DIRECTIONS[:200], behind])
    saw = np.stack([(points - CENTRE) @ (view.to_world[:3, 3] - CENTRE) > RADIUS for view in views])
    saw[:, 200:] = True
    return Views(views[0].path, tuple(views)), SparsePoints(points, saw)


def test_points_inside_of_the_masks_are_taken():
    views, points = views_with_points()
    found = seen_points(*in_frame([of_sparse_points(views, points)], POSE))
    assert found is not None
    np.testing.assert_allclose(np.linalg.norm(found.point, axis=1), 0.5, atol=1e-5)  # none of those behind
    np.testing.assert_allclose(np.linalg.norm(found.origin, axis=1), 2 / (2 * RADIUS), rtol=1e-5)
    assert len(found.point) == points.saw[1:, :200].sum()  # held-out photographs tell nothing
    # Every ray ends on its own side.
    assert (np.einsum("ni,ni->n", found.origin, found.point) > 0).all()


def test_few_points_tell_nothing_and_many_are_thinned_out():
    views, points = views_with_points()
    none = of_sparse_points(views, None)
    assert none[1].shape == (0, 3)
    few = SparsePoints(points.positions, points.saw & (np.cumsum(points.saw, axis=1) < 2))
    assert 0 < few.saw.sum() < FEW
    for rows in ([none], [none, of_sparse_points(views, few)]):
        assert seen_points(*in_frame(rows, POSE)) is None
    many = seen_points(*np.random.default_rng(0).normal(size=(2, 3 * MOST, 3)))
    assert many is not None and many.point.shape == (MOST, 3)
