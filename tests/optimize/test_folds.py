"""Folded edges are counted."""

import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.optimize.folds import folded_share


def hinge(angle):
    """Two triangles that turn by an angle (degrees) at their common edge."""
    turn = np.deg2rad(angle)
    points = [[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [np.cos(turn), 0.5, np.sin(turn)]]
    return jd.Mesh(points, [[0, 1, 2], [1, 0, 3]])


@pytest.mark.parametrize(
    ("angle", "expected"), [(0, 0.0), (100, 0.0), (-100, 0.0), (130, 1.0), (-130, 1.0), (179, 1.0)]
)
def test_a_hinge(angle, expected):
    assert folded_share(hinge(angle)) == expected


def test_faces_without_area_count():
    points = np.array([[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [0, 0.5, 0]])
    assert folded_share(hinge(0).with_vertices(points)) == 1.0


def test_whole_meshes():
    assert folded_share(shapes.sphere(3)) == 0.0
    assert folded_share(shapes.box()) == 0.0
    one = jd.Mesh(np.eye(3), [[0, 1, 2]])
    assert folded_share(one) == 0.0
