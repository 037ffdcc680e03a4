"""Edges between faces, where what is seen may jump wherever it is seen from: what to expect there, and their tree."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.scene.packed import PackedScene

FLAT = 1e-6  # radians: faces that fold by less continue each other
SMOOTH = 0.1  # interpolated normals agree at an edge; how much of its fold is left to expect a jump from


def fold_tree(packed: PackedScene, rank: Float[Array, " E"], rays: str) -> EdgeTree:
    """The tree over all edges of positive `rank`, whichever way their faces look."""
    edges = queries.EdgeSet.of(packed.edges, rank)
    edges = edges._replace(interior=jnp.zeros_like(edges.interior))  # no cones of the faces' normals
    return queries.edge_tree(packed.geometry, edges, packed.edge_counts, rays)
