"""Folds: edges between faces, at which radiance may jump from every point of view. Constants, and a tree over them."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.scene.packed import PackedScene

FLAT = 1e-6  # radians: edges whose faces fold by less are flat
SMOOTH = 0.1  # share of the fold that counts if normals are interpolated: then both faces' normals agree at the edge


def fold_tree(packed: PackedScene, rank: Float[Array, " E"], rays: str) -> EdgeTree:
    """The tree over all edges of positive `rank`, for every orientation of their faces."""
    edges = queries.EdgeSet.of(packed.edges, rank)
    edges = edges._replace(interior=jnp.zeros_like(edges.interior))  # no cones of the faces' normals
    return queries.edge_tree(packed.geometry, edges, packed.edge_counts, rays)
