"""Chamfer distance against distances known in closed form."""

import equinox as eqx
import numpy as np
import pytest
import trimesh

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.chamfer import chamfer, sample_surface
from jaxdr.optimize.warp_distances import surface_distances

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def sphere(radius, center=(0, 0, 0)):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(ball.vertices + np.asarray(center), ball.faces)


def test_distances_to_face_edge_and_corner_are_exact():
    points = np.array([[0.3, 0.6, 0.25], [0.5, -0.75, 1.0], [4.0, 5.0, 0.0], [0.2, 0.2, 0.0]])
    np.testing.assert_allclose(surface_distances(points, SQUARE, SQUARE_FACES), [0.25, 1.25, 5.0, 0.0], atol=1e-6)


def test_parallel_squares():
    a, b = Mesh(SQUARE, SQUARE_FACES), Mesh(SQUARE + np.array([0, 0, 0.5]), SQUARE_FACES)
    assert chamfer(a, b) == pytest.approx(0.5 / np.sqrt(2), rel=1e-5)


def test_concentric_spheres_and_its_normalisation():
    # The diagonal belongs to the second mesh, the target.
    small, large = sphere(1.0), sphere(1.5)
    assert chamfer(small, large) == pytest.approx(0.5 / (3.0 * np.sqrt(3)), rel=5e-3)
    assert chamfer(large, small) == pytest.approx(0.5 / (2.0 * np.sqrt(3)), rel=5e-3)


def test_both_directions_count():
    # A sphere of which the target shows half: from the target all distances are zero, from the mesh they are not.
    whole = sphere(1.0)
    vertices, faces = np.asarray(whole.vertices), np.asarray(whole.faces)
    upper = Mesh(vertices, faces[vertices[faces].mean(1)[:, 2] > 0])
    assert chamfer(whole, upper) > 0.03
    assert chamfer(upper, whole) > 0.03


def test_identical_meshes_far_from_the_origin():
    assert chamfer(sphere(1.0, (1000, 0, 0)), sphere(1.0, (1000, 0, 0))) < 1e-6


def test_same_seed_same_number():
    a, b = sphere(1.0), sphere(1.0, (0.1, 0, 0))
    assert chamfer(a, b, samples=500, seed=3) == chamfer(a, b, samples=500, seed=3)
    assert chamfer(a, b, samples=500, seed=3) != chamfer(a, b, samples=500, seed=4)


def test_samples_are_uniform_by_area():
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1], [1, 0, 1], [0, 2, 1]], float)  # areas 3 and 1
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = sample_surface(vertices, faces, 4000, np.random.default_rng(0))
    lower = points[points[:, 2] < 0.5]
    assert abs(len(lower) - 3000) <= 1  # stratified
    np.testing.assert_allclose(lower.mean(0), [1, 2 / 3, 0], atol=0.05)  # the centroid


def test_rejects_bad_input():
    mesh = sphere(1.0)
    with pytest.raises(ValueError, match="samples must be at least 1"):
        chamfer(mesh, mesh, samples=0)
    with pytest.raises(ValueError, match="mesh has vertices that are not finite"):
        # As a compiled step may return it.
        chamfer(eqx.tree_at(lambda m: m.vertices, mesh, mesh.vertices.at[0].set(np.nan)), mesh)
