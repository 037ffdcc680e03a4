"""Charts, textures over them, and what they say at vertices."""

import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.optimize.reconstruction.atlas import (
    PADDING,
    at_vertices,
    bake,
    covered,
    filled,
    interpolated,
    neighbours,
    rows_of_uvs,
    unwrapped,
)

pytest.importorskip("xatlas")
SIZE = 256
MESH = shapes.sphere(3, radius=0.5).smooth()
VALUES = 0.4 + 0.5 * np.asarray(MESH.vertices, float) * [1, -1, 0.5]


@pytest.fixture(scope="module")
def mesh():
    return unwrapped(MESH, SIZE)


def test_charts_do_not_overlap(mesh):
    assert (np.asarray(mesh.faces) == rows_of_uvs(mesh)[np.asarray(mesh.uv_faces)]).all()
    uvs = np.asarray(mesh.uvs)
    assert 0 <= uvs.min() and uvs.max() <= 1
    corners = uvs[np.asarray(mesh.uv_faces)]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).sum() / 2
    # Rays from above find every texel once; if charts overlapped, fewer texels than their areas would be found.
    assert 0.3 < area < 1 and len(covered(mesh, SIZE).index) == pytest.approx(area * SIZE**2, rel=0.01)


def test_the_same_mesh_has_the_same_atlas(mesh):
    """A run that is resumed unwraps its mesh again."""
    again = unwrapped(MESH, SIZE)
    assert (np.asarray(again.uvs) == np.asarray(mesh.uvs)).all()
    assert (np.asarray(again.uv_faces) == np.asarray(mesh.uv_faces)).all()


def test_textures_are_what_the_vertices_say(mesh):
    texture = bake(mesh, VALUES, SIZE)
    # At the middle of every face, (0, 0) at the lower left.
    middle = np.asarray(mesh.uvs)[np.asarray(mesh.uv_faces)].mean(1)
    row, column = ((1 - middle[:, 1]) * SIZE).astype(int), (middle[:, 0] * SIZE).astype(int)
    wanted = VALUES[np.asarray(mesh.faces)].mean(1)
    np.testing.assert_allclose(texture[row, column], wanted, atol=0.02)
    # Beyond the charts the nearest values go on.
    assert texture.min() > 0.1 and texture.max() < 0.7
    np.testing.assert_allclose(at_vertices(mesh, texture), VALUES, atol=0.02)


def test_texels_lie_on_their_faces(mesh):
    texels = covered(mesh, SIZE)
    points = interpolated(mesh, texels, np.asarray(mesh.vertices, float))
    radius = np.linalg.norm(points, axis=1)
    assert (radius < 0.5 + 1e-5).all() and (radius > 0.47).all()
    assert (texels.weights >= 0).all()


def test_neighbours_stay_inside_of_charts(mesh):
    """Points of neighbours are near each other on the surface, too."""
    texels = covered(mesh, SIZE)
    points = interpolated(mesh, texels, np.asarray(mesh.vertices, float))
    pairs = neighbours(texels, SIZE)
    one, other = np.moveaxis(filled(texels, points, SIZE).reshape(-1, 3)[pairs], 1, 0)
    assert PADDING > 1 and len(pairs) > 2 * len(points)
    distance = np.linalg.norm(one - other, axis=1)
    assert distance.max() < 6 * np.median(distance)
