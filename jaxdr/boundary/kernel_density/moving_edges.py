"""Fewer candidates: segments that stand still are compared with moving edges only.

The normal velocity of a boundary point is that of the edge's projection minus that of the material point behind it. It
is zero where the edge, the apex and the target all stand still. So a segment with both ends at rest needs only moving
edges, which have a small tree of their own. Other segments need all edges.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.geometry.queries import Candidates, EdgeSet, Geometry, StripQuery
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import seed_of


class MovingEdges(NamedTuple):
    """Which `shapes` move, the numbers of their edges, and the tree over them."""

    shapes: Bool[Array, " S"]
    edge: Int[Array, " m"]
    tree: EdgeTree


def moving_edges(
    packed: PackedScene, moving: tuple[bool, ...], radius: Float[Array, " E"], settings: PathSettings
) -> MovingEdges:
    """The edges of the `moving` shapes (at least one shape, and not all), with kernel radii `radius`."""
    number = packed.edges_of(moving)
    edges = jax.tree.map(lambda table: table[number], queries.EdgeSet.of(packed.edges, radius))
    counts = [count for count, moves in zip(packed.edge_counts, moving, strict=True) if moves]
    tree = queries.edge_tree(packed.geometry, edges, counts, settings.rays)
    return MovingEdges(jnp.asarray(moving), number, tree)


def apart_candidates(
    geometry: Geometry,
    edges: EdgeSet,
    moving: MovingEdges,
    strips: StripQuery,
    still: Bool[Array, " N"],
    key: PRNGKeyArray,
    options: dict[str, Any],
) -> Candidates:
    """`queries.edge_candidates` with all edges for segments that move, with `moving` edges for `still` segments.

    The result has a weight for every pair.
    """
    key_all, key_moving, key_kept = jax.random.split(key, 3)

    def found(key, edges, scale):
        seed = seed_of(key)
        return queries.edge_candidates(geometry, edges, strips._replace(scale=scale), seed, **options)

    scale = stop_gradient(strips.scale)
    every = found(key_all, edges, jnp.where(still, 0.0, scale))
    some = jax.tree.map(lambda table: table[moving.edge], edges._replace(tree=None))._replace(tree=moving.tree)
    few = found(key_moving, some, jnp.where(still, scale, 0.0))
    return _joined(every, few._replace(element=moving.edge[few.element]), key_kept)


def _joined(one: Candidates, two: Candidates, key: PRNGKeyArray) -> Candidates:
    """Both lists in the room of one. If that is too small, a random part is left out without bias."""
    capacity = one.segment.shape[0]
    segment = jnp.concatenate([one.segment, two.segment])
    element = jnp.concatenate([one.element, two.element])
    weight = jnp.repeat(jnp.stack([one.weight, two.weight]), capacity)
    used = segment >= 0
    count = used.sum()
    # The order is random only if something has to be left out.
    place = jnp.where(count > capacity, jax.random.uniform(key, used.shape), 0.0)
    kept = jnp.argsort(jnp.where(used, place, 2.0), stable=True)[:capacity]
    thinned = jnp.maximum(count / capacity, 1.0).astype(weight.dtype)
    return Candidates(segment[kept], element[kept], one.count + two.count, weight[kept] * thinned)
