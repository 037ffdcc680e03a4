"""Edge topology against meshes small enough to list by hand, and against brute force."""

from collections import defaultdict

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry.edges import BOUNDARY, INTERIOR, NON_MANIFOLD, build_edges, dihedral, edge_shares, is_convex
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import box

# Two triangles that share the edge (0, 1); vertex 3 is the free one of the second face.
HINGE = np.array([[0, 1, 2], [1, 0, 3]])


def hinge_vertices(height):
    return jnp.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, height]])


def edge_index(edges, a, b):
    return int(np.flatnonzero((np.sort(edges.vertices, axis=1) == sorted((a, b))).all(axis=1))[0])


def test_hinge_by_hand():
    edges = build_edges(HINGE)
    np.testing.assert_array_equal(edges.vertices, [[0, 1], [2, 0], [0, 3], [1, 2], [3, 1]])
    np.testing.assert_array_equal(edges.faces, [[0, 1], [0, -1], [1, -1], [0, -1], [1, -1]])
    np.testing.assert_array_equal(edges.opposite, [[2, 3], [1, -1], [1, -1], [0, -1], [0, -1]])
    np.testing.assert_array_equal(edges.kind, [INTERIOR, BOUNDARY, BOUNDARY, BOUNDARY, BOUNDARY])


def test_three_faces_at_an_edge_are_non_manifold():
    edges = build_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    hinge = edge_index(edges, 0, 1)
    assert edges.faces.shape[1] == 3
    assert edges.kind[hinge] == NON_MANIFOLD
    assert set(np.asarray(edges.opposite[hinge]).tolist()) == {2, 3, 4}
    assert np.sum(np.asarray(edges.kind) == NON_MANIFOLD) == 1


def test_two_faces_with_the_same_direction_are_non_manifold():
    edges = build_edges(np.array([[0, 1, 2], [0, 1, 3]]))
    assert edges.kind[edge_index(edges, 0, 1)] == NON_MANIFOLD


def test_random_faces_match_brute_force():
    rng = np.random.default_rng(0)
    faces = np.stack([rng.permutation(30)[:3] for _ in range(200)])
    sides = defaultdict(list)
    for face, corners in enumerate(faces):
        for k in range(3):
            a, b, c = np.roll(corners, -k)
            sides[min(a, b), max(a, b)].append((face, c, a < b))

    edges = jax.tree.map(np.asarray, build_edges(faces))
    assert [tuple(sorted(pair)) for pair in edges.vertices.tolist()] == sorted(sides)
    for e, key in enumerate(sorted(sides)):
        at_edge = sides[key]
        valid = edges.faces[e] >= 0
        found = set(zip(edges.faces[e][valid], edges.opposite[e][valid], strict=True))
        assert found == {(face, apex) for face, apex, _ in at_edge}
        opposed = len(at_edge) == 2 and at_edge[0][2] != at_edge[1][2]
        assert edges.kind[e] == (BOUNDARY if len(at_edge) == 1 else INTERIOR if opposed else NON_MANIFOLD)
        # Face 0 runs from vertices[0] to vertices[1].
        cycle = faces[edges.faces[e, 0]].tolist()
        assert cycle[(cycle.index(edges.vertices[e, 0]) + 1) % 3] == edges.vertices[e, 1]


def test_order_of_faces_does_not_change_the_edges():
    rng = np.random.default_rng(1)
    faces = np.stack([rng.permutation(20)[:3] for _ in range(40)])
    edges, shuffled = build_edges(faces), build_edges(rng.permutation(faces))
    np.testing.assert_array_equal(edges.vertices, shuffled.vertices)
    np.testing.assert_array_equal(edges.kind, shuffled.kind)


def test_repeated_vertex_in_a_face_is_an_error():
    with pytest.raises(ValueError, match=r"faces\[1\] = \[3, 4, 4\] names a vertex twice"):
        build_edges(np.array([[0, 1, 2], [3, 4, 4]]))


def test_dihedral_sign_and_size():
    edges = build_edges(HINGE)
    for height in (-0.5, 0.0, 0.25):  # face 0 faces +z: a raised free vertex makes a valley
        expected = np.where(np.asarray(edges.kind) == INTERIOR, height, 0.0)
        np.testing.assert_allclose(dihedral(edges, hinge_vertices(height)), expected, atol=1e-7)
    hinge = edge_index(edges, 0, 1)
    assert is_convex(edges, hinge_vertices(-0.5))[hinge]
    assert not is_convex(edges, hinge_vertices(0.0)).any()
    assert not is_convex(edges, hinge_vertices(0.5)).any()


def test_dihedral_does_not_depend_on_face_order_or_scale():
    edges = build_edges(HINGE[::-1])
    hinge = edge_index(edges, 0, 1)
    assert is_convex(edges, 1e-12 * hinge_vertices(-0.5))[hinge]
    assert not is_convex(edges, 1e-12 * hinge_vertices(0.5))[hinge]


@pytest.mark.parametrize("vertices", [hinge_vertices(0.3), jnp.zeros((4, 3))], ids=["regular", "collapsed"])
def test_dihedral_derivative_is_finite(vertices):
    edges = build_edges(HINGE)
    gradient = jax.jit(jax.grad(lambda v: dihedral(edges, v).sum()))(vertices)
    assert jnp.isfinite(gradient).all()


def test_dihedral_derivative_lifts_the_free_vertex():
    edges = build_edges(HINGE)
    gradient = jax.grad(lambda v: dihedral(edges, v).sum())(hinge_vertices(0.0))
    np.testing.assert_allclose(gradient[3], [0, 0, 1], atol=1e-6)


def soup(copies=1):
    """A box of triangles that share no vertex, each of them so many times."""
    corners = np.asarray(box().vertices)[np.asarray(box().faces)]
    points = np.concatenate([corners] * copies).reshape(-1, 3)
    with pytest.warns(UserWarning, match="edges lie on others without sharing vertices"):
        return Mesh(points, np.arange(len(points)).reshape(-1, 3))


@pytest.mark.parametrize("copies", [1, 2])
def test_edges_on_one_another_share_what_counts(copies):
    """However often an edge is there, once in all: of a box eighteen edges count."""
    mesh = soup(copies)
    shares = edge_shares(mesh.edges, mesh.vertices)
    np.testing.assert_allclose(shares, 0.5 / copies)
    assert shares.sum() == pytest.approx(len(box().edges.vertices))
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    moved = np.asarray(mesh.vertices) @ turn.astype(np.float32) + np.float32(7.0)
    np.testing.assert_allclose(edge_shares(mesh.edges, jnp.asarray(moved)), shares)


def test_edges_that_have_come_apart_are_their_own():
    mesh = soup()
    moved = mesh.vertices.at[:3].add(0.01)  # the first triangle
    shares = np.asarray(edge_shares(mesh.edges, moved))
    own = (np.asarray(mesh.edges.faces)[:, 0] == 0).sum()
    assert own == 3 and (shares == 1.0).sum() == 6 and (shares == 0.5).sum() == len(shares) - 6


def test_edges_that_share_their_vertices_count_in_full():
    """Also where faces are there twice: their edges are there once."""
    twice = Mesh(box().vertices, np.vstack([box().faces, box().faces]))
    for mesh in (box(), twice):
        assert mesh.edges.first is None
        np.testing.assert_array_equal(edge_shares(mesh.edges, mesh.vertices), 1.0)


def test_shares_have_no_derivative():
    mesh = soup()
    assert not np.any(jax.grad(lambda v: edge_shares(mesh.edges, v).sum())(mesh.vertices))
