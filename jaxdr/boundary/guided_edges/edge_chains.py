"""Edges in long chains, so that the first primary number runs along them with few jumps (after Yan et al. 2022, 4.3).

Their Algorithm 2 walks from edge to edge, one after the other. Here all ends of edges choose at once, so that it runs
inside a compiled program, on the current positions. Two edges are joined if each is the other's straightest
continuation at their common vertex. An edge has two ends, so the joined edges form chains and rings. Pointer jumping
(Wyllie 1979), which doubles the steps along them, numbers their edges in O(E log E).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr import loops
from jaxdr.geometry.vector import corners, dot, normalize

MOST_AROUND = 64  # an end is compared with at most so many others at its vertex
ROUNDS = 4  # of choosing partners


class EdgeOrder(NamedTuple):
    """`edge`: numbers in the order of the chains. `turned`: the chain runs through it from its second vertex."""

    edge: Int[Array, " E"]
    turned: Bool[Array, " E"]


def chain_edges(vertices: Float[Array, "V 3"], edges: Int[Array, "E 2"], counts: Bool[Array, " E"]) -> EdgeOrder:
    """Order the edges that count along chains; the others follow.

    `counts`: which edges count. An end is compared with at most `MOST_AROUND` others at its vertex.
    """
    count = edges.shape[0]
    # Entry 2 e + s is for end s of edge e: the end that it is joined with, -1 for none. Unjoined ends choose again.
    partner = jnp.full(2 * count, -1, jnp.int32)
    partner = loops.fori_loop(0, ROUNDS, lambda _, p: _partners(vertices, edges, counts, p), partner)
    ends = jnp.arange(2 * count)
    # From an end by which the chain leaves an edge to the next such end. The chain enters the next edge at the partner
    # and leaves it by its other end.
    following = jnp.where(partner >= 0, partner ^ 1, ends)
    steps = max(1, (2 * count).bit_length())

    def jump(state, _):
        to, least = state
        return (to[to], jnp.minimum(least, least[to])), None

    (far, least), _ = loops.scan(jump, (following, ends), None, steps)
    # A ring has no end. In both senses of rotation, cut it at its end of lowest number.
    stops = jnp.where((partner[far] >= 0) & (least == ends), ends, following)

    def measure(state, _):
        to, length = state
        return (to[to], length + length[to]), None

    (last, length), _ = loops.scan(measure, (stops, (stops != ends).astype(jnp.int32)), None, steps)
    # Each end of an edge leads to a last end of the chain. The chain runs towards the lower of the two.
    pairs, lengths = last.reshape(-1, 2), length.reshape(-1, 2)
    sense = (pairs[:, 1] < pairs[:, 0]).astype(jnp.int32)
    chain = jnp.take_along_axis(pairs, sense[:, None], 1)[:, 0]
    place = jnp.take_along_axis(lengths, sense[:, None], 1)[:, 0]
    order = jnp.lexsort((-place, chain, ~counts)).astype(jnp.int32)
    # If the chain leaves an edge by its second end, it runs through the edge from its first vertex.
    return EdgeOrder(order, (sense == 0)[order])


def _partners(vertices, edges, counts, partner) -> Int[Array, " N"]:
    """Join ends without a partner that are each other's straightest continuation."""
    total = 2 * edges.shape[0]
    vertex = jnp.where(counts[:, None], edges, vertices.shape[0]).reshape(-1)
    vertex = jnp.where(partner < 0, vertex, vertices.shape[0])
    start, end = corners(vertices[edges])
    side = end - start
    outwards = normalize(jnp.stack([side, -side], 1).reshape(-1, 3))  # from the end's vertex along its edge
    order = jnp.argsort(vertex)
    at, out = vertex[order], outwards[order]
    place = jnp.arange(total)
    first = jnp.searchsorted(at, at, side="left")
    around = jnp.searchsorted(at, at, side="right") - first
    around = jnp.where(at < vertices.shape[0], around, 1)
    most = jnp.minimum(around.max(), MOST_AROUND)

    def compare(step, state):
        best, straightest = state
        other = first + (place - first + step) % around
        cosine = jnp.where(other == place, 2.0, dot(out, out[other]))
        # Ties go to the end of lowest place. So both ends of a pair decide alike.
        better = (cosine < straightest) | ((cosine == straightest) & (other < best))
        return jnp.where(better, other, best), jnp.where(better, cosine, straightest)

    start = jnp.full(total, total), jnp.full(total, 1.5, vertices.dtype)
    best, _ = loops.fori_loop(1, most, compare, start)
    chosen = jnp.minimum(best, total - 1)
    mutual = (best < total) & (best[chosen] == place)
    joined = jnp.where(mutual, order[chosen], -1).astype(jnp.int32)
    return partner.at[order].max(joined)
