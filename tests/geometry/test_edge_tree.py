"""The tree over edges: its order, where several meshes go in it, and that boxes and cones bound what they should."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import shapes
from jaxdr.geometry.edge_tree import LEAF, build_edge_tree, leaf_count, leaf_edges, spatial_order
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


@pytest.mark.parametrize("scale, offset", [(1.0, 0.0), (1e-3, 0.0), (1.0, 1000.0)])
def test_boxes_and_cones_bound_their_edges(scale, offset):
    mesh = shapes.displaced_sphere(2)
    vertices = np.asarray(mesh.vertices) * scale + np.float32(offset)
    edges, count = mesh.edges, len(mesh.edges.vertices)
    rank = jnp.asarray(np.random.default_rng(1).integers(0, 3, count), jnp.float32)
    topology = edges.vertices, edges.opposite, edges.kind == INTERIOR
    tree = build_edge_tree(jnp.asarray(vertices), *topology, rank)
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
