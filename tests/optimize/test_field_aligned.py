"""Remeshing along a field of directions, through pyinstantmeshes, and the messages where it fails."""

import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import jaxdr as jd
from jaxdr.boundary.guided_edges.edge_chains import chain_edges
from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize import field_aligned
from jaxdr.optimize.chamfer import chamfer
from jaxdr.optimize.remesh import remesh_to

pytest.importorskip("pyinstantmeshes", reason='it is optional: pip install -e ".[field-aligned]"')


@pytest.fixture(scope="module")
def bumpy():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    rng = np.random.default_rng(0)
    return Mesh(ball.vertices * [1.0, 0.7, 1.4] * (1 + 0.02 * rng.normal(size=(len(ball.vertices), 1))), ball.faces)


@pytest.fixture(scope="module")
def torus():
    found = trimesh.creation.torus(1.0, 0.4, major_sections=40, minor_sections=20)
    rng = np.random.default_rng(0)
    return Mesh(found.vertices + 0.03 * rng.normal(size=found.vertices.shape), found.faces)


def chain_length(mesh):
    """Edges a chain, of all edges."""
    edges = np.asarray(mesh.edges.vertices)
    order = chain_edges(jnp.asarray(mesh.vertices), jnp.asarray(edges), jnp.ones(len(edges), bool))
    ends = edges[np.asarray(order.edge)]
    ends = np.where(np.asarray(order.turned)[:, None], ends[:, ::-1], ends)
    return len(edges) / (1 + (ends[:-1, 1] != ends[1:, 0]).sum())


@pytest.mark.parametrize("count", [400, 801])
def test_just_so_many_vertices_on_the_same_surface(bumpy, count):
    result = jd.remesh_field_aligned(bumpy, count)
    assert result.closed and len(result.vertices) == count
    assert len(result.edges.vertices) == 3 * count - 6 and len(result.faces) == 2 * count - 4
    assert chamfer(result, bumpy) < 0.006
    again = jd.remesh_field_aligned(bumpy, count)
    np.testing.assert_array_equal(result.vertices, again.vertices)


def test_a_torus_stays_one_and_its_chains_get_longer(torus):
    result = jd.remesh_field_aligned(torus, 800)
    assert result.closed
    assert len(result.vertices) - len(result.edges.vertices) + len(result.faces) == 0
    assert chain_length(result) > 1.5 * chain_length(remesh_to(torus, 800))


def test_an_open_mesh_keeps_its_border():
    x, y = np.meshgrid(np.linspace(0, 2, 25), np.linspace(0, 1, 13), indexing="ij")
    corner = (np.arange(24)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 13, corner + 14], 1), np.stack([corner, corner + 14, corner + 1], 1)]
    )
    result = jd.remesh_field_aligned(Mesh(np.stack([x, y, 0 * x], -1).reshape(-1, 3), faces), 300)
    points = np.asarray(result.vertices)
    assert not result.closed and len(points) == 300
    np.testing.assert_allclose(points[:, 2], 0, atol=1e-5)
    np.testing.assert_allclose(np.ptp(points, axis=0)[:2], [2, 1], atol=0.05)


@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1e3, 0.0), (1.0, 100.0)])
def test_wherever_it_is(bumpy, scale, offset):
    moved = bumpy.with_vertices(np.asarray(bumpy.vertices) * scale + offset)
    result = jd.remesh_field_aligned(moved, 400)
    assert result.closed and len(result.vertices) == 400
    assert chamfer(result, moved) < 0.004


def test_shading_is_kept(bumpy):
    assert jd.remesh_field_aligned(bumpy, 400).normal_faces is None
    assert jd.remesh_field_aligned(bumpy.smooth(), 400).normal_faces is not None


def test_meshes_that_it_can_not_have(bumpy):
    with pytest.raises(ValueError, match="at least 16 vertices, got 15"):
        jd.remesh_field_aligned(bumpy, 15)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], float)
    fan = Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]))
    with pytest.raises(ValueError, match="remesh_field_aligned: the mesh has edges with more than two faces"):
        jd.remesh_field_aligned(fan, 100)
    with pytest.raises(ValueError, match="remesh_field_aligned: the mesh has vertices that are not finite"):
        # As a compiled step may return it.
        jd.remesh_field_aligned(eqx.tree_at(lambda m: m.vertices, bumpy, bumpy.vertices * np.nan), 100)


def test_holes_are_refused_and_fewer_vertices_tried(bumpy, monkeypatch):
    counts = []

    def holes(points, faces, count, with_border):
        counts.append(count)
        return points, faces[1:]

    monkeypatch.setattr(field_aligned, "_instant_mesh", holes)
    with pytest.raises(ValueError, match="about 642 vertices: the result is not manifold; try a finer mesh"):
        jd.remesh_field_aligned(bumpy, 642)
    assert counts == sorted(set(counts), reverse=True)


def test_a_crash_is_told(bumpy, monkeypatch):
    monkeypatch.setattr(field_aligned, "SCRIPT", "import sys; sys.exit('segments of what')")
    with pytest.raises(ValueError, match=r"Instant Meshes failed on this mesh \(segments of what\)"):
        jd.remesh_field_aligned(bumpy, 400)


def test_nothing_is_printed(capfd, bumpy):
    jd.remesh_field_aligned(bumpy, 400)
    assert capfd.readouterr() == ("", "")


def test_says_how_to_install_it(bumpy, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyinstantmeshes", None)
    with pytest.raises(ImportError, match=r'pip install -e "\.\[field-aligned\]"'):
        jd.remesh_field_aligned(bumpy, 400)
