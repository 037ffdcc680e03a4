"""The closed form itself, against quadrature over the light, central differences and symmetries."""

import numpy as np
import pytest

from tests.references.polygon_shadow import irradiance, irradiance_derivatives, silhouette

POINT = np.array([0.1, -0.2, 0.05])
NORMAL = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
SQUARE = np.array([[-1, -1, 2.0], [-1, 1.2, 2.0], [1.3, 1, 2.0], [1, -0.9, 2.0]])
ANGLES = np.linspace(2 * np.pi, 0, 10, endpoint=False)
STAR = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], 1) * np.tile([1.5, 0.6], 5)[:, None] + [0.2, 0.1, 2.0]
SLANTED = np.array([[1.0, -1, -0.4], [1, 1, -0.4], [1.6, 1, 2], [1.6, -1, 2]])[::-1]  # reaches below the horizon
TRIANGLE = np.array([[0.0, -0.4, 1.0], [0.5, 0.2, 1.2], [-0.3, 0.4, 0.9]])
HALF_PLANE = np.array([[-9.0, -9, 1.0], [0.1, -9, 1.0], [0.3, 9, 1.0], [-9, 9, 1.0]])
SCREEN = np.array([[0.6, -0.5, 0.1], [0.6, 0.3, 0.0], [0.7, 0.2, 1.0]])
CASES = {
    "square": (SQUARE, TRIANGLE),
    "square, edge across": (SQUARE, HALF_PLANE),
    "star": (STAR, TRIANGLE),
    "horizon": (SLANTED, SCREEN),
}


def quadrature(light, blocker, n):
    """Midpoint rule over the light's bounding parallelogram, with crossing tests in place of clipping."""
    origin, u = light[0], light[1] - light[0]
    facing = np.sum(np.cross(light - origin, np.roll(light - origin, -1, axis=0)), axis=0)
    facing /= np.linalg.norm(facing)
    frame = np.stack([u / np.linalg.norm(u), np.cross(facing, u / np.linalg.norm(u))])
    flat = (light - origin) @ frame.T
    low, high = flat.min(0), flat.max(0)
    grid = low + (high - low) * (np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2), -1).reshape(-1, 2))
    to_light = origin + grid @ frame - POINT
    cosine = to_light @ NORMAL
    distance2 = np.sum(to_light**2, 1)
    # where the ray crosses the blocker's plane, in that plane's own coordinates
    a, b, c = blocker[:3]
    plane = np.cross(b - a, c - a)
    own = np.stack([(b - a) / np.linalg.norm(b - a), np.cross(plane, b - a) / np.linalg.norm(np.cross(plane, b - a))])
    crossing = to_light * ((a - POINT) @ plane / (to_light @ plane))[:, None]
    hidden = inside((crossing + POINT - a) @ own.T, (blocker - a) @ own.T) & (np.sum(crossing * to_light, 1) > 0)
    lit = inside(grid, flat) & ~hidden & (cosine > 0)
    f = np.where(lit, cosine * -(to_light @ facing) / distance2**2, 0.0)
    return f.sum() * np.prod(high - low) / n**2


def inside(points, polygon):
    x, y = points.T
    odd = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return odd


@pytest.mark.parametrize("case", CASES)
def test_irradiance_is_the_integral_over_the_visible_light(case):
    light, blocker = CASES[case]
    exact = irradiance(POINT, NORMAL, light, [blocker])
    assert exact < 0.97 * irradiance(POINT, NORMAL, light), "the blocker must matter"
    np.testing.assert_allclose(exact, quadrature(light, blocker, 1200), rtol=1e-3)


def test_unblocked_square_above_the_point():
    """A coaxial square of half side a at height h gives 4 a/√(h²+a²) atan(a/√(h²+a²))."""
    a, h = 0.7, 1.3
    square = np.array([[-a, -a, h], [-a, a, h], [a, a, h], [a, -a, h]])
    q = np.hypot(a, h)
    np.testing.assert_allclose(irradiance(np.zeros(3), [0, 0, 1.0], square), 4 * a / q * np.arctan(a / q), rtol=1e-12)


def test_behind_the_light_is_dark():
    assert irradiance(POINT, NORMAL, SQUARE[::-1], [TRIANGLE]) == 0.0


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_the_irradiance(case):
    light, blocker = CASES[case]
    (d_blocker,), d_light, d_point = irradiance_derivatives(POINT, NORMAL, light, [blocker])
    step = 1e-6

    def difference(which, index, axis):
        values = []
        for sign in (1, -1):
            moved = [POINT.copy(), light.copy(), blocker.copy()]
            moved[which][(*index, axis)] += sign * step
            values.append(irradiance(moved[0], NORMAL, moved[1], [moved[2]]))
        return (values[0] - values[1]) / (2 * step)

    for i, axis in np.ndindex(blocker.shape):
        np.testing.assert_allclose(d_blocker[i, axis], difference(2, (i,), axis), atol=2e-8)
    for i, axis in np.ndindex(light.shape):
        np.testing.assert_allclose(d_light[i, axis], difference(1, (i,), axis), atol=2e-8)
    for axis in range(3):
        np.testing.assert_allclose(d_point[axis], difference(0, (), axis), atol=2e-8)


def test_orientation_of_the_blocker_does_not_matter():
    forward = irradiance_derivatives(POINT, NORMAL, SQUARE, [TRIANGLE])[0][0]
    backward = irradiance_derivatives(POINT, NORMAL, SQUARE, [TRIANGLE[::-1]])[0][0]
    np.testing.assert_allclose(forward, backward[::-1], atol=1e-14)


def test_pieces_make_a_whole():
    """A blocker cut in two hides the same, and its derivatives add up: those of the common edge cancel."""
    middle = 0.3 * TRIANGLE[1] + 0.7 * TRIANGLE[2]
    pieces = [np.array([TRIANGLE[0], TRIANGLE[1], middle]), np.array([TRIANGLE[0], middle, TRIANGLE[2]])]
    whole = irradiance(POINT, NORMAL, SQUARE, [TRIANGLE])
    np.testing.assert_allclose(irradiance(POINT, NORMAL, SQUARE, pieces), whole, rtol=1e-14)
    (one,), light, point = irradiance_derivatives(POINT, NORMAL, SQUARE, [TRIANGLE])
    (first, second), light_of_two, point_of_two = irradiance_derivatives(POINT, NORMAL, SQUARE, pieces)
    np.testing.assert_allclose(first[0] + second[0], one[0], atol=1e-14)
    np.testing.assert_allclose(first[2] + second[1] + first[1] + second[2], one[1] + one[2], atol=1e-14)
    np.testing.assert_allclose(light_of_two, light, atol=1e-14)
    np.testing.assert_allclose(point_of_two, point, atol=1e-14)


def test_silhouette_of_a_box():
    corners = np.array(list(np.ndindex(2, 2, 2)), float)
    assert len(silhouette([0.5, 0.5, -3], corners)) == 4
    assert len(silhouette([-3, -4, -5.0], corners)) == 6
