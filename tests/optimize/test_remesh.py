"""Remeshing through gpytoolbox, and the message when it is missing."""

import sys

import numpy as np
import pytest
import trimesh

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.remesh import remesh


@pytest.fixture(scope="module")
def sphere():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return Mesh(ball.vertices, ball.faces)


@pytest.fixture
def gpytoolbox():
    return pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install "jaxdr[remesh]"')


def edge_lengths(mesh):
    a, b = np.asarray(mesh.vertices)[np.asarray(mesh.edges.vertices)].transpose(1, 0, 2)
    return np.linalg.norm(a - b, axis=1)


@pytest.mark.parametrize("length", [0.08, 0.25])
def test_edges_get_the_length_and_the_surface_stays(gpytoolbox, sphere, length):
    result = remesh(sphere, length)
    assert result.closed
    assert len(result.vertices) - len(result.edges.vertices) + len(result.faces) == 2
    np.testing.assert_allclose(np.median(edge_lengths(result)), length, rtol=0.2)
    assert edge_lengths(result).max() < 2 * length
    assert chamfer(result, sphere) < 0.005


def test_shading_is_kept(gpytoolbox, sphere):
    assert remesh(sphere, 0.3).normal_faces is None
    assert remesh(sphere.smooth(), 0.3).normal_faces is not None


def test_rejects_bad_lengths(gpytoolbox, sphere):
    for length in (0.0, -1.0, 10.0, float("nan")):
        with pytest.raises(ValueError, match="edge_length must lie between"):
            remesh(sphere, length)


def test_rejects_a_non_manifold_mesh(gpytoolbox):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], float)
    fan = Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    with pytest.raises(ValueError, match="more than two faces"):
        remesh(fan, 0.3)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), int), "nothing usable is left"),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), "nothing usable is left"),
        (np.eye(3), np.array([[0, 1, 2]]), "result is not manifold"),  # open, where the sphere was closed
    ],
)
def test_unusable_results_are_refused(gpytoolbox, sphere, monkeypatch, vertices, faces, message):
    monkeypatch.setattr(gpytoolbox, "remesh_botsch", lambda *arguments: (vertices, faces))
    with pytest.raises(ValueError, match=message):
        remesh(sphere, 0.3)


def test_says_how_to_install_gpytoolbox(sphere, monkeypatch):
    monkeypatch.setitem(sys.modules, "gpytoolbox", None)
    with pytest.raises(ImportError, match=r'pip install "jaxdr\[remesh\]"'):
        remesh(sphere, 0.3)
