"""Spherical texture coordinates."""

import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.geometry.uvs import spherical_uvs


@pytest.mark.parametrize("mesh", [shapes.sphere(2), shapes.duck(2)])
def test_uvs_are_directions(mesh):
    made = spherical_uvs(mesh)
    uvs = np.asarray(made.uvs)[np.asarray(made.uv_faces)].astype(float)
    points = np.asarray(made.vertices)[np.asarray(made.faces)].astype(float)
    assert np.ptp(uvs[..., 0], axis=1).max() <= 0.5 + 1e-6, "no face goes around the sphere"
    longitude, latitude = 2 * np.pi * uvs[..., 0], np.pi * (uvs[..., 1] - 0.5)
    direction = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)], -1)
    direction = np.concatenate([direction, np.sin(latitude)[..., None]], -1)
    np.testing.assert_allclose(direction, points / np.linalg.norm(points, axis=-1, keepdims=True), atol=1e-5)
    assert len(made.vertices) == len(mesh.vertices) and made.closed == mesh.closed


def test_at_a_pole_u_is_that_of_the_face():
    pawn = shapes.revolved([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0)], segments=8)
    made = spherical_uvs(pawn)
    uvs = np.asarray(made.uvs)[np.asarray(made.uv_faces)]
    at_pole = np.abs(uvs[..., 1] - 0.5) > 0.499
    assert at_pole.sum() == 16
    for face, pole in zip(uvs, at_pole, strict=True):
        np.testing.assert_allclose(face[pole, 0], face[~pole, 0].mean(), atol=1e-6)


def test_a_vertex_at_the_origin_is_named():
    with pytest.raises(ValueError, match="a vertex at the origin has no direction"):
        spherical_uvs(shapes.plane(2.0, resolution=2))
