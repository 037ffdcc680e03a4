"""Projections of points onto a shape along a line: `warp` and `jax` against every line-face pair in float64."""

import numpy as np
import pytest

from jaxdr.geometry import queries
from jaxdr.geometry.queries import IMPLEMENTATIONS
from tests.geometry.queries.query_meshes import arrays, ask, every_crossing, make

COUNT = 100


def lines(vertices, seed):
    """Points near the surface, random unit directions and depths."""
    rng = np.random.default_rng(seed)
    size = np.ptp(vertices, axis=0).max()
    point = vertices[rng.integers(len(vertices), size=COUNT)] + 0.05 * size * rng.standard_normal((COUNT, 3))
    normal = rng.standard_normal((COUNT, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    depth = size * rng.uniform(0.05, 2.0, COUNT)
    return (a.astype(np.float32) for a in (point, normal, depth))


def project(implementation, vertices, faces, of_shape, point, normal, depth, shape, capacity=16):
    arguments = queries.Geometry(vertices, faces), of_shape, queries.Lines(point, normal, depth, shape)
    return ask(queries.projections, *arguments, capacity=capacity, implementation=implementation)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", ["trefoil", "box, rotated", "plane"])
def test_every_projection_is_found(name, implementation):
    """Faces, heights, order and counts; faces of another shape do not count."""
    vertices, faces = arrays(make(name))
    of_shape = (np.arange(len(faces)) % 3 == 0).astype(np.int32)
    point, normal, depth = lines(vertices, seed=1)
    shape = np.arange(COUNT, dtype=np.int32) % 2
    found = project(implementation, vertices, faces, of_shape, point, normal, depth, shape)
    crossing = every_crossing(vertices, faces, point, normal)
    mine, error = of_shape[None] == shape[:, None], crossing.t_error + 1e-6 * depth[:, None]
    near = mine & (np.abs(crossing.t) < depth[:, None] + error) & (crossing.inside > -4)
    sure = mine & (np.abs(crossing.t) < depth[:, None] - error) & (crossing.inside > 4)
    assert sure.sum() > 20, "the lines don't test much"
    for i in range(COUNT):
        kept, height = found.face[i, : found.count[i]], found.height[i, : found.count[i]]
        assert np.all(np.diff(np.abs(height)) >= 0), "not sorted"
        assert set(np.flatnonzero(sure[i])) <= set(kept) <= set(np.flatnonzero(near[i]))
        assert len(set(kept)) == found.count[i] and np.all(found.face[i, found.count[i] :] == -1)
        assert np.all(np.abs(height - crossing.t[i, kept]) <= error[i, kept])


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.filterwarnings("ignore:jaxdr")
def test_the_nearest_are_kept_and_all_are_counted(implementation):
    vertices, faces = arrays(make("trefoil"))
    of_shape, shape = np.zeros(len(faces), np.int32), np.zeros(COUNT, np.int32)
    point, normal, depth = lines(vertices, seed=2)
    rays = vertices, faces, of_shape, point, normal, depth, shape
    every, few = project(implementation, *rays), project(implementation, *rays, capacity=2)
    assert (every.count > 2).sum() > 10
    assert np.all(few.count == every.count)
    assert np.array_equal(few.face, every.face[:, :2]) and np.array_equal(few.height, every.height[:, :2])


def test_too_many_are_reported():
    vertices, faces = arrays(make("trefoil"))
    point, normal, depth = lines(vertices, seed=2)
    none = np.zeros(COUNT, np.int32)
    with pytest.warns(UserWarning, match="more projections"):
        project("warp", vertices, faces, np.zeros(len(faces), np.int32), point, normal, depth, none, capacity=1)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_a_depth_of_zero_leaves_a_point_out(implementation):
    vertices, faces = arrays(make("plane"))
    point, normal, depth = lines(vertices, seed=3)
    none = np.zeros(COUNT, np.int32)
    found = project(implementation, vertices, faces, np.zeros(len(faces), np.int32), point, normal, 0 * depth, none)
    assert np.all(found.count == 0) and np.all(found.face == -1)
