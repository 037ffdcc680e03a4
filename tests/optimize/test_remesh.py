"""Remeshing through gpytoolbox, and the message when it is missing."""

import sys

import numpy as np
import pytest
import trimesh

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.remesh import remesh, remesh_to, split_longest_edges


@pytest.fixture(scope="module")
def sphere():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    return Mesh(ball.vertices, ball.faces)


@pytest.fixture
def gpytoolbox():
    return pytest.importorskip("gpytoolbox", reason='remeshing is optional: pip install -e ".[remesh]"')


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


@pytest.mark.parametrize("count", [301, 642, 1500])
def test_just_so_many_vertices(gpytoolbox, sphere, count):
    stretched = sphere.with_vertices(np.asarray(sphere.vertices) * [1.0, 0.6, 1.7])
    result = remesh_to(stretched, count)
    assert result.closed
    assert (len(result.vertices), len(result.edges.vertices), len(result.faces)) == (
        count,
        3 * count - 6,
        2 * count - 4,
    )
    lengths = edge_lengths(result)
    assert lengths.max() < 2.2 * np.median(lengths)
    assert chamfer(result, stretched) < 0.01


def test_splitting_keeps_the_surface_and_its_orientation(sphere):
    result = split_longest_edges(sphere, 700)
    assert result.closed and len(result.vertices) == 700
    assert volume(result) == pytest.approx(volume(sphere), rel=1e-5)
    # Only the longest: no edge that was not split is longer than one that was.
    kept = {tuple(sorted(edge)) for edge in np.asarray(result.edges.vertices).tolist()}
    old = [tuple(sorted(edge)) for edge in np.asarray(sphere.edges.vertices).tolist()]
    lengths = dict(zip(old, edge_lengths(sphere), strict=True))
    split = sorted((lengths[edge] for edge in old if edge not in kept), reverse=True)
    assert len(split) == 700 - 642
    assert np.mean(split) > np.quantile(list(lengths.values()), 0.9)


def volume(mesh):
    a, b, c = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)].transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


def test_numbers_that_can_not_be_met(gpytoolbox, sphere):
    with pytest.raises(ValueError, match="at least 4 vertices, got 3"):
        remesh_to(sphere, 3)
    with pytest.raises(ValueError, match="has 642 vertices, more than 600"):
        split_longest_edges(sphere, 600)
    with pytest.raises(ValueError, match="no edge of two faces"):
        split_longest_edges(Mesh(np.eye(3), [[0, 1, 2]]), 5)


def test_shading_is_kept(gpytoolbox, sphere):
    assert remesh(sphere, 0.3).normal_faces is None
    assert remesh(sphere.smooth(), 0.3).normal_faces is not None
    assert remesh_to(sphere, 500).normal_faces is None
    assert remesh_to(sphere.smooth(), 500).normal_faces is not None


def test_rejects_bad_lengths(gpytoolbox, sphere):
    for length in (0.0, -1.0, 10.0):
        with pytest.raises(ValueError, match="edge_length must lie between"):
            remesh(sphere, length)
    with pytest.raises(ValueError, match="edge_length must be a number, got nan"):
        remesh(sphere, float("nan"))


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
    with pytest.raises(ImportError, match=r'pip install -e "\.\[remesh\]"'):
        remesh(sphere, 0.3)
