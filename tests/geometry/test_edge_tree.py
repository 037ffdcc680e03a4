"""The tree over edges: its order, where several meshes go in it, and that boxes and cones bound what they should."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import queries, shapes
from jaxdr.geometry.edge_tree import LEAF, leaf_count, leaf_edges, spatial_order
from jaxdr.geometry.edges import INTERIOR


@pytest.mark.parametrize("count", [1, 3, 4, 5, 64, 65, 1000])
def test_order_is_a_permutation(count):
    points = np.random.default_rng(count).normal(size=(count, 3))
    assert sorted(spatial_order(points)) == list(range(count))


def test_nodes_are_compact():
    """Half of the points in order are a half of space, as is every node below."""
    points = np.random.default_rng(0).uniform([0, 0, 0], [4, 2, 1], (4 * LEAF, 3))
    ordered = points[spatial_order(points)]
    left, right = np.split(ordered, 2)
    assert left[:, 0].max() <= right[:, 0].min()


def test_ties_keep_their_order():
    """On any processor: which of equally far edges goes into which half, and the order within a leaf."""
    grid = np.indices((16, 8, 2)).reshape(3, -1).T
    points = np.random.default_rng(0).permutation(grid).astype(float)
    leaves = spatial_order(points).reshape(-1, LEAF)
    assert np.array_equal(np.sort(leaves, 1), leaves)
    assert np.array_equal(spatial_order(np.zeros((100, 3))), np.arange(100))


def test_every_mesh_has_a_node_of_its_own():
    counts = (5, 300, 12)
    slots = leaf_edges(counts)
    assert len(slots) == LEAF * leaf_count(len(slots))
    assert sorted(slots[slots >= 0]) == list(range(sum(counts)))
    first = np.cumsum([0, *counts])
    for i, count in enumerate(counts):
        where = np.flatnonzero((slots >= first[i]) & (slots < first[i + 1]))
        size = leaf_count(count) * LEAF
        assert where[0] % size == 0 and where[-1] - where[0] == count - 1


@pytest.mark.parametrize("implementation", ["warp", "jax"])
@pytest.mark.parametrize("scale, offset", [(1.0, 0.0), (1e-3, 0.0), (1.0, 1000.0)])
def test_boxes_and_cones_bound_their_edges(scale, offset, implementation):
    mesh = shapes.displaced_sphere(2)
    vertices = np.asarray(mesh.vertices) * scale + np.float32(offset)
    edges, count = mesh.edges, len(mesh.edges.vertices)
    rank = jnp.asarray(np.random.default_rng(1).integers(0, 3, count), jnp.float32)
    geometry = queries.Geometry(jnp.asarray(vertices), mesh.faces)
    table = queries.EdgeSet(edges.vertices, edges.faces, edges.opposite, edges.kind == INTERIOR, rank)
    tree = queries.edge_tree(geometry, table, implementation=implementation)
    slots, node = np.asarray(tree.edge), np.asarray(tree.node, float)
    faces, v = np.asarray(mesh.faces), vertices.astype(float)
    normal = np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    leaves = len(slots) // LEAF
    for leaf in range(leaves):
        inside = slots[leaf * LEAF : (leaf + 1) * LEAF]
        inside = inside[inside >= 0]
        inside = inside[np.asarray(rank)[inside] > 0]
        ends = v[np.asarray(edges.vertices)[inside]].reshape(-1, 3)
        around = normal[np.asarray(edges.faces)[inside]].reshape(-1, 3)
        n = leaves + leaf
        while n > 0:
            (center, radius), (extent, highest), (axis, cosine) = ((row[:3], row[3]) for row in node[n])
            rounding = 1e-6 * np.abs(v).max()
            assert np.all(np.abs(ends - center) <= extent + rounding)
            assert np.all(np.linalg.norm(ends - center, axis=1) <= radius + rounding)
            assert len(inside) == 0 or highest >= np.asarray(rank)[inside].max()
            assert cosine <= 0 or np.all(around @ axis >= cosine)
            n //= 2


def test_both_implementations_agree():
    """Boxes and ranks to the bit, cones to rounding."""
    meshes = [shapes.displaced_sphere(2), shapes.box((1.0, 2.0, 3.0)), shapes.plane(3.0)]
    counts, first, tables = [], 0, []
    for mesh in meshes:
        e = mesh.edges
        opposite = jnp.where(e.opposite >= 0, e.opposite + first, -1)
        tables.append((mesh.vertices, e.vertices + first, opposite, e.kind == INTERIOR))
        counts.append(len(e.vertices))
        first += len(mesh.vertices)
    width = max(table[2].shape[1] for table in tables)
    padded = [jnp.pad(t[2], ((0, 0), (0, width - t[2].shape[1])), constant_values=-1) for t in tables]
    vertices, edges, interior = (jnp.concatenate([t[k] for t in tables]) for k in (0, 1, 3))
    rank = jnp.asarray(np.random.default_rng(2).integers(0, 3, sum(counts)), jnp.float32)
    geometry = queries.Geometry(vertices, jnp.concatenate([mesh.faces for mesh in meshes]))
    opposite = jnp.concatenate(padded)  # faces of edges have no part in it
    table = queries.EdgeSet(edges, opposite, opposite, interior, rank)
    warp, plain = (queries.edge_tree(geometry, table, counts, name) for name in ("warp", "jax"))
    np.testing.assert_array_equal(warp.edge, plain.edge)
    node, expected = np.asarray(warp.node)[1:], np.asarray(plain.node)[1:]
    np.testing.assert_array_equal(node[:, 1], expected[:, 1])
    np.testing.assert_allclose(node[:, 0], expected[:, 0], rtol=1e-6, atol=1e-7)
    used = expected[:, 1, 3] > 0
    bounded = used & (expected[:, 2, 3] > -1)
    assert bounded.sum() > 0.5 * used.sum()
    np.testing.assert_allclose(node[bounded, 2, 3], expected[bounded, 2, 3], atol=1e-3)
