"""The kernel-density boundary term against exact numbers: a floor point, a polygonal light, a polygonal blocker.

No finite differences and no other renderer: value and derivatives are those of `tests/references/polygon_shadow.py`.
"""

import jax
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_point import (
    BOOMERANG,
    BOX,
    CLOSED,
    HALF_PLANE,
    QUADRANGLE,
    RELATIVE_RADIUS,
    SHEET,
    check_derivatives,
    estimates,
    exact,
    mean_and_error,
    scene,
    sheet,
)

# The paper's kernel of points: half a disc, on the visible side.
POINTS = jd.KernelDensity(RELATIVE_RADIUS, kernel="point", iterations=1, points=1024, widest=0.0, both_sides=False)
# Everything evaluated at the path's own vertex, as in the paper.
PLAIN = {"widest": 0.0, "at_boundary": False, "clip_to_face": False}


def error(corners, radius, boundary, moved=(1, 2), keys=6, sampling="emitter"):
    """Relative error of d radiance / d (some corners of a sheet moved along x), and its standard error."""
    blocker = sheet(corners, radius)
    true = exact(blocker)[1]["blocker.vertices"][list(moved), 0].sum()
    rows = estimates(scene(blocker), boundary, keys, sampling=sampling)[1]["blocker.vertices"]
    mean, deviation = mean_and_error(rows[:, list(moved), 0].sum(1))
    return mean / true - 1, deviation / abs(true)


@pytest.mark.parametrize(
    "corners",
    [
        pytest.param(HALF_PLANE, id="half plane"),
        pytest.param(QUADRANGLE, id="quadrangle"),
        pytest.param(BOOMERANG, id="boomerang", marks=pytest.mark.slow),
    ],
)
def test_every_derivative_is_the_closed_form(corners):
    """Blocker vertices, light vertices and the height of the floor in one reverse pass; default settings."""
    check_derivatives(sheet(corners, 0.1), SHEET, sampling="mis")


def test_large_faces_do_not_move_the_rays():
    """Offsets grow with the face a ray leaves; the ray that asks what is visible passes the edge much closer."""
    check_derivatives(sheet(QUADRANGLE, 0.1), SHEET, floor_size=60.0, sampling="mis")


@pytest.mark.slow
def test_closed_form_in_float64():
    with jax.enable_x64(True):
        check_derivatives(sheet(QUADRANGLE, 0.1), SHEET)


@pytest.mark.slow
def test_closed_blocker():
    check_derivatives(BOX, CLOSED)


@pytest.mark.slow
def test_points_have_the_same_limit():
    check_derivatives(sheet(HALF_PLANE, 0.1), POINTS, tolerance=0.015)


@pytest.mark.parametrize("radius", [pytest.param(0.1, marks=pytest.mark.slow), 0.8])
def test_default_has_no_bias_away_from_corners(radius):
    """Evaluated at the boundary, all of the strip stands for the same boundary point, however wide it is."""
    bias, deviation = error(HALF_PLANE, radius, SHEET, sampling="mis")
    assert deviation < 0.01
    assert abs(bias) < 4 * deviation


@pytest.mark.slow
@pytest.mark.parametrize(("both_sides", "order"), [(True, 2), (False, 1)], ids=["both sides", "visible side"])
def test_order_of_the_bias_of_the_plain_version(both_sides, order):
    """Paper, appendix A: the bias of a symmetric kernel is O(r²) away from corners.

    Across the boundary the paper's own kernel is not symmetric, as paths reach the visible side only: it has O(r).
    """
    boundary = jd.KernelDensity(RELATIVE_RADIUS, iterations=1, both_sides=both_sides, **PLAIN)
    radii = np.array([0.3, 0.45, 0.7])
    results = [error(HALF_PLANE, r, boundary, keys=4) for r in radii]
    biases, deviations = np.transpose(results)
    assert np.all(deviations < 0.15 * np.abs(biases)), results
    slope = np.polyfit(np.log(radii), np.log(np.abs(biases)), 1)[0]
    assert abs(slope - order) < 0.4, (slope, results)


@pytest.mark.slow
def test_consistent_version_converges():
    """The paper's Fig. 8, small: the plain version's error falls with the mean radius of the iterations (Eq. 21)."""
    once, often = (jd.KernelDensity(RELATIVE_RADIUS, iterations=t, both_sides=False, **PLAIN) for t in (1, 16))
    first, _ = error(HALF_PLANE, 0.45, once)
    last, deviation = error(HALF_PLANE, 0.45, often)
    mean_radius = np.mean(often.radius_schedule())
    assert mean_radius < 0.4
    assert abs(last / first - mean_radius) < 0.1 * mean_radius + 4 * deviation / abs(first)


@pytest.mark.slow
def test_corner_error_vanishes_with_the_radius():
    """The paper's Fig. 7, small: half a disc stands in for the visible part of it, which is wrong near a notch."""
    results = [error(BOOMERANG, r, POINTS, moved=(0,), keys=10) for r in (0.4, 0.1)]
    (large, _), (small, deviation) = results
    assert abs(large) > 0.1, results
    assert deviation < 0.02 and abs(small) < 0.6 * abs(large), results
