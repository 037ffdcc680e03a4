"""Mesh: checks at construction, smoothing groups, differentiable normals, welding."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxdr.geometry.mesh import Mesh, weld

CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def tetrahedron(**arguments):
    return Mesh(CORNER, TETRAHEDRON, **arguments)


def test_tetrahedron_is_closed_and_a_hole_opens_it():
    assert tetrahedron().closed
    assert not Mesh(CORNER, TETRAHEDRON[:3]).closed
    assert not Mesh(CORNER, np.vstack([TETRAHEDRON[:3], [[3, 2, 1]]])).closed  # one face turned over


def test_dtypes():
    mesh = tetrahedron()
    assert mesh.vertices.dtype == jnp.float32
    assert mesh.faces.dtype == jnp.int32
    with jax.enable_x64(True):
        mesh = tetrahedron()
        assert mesh.vertices.dtype == jnp.float64
        assert mesh.faces.dtype == mesh.edges.vertices.dtype == jnp.int32
        assert mesh.smooth().vertex_normals().dtype == jnp.float64


def test_float_leaves_are_vertices_and_uvs():
    mesh = tetrahedron(uvs=np.zeros((1, 2)), uv_faces=np.zeros((4, 3), int))
    floats = jax.tree.leaves(eqx.filter(mesh, eqx.is_inexact_array))
    assert sorted(leaf.shape for leaf in floats) == [(1, 2), (4, 3)]


BAD_INPUT = {
    "nan vertex": (dict(vertices=np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]])), r"vertices\[1\].*not finite"),
    "overflow": (dict(vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1e39, 0]])), r"vertices\[2\].*not finite"),
    "vertex shape": (dict(vertices=CORNER[:, :2]), r"vertices must be numbers of shape \[n, 3\].*\[4, 2\]"),
    "vertex type": (dict(vertices=CORNER.astype(str)), "vertices must be made of numbers"),
    "no vertices": (dict(vertices=np.zeros((0, 3))), "vertices is empty"),
    "index too large": (dict(faces=[[0, 1, 2], [0, 1, 4]]), r"faces\[1\] = \[0, 1, 4\] is out of range.*4 vertices"),
    "negative index": (dict(faces=[[0, -1, 2]]), r"faces\[0\].*out of range"),
    "float indices": (dict(faces=[[0.0, 1.0, 2.0]]), "faces must be integers"),
    "quads": (dict(faces=[[0, 1, 2, 3]]), r"faces must be integers of shape \[n, 3\]"),
    "no faces": (dict(faces=[]), "faces is empty"),
    "only flat faces": (dict(faces=[[0, 1, 1]]), "none of the 1 faces has an area"),
    "uvs alone": (dict(uvs=np.zeros((4, 2))), "uvs and uv_faces together"),
    "nan uv": (dict(uvs=[[0, np.inf]], uv_faces=np.zeros((4, 3), int)), r"uvs\[0\].*not finite"),
    "uv index": (dict(uvs=[[0, 0]], uv_faces=np.ones((4, 3), int)), r"uv_faces\[0\].*out of range.*1 uvs"),
    "uv rows": (dict(uvs=[[0, 0]], uv_faces=np.zeros((2, 3), int)), "uv_faces has 2 rows for 4 faces"),
    "normal index": (dict(normal_faces=np.full((4, 3), -1)), r"normal_faces\[0\].*out of range"),
}


@pytest.mark.parametrize("name", BAD_INPUT)
def test_bad_input_is_one_clear_error(name):
    changed, message = BAD_INPUT[name]
    with pytest.raises(ValueError, match=message):
        Mesh(**{"vertices": CORNER, "faces": TETRAHEDRON} | changed)


def test_traced_vertices_are_an_error_that_names_the_remedy():
    with pytest.raises(ValueError, match="with_vertices"):
        jax.jit(lambda v: Mesh(v, TETRAHEDRON).vertices)(CORNER)


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_faces_without_area_are_dropped_and_counted(scale):
    vertices = scale * np.vstack([CORNER, [[0.5, 0.5, 0], [0, 0, 0]]])
    faces = np.vstack([TETRAHEDRON, [[1, 2, 4], [0, 0, 1], [0, 5, 1]]])
    with pytest.warns(UserWarning, match="dropped 3 of 7 faces"):
        mesh = Mesh(
            vertices, faces, uvs=np.zeros((7, 2)), uv_faces=np.arange(7)[:, None].repeat(3, 1), normal_faces=faces
        )
    np.testing.assert_array_equal(mesh.faces, TETRAHEDRON)
    np.testing.assert_array_equal(mesh.uv_faces[:, 0], [0, 1, 2, 3])
    np.testing.assert_array_equal(mesh.normal_faces, TETRAHEDRON)


def test_thin_faces_are_kept():
    assert Mesh([[0, 0, 0], [1, 0, 0], [0.5, 1e-5, 0]], [[0, 1, 2]]).faces.shape == (1, 3)


def test_with_vertices_is_traceable_and_checks_the_shape():
    mesh = tetrahedron()
    moved = jax.jit(lambda v: mesh.with_vertices(v + 1.0))(mesh.vertices)
    np.testing.assert_allclose(moved.vertices, CORNER + 1)
    assert moved.closed
    batch = jax.vmap(mesh.with_vertices)(jnp.zeros((5, 4, 3)))
    assert batch.vertices.shape == (5, 4, 3)
    with pytest.raises(ValueError, match="with_vertices"):
        mesh.with_vertices(jnp.zeros((5, 3)))


def test_vertex_normals_weight_by_angle_not_by_triangle_count():
    # A cube corner: the face z = 0 is split into two triangles, which must not count twice.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 3, 4]])
    normals = Mesh(vertices, faces).smooth().vertex_normals()
    np.testing.assert_allclose(normals[0], np.ones(3) / np.sqrt(3), atol=1e-6)


def test_smoothing_groups_share_a_normal_only_within_the_group():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 1, 2], [0, 3, 1]])  # normals +z and +y
    mesh = Mesh(vertices, faces, normal_faces=[[0, 0, 0], [1, 1, 1]])
    assert mesh.normal_group_count == 2
    np.testing.assert_allclose(mesh.vertex_normals(), [[0, 0, 1], [0, 1, 0]], atol=1e-6)
    np.testing.assert_allclose(mesh.smooth().vertex_normals()[0], np.array([0, 1, 1]) / np.sqrt(2), atol=1e-6)


def test_smooth_and_flat():
    mesh = tetrahedron()
    assert mesh.normal_faces is None
    smooth = mesh.smooth()
    assert smooth.normal_group_count == 4 == smooth.vertex_normals().shape[0]
    flat = smooth.flat()
    assert flat.normal_faces is None and flat.normal_group_count == 0
    with pytest.raises(ValueError, match="flat shading has none"):
        flat.vertex_normals()


@pytest.mark.parametrize("scale", [1.0, 1e-12, 1e12])
def test_vertex_normals_do_not_depend_on_scale(scale):
    mesh = tetrahedron().smooth()
    np.testing.assert_allclose(
        mesh.with_vertices(scale * mesh.vertices).vertex_normals(), mesh.vertex_normals(), atol=1e-6
    )


def test_vertex_normals_check_grads():
    with jax.enable_x64(True):
        mesh = tetrahedron().smooth()
        vertices = mesh.vertices + 0.1 * jax.random.normal(jax.random.key(0), mesh.vertices.shape)
        check_grads(lambda v: mesh.with_vertices(v).vertex_normals(), (vertices,), order=1)


@pytest.mark.parametrize(
    "vertices",
    [
        np.zeros((4, 3)),  # everything in one point
        CORNER * [1, 0, 0],  # on a line: angles of 0 and 180 degrees
        CORNER * [1, 1, 0],  # flattened: opposite faces cancel
        np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1.0]]),  # one side of length zero
    ],
    ids=["point", "line", "flattened", "collapsed side"],
)
def test_vertex_normals_and_their_derivative_are_finite_on_degenerate_faces(vertices):
    mesh = tetrahedron().smooth()

    def normals(v):
        return mesh.with_vertices(v).vertex_normals()

    value, pullback = jax.vjp(normals, jnp.asarray(vertices, float))
    assert jnp.isfinite(value).all()
    assert jnp.isfinite(pullback(jnp.ones_like(value))[0]).all()


def test_unused_vertex_has_zero_normal():
    mesh = Mesh(np.vstack([CORNER, [[9, 9, 9]]]), TETRAHEDRON).smooth()
    np.testing.assert_array_equal(mesh.vertex_normals()[4], 0)


def test_weld_merges_equal_positions_and_keeps_their_order():
    soup = CORNER[TETRAHEDRON].reshape(-1, 3)
    vertices, faces = weld(soup, np.arange(12).reshape(-1, 3))
    np.testing.assert_array_equal(vertices, CORNER[[0, 2, 1, 3]])  # order of first appearance
    np.testing.assert_array_equal(vertices[faces], CORNER[TETRAHEDRON])
    assert Mesh(vertices, faces).closed


def test_weld_compares_in_float32_and_treats_both_zeros_alike():
    vertices = np.array([[1.0, 0, 0], [1 + 1e-12, -0.0, 0], [1 + 1e-6, 0, 0]])
    welded, faces = weld(vertices, np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(welded, vertices[[0, 2]])
    np.testing.assert_array_equal(faces, [[0, 0, 1]])
