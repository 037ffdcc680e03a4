"""The edges that thin bundles of rays may cross, and their importance; `queries.draw_edges` draws one for a bundle."""

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool

from jaxdr.boundary.shared.folds import FLAT, SMOOTH, fold_tree
from jaxdr.boundary.shared.texture_jumps import seam_jumps
from jaxdr.geometry.queries import EdgeTable
from jaxdr.geometry.vector import norm, normalize
from jaxdr.scene.packed import PackedScene


def edge_table(packed: PackedScene, counts: Bool[Array, " E"], rays: str) -> EdgeTable:
    """All edges that count (`counts`), except flat edges across which textures continue."""
    packed = jax.tree.map(stop_gradient, packed)
    edges = packed.edges
    normal = normalize(packed.face_normals())
    n0, n1 = normal[edges.faces[:, 0]], normal[jnp.maximum(edges.faces[:, 1], 0)]
    n1 = jnp.where(edges.interior[:, None], n1, n0)
    fold = norm(n0 - n1)
    smooth = jnp.asarray(packed.smooth)[edges.shape]
    jump = jnp.where(fold > FLAT, fold, 0.0) * jnp.where(smooth, SMOOTH, 1.0)
    if packed.has_seams:
        jump = jump + seam_jumps(packed, jnp.arange(fold.shape[0]))
    importance = jnp.where(counts, jnp.where(edges.interior, jump, 1.0), 0.0)
    ends = packed.vertices[edges.vertices]
    tree = fold_tree(packed, importance, rays)
    return EdgeTable(ends, jnp.stack([n0, n1], 1), edges.interior, importance, tree)
