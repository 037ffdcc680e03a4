"""The reference with a constant texture is the closed form of polygonal lights."""

import numpy as np
import pytest

from tests.references.polygon_shadow import irradiance
from tests.references.textured_light import Level, bilinear, texel_irradiances, two_triangles

LIGHT, BLOCKER = Level(-1.5, -1.2, 1.4, 1.5, 1.2), Level(-0.35, -0.3, 0.45, 0.4, 0.6)


def corners(level):
    x0, y0, x1, y1, z = level
    return np.array([[x0, y0, z], [x0, y1, z], [x1, y1, z], [x1, y0, z]])


@pytest.mark.parametrize(("texture", "accuracy"), [(bilinear(3, 4), 1e-9), (two_triangles(), 1e-9)])
def test_a_constant_texture(texture, accuracy):
    point = np.array([0.1, -0.2, 0.05])
    exact = irradiance(point, np.array([0.0, 0.0, 1.0]), corners(LIGHT), [corners(BLOCKER)])
    np.testing.assert_allclose(texel_irradiances(point, LIGHT, BLOCKER, texture).sum(), exact, rtol=accuracy)


def test_textures_interpolate():
    pixels = np.arange(6.0).reshape(2, 3)
    found = bilinear(2, 3).basis(np.array([0.5, 0.0, 1 / 3]), np.array([0.75, 0.0, 0.5])) @ pixels.ravel()
    np.testing.assert_allclose(found, [1.0, 3.0, 0.5 * (0.5 + 3.5)])
    plane = two_triangles().basis(np.array([0.2, 0.7]), np.array([0.6, 0.1])) @ [0.0, 2.0, 3.0, 1.0]
    np.testing.assert_allclose(plane, [0.2 + 1.2, 0.7 + 0.2])
