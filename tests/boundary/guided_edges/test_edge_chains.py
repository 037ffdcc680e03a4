"""Edges in chains: each once, with few jumps from the end of one to the start of the next."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.guided_edges.edge_chains import chain_edges


def jumps(edges, order, counts):
    """How often an edge that counts does not begin where the one before it ends."""
    ends = np.where(np.asarray(order.turned)[:, None], edges[order.edge][:, ::-1], edges[order.edge])
    ends = ends[counts[order.edge]]
    return int((ends[1:, 0] != ends[:-1, 1]).sum())


@pytest.mark.parametrize("mesh", [jd.shapes.torus(1.0, 0.4, 24, 12), jd.shapes.sphere(3)], ids=["torus", "sphere"])
def test_jumps_fall(mesh):
    """Of a mesh and of a part of its edges; those that don't count come last, and every edge comes once."""
    edges, count = np.asarray(mesh.edges.vertices), mesh.edges.vertices.shape[0]
    part = np.random.default_rng(0).uniform(size=count) < 0.8
    for counts in (np.ones(count, bool), part):
        order = jax.tree.map(np.asarray, jax.jit(chain_edges)(mesh.vertices, edges, jnp.asarray(counts)))
        assert np.array_equal(np.sort(order.edge), np.arange(count))
        assert counts[order.edge][: counts.sum()].all()
        natural = type(order)(np.arange(count), np.zeros(count, bool))
        assert jumps(edges, order, counts) < 0.25 * jumps(edges, natural, counts)


def test_rings_and_chains():
    """A ring of five, an open chain of three that is numbered at random, and a lonely edge."""
    angle = 2 * np.pi * np.arange(5) / 5
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    line = np.stack([3.0 + np.arange(4), np.zeros(4), np.zeros(4)], 1)
    vertices = jnp.asarray(np.concatenate([ring, line, [[0.0, 0.0, 5.0], [0.0, 0.0, 6.0]]]))
    edges = np.array([[6, 7], [0, 1], [3, 2], [9, 10], [5, 6], [1, 2], [8, 7], [3, 4], [0, 4]])
    order = jax.tree.map(np.asarray, chain_edges(vertices, jnp.asarray(edges), jnp.ones(9, bool)))
    assert sorted(order.edge) == list(range(9))
    assert jumps(edges, order, np.ones(9, bool)) == 2
