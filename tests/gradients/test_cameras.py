"""Shadows seen by other cameras than a pinhole, against exact numbers: the floor point of `floor_point`.

A parallel camera sees it along the same ray; all rays through a lens that is focused on it end there.
"""

import numpy as np
import pytest

import jaxdr as jd
from tests.boundary.test_film_edges_cameras import lens_points
from tests.gradients import floor_point
from tests.gradients.floor_point import CAMERA, FILM, POINT, QUADRANGLE, UP, estimates, exact, mean_and_error, sheet

POSE = jd.look_at(CAMERA, POINT, UP)
DISTANCE = float(np.linalg.norm(CAMERA - POINT))
TINY = jd.Film(FILM, FILM, jd.Box())
RADIUS = 1.5
CAMERAS = {
    "parallel": jd.Orthographic(POSE @ np.diag([5e-4, 5e-4, 1.0, 1.0]), TINY),
    "lens": jd.ThinLens(POSE, 0.01, TINY, RADIUS, DISTANCE),
}


def slide(kind):
    """How the point moves as the floor rises: along the ray, the mean over the lens."""
    points, weights = lens_points(8, 32) if kind == "lens" else (np.zeros((1, 2)), np.ones(1))
    origin = CAMERA + RADIUS * points @ POSE[:3, :2].T
    return weights @ (origin / origin[:, 2:])


@pytest.mark.parametrize(
    ("kind", "boundary"),
    [
        ("parallel", floor_point.SHEET),
        ("lens", floor_point.SHEET),
        pytest.param("parallel", jd.LineSampling(), marks=pytest.mark.slow),
        pytest.param("lens", jd.LineSampling(), marks=pytest.mark.slow),
    ],
    ids=lambda x: type(x).__name__ if not isinstance(x, str) else x,
)
def test_shadow_derivatives_are_the_closed_form(kind, boundary):
    blocker = sheet(QUADRANGLE, 0.1)
    value, truth = exact(blocker)
    central = CAMERA / CAMERA[2]
    d_point = floor_point.REFLECTANCE / np.pi * floor_point.RADIANCE * _d_point(blocker)
    assert np.isclose(truth["floor.height"], d_point @ central)
    truth["floor.height"] = d_point @ slide(kind)
    of = floor_point.scene(blocker)
    of = jd.Scene(of.shapes, CAMERAS[kind])
    radiance, rows = estimates(of, boundary, sampling="mis")
    mean, deviation = mean_and_error(radiance)
    assert abs(mean - value) < 0.002 * value + 4 * deviation
    for name, true in truth.items():
        scale = max(np.max(np.abs(true)), np.max(np.abs(truth["blocker.vertices"])))
        mean, deviation = (x / scale for x in mean_and_error(rows[name]))
        assert np.max(deviation) < 0.03, f"{name}: too few samples, ± {np.max(deviation):.3f}"
        wrong = np.abs(mean - true / scale) > 0.005 + 4 * deviation
        assert not np.any(wrong), f"{name} is off:\n{mean}\n± {deviation}, exactly\n{true / scale}"


def _d_point(blocker):
    """Derivative of the irradiance by the point's position."""
    vertices = np.asarray(blocker.vertices, float)
    pieces = [vertices[face] for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    return floor_point.irradiance_derivatives(POINT, UP, floor_point.LIGHT, pieces)[2]
