"""Edge topology of a triangle mesh: which faces meet at an edge, and how they fold."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxdr.arrays import as_array
from jaxdr.geometry.edge_tree import spatial_order
from jaxdr.geometry.vector import cross, dot, normalize

INTERIOR = 0
BOUNDARY = 1
NON_MANIFOLD = 2
ROUNDING = 16  # positions are equal if their coordinates differ by at most so many rounding steps


class Edges(eqx.Module):
    """The E undirected edges of a mesh; K = max(2, largest number of faces at one edge).

    Face 0 of an edge runs through it from `vertices[:, 0]` to `vertices[:, 1]`, so (v0, v1, opposite 0) is face 0 up to
    rotation. Face 1 of an interior edge runs the other way. Edges are sorted by (min(v0, v1), max(v0, v1)), or in
    spatial order. In a new mesh v0 < v1 unless all faces at the edge run from the higher vertex number to the lower; at
    interior edges only one does.

    **Fields**

    - `vertices`: the two ends.
    - `faces`: the faces at the edge, padded with -1; the first one is always there.
    - `opposite`: for each face its vertex that is not on the edge, padded with -1.
    - `kind`: `INTERIOR` (two faces with opposite directions), `BOUNDARY` (one face) or `NON_MANIFOLD` (anything else:
      three or more faces, or two that disagree about the orientation).
    - `first`: the first of the edges that coincided when the mesh was made, without sharing vertices. For most edges it
      is the edge itself. None if no edges coincided.
    """

    vertices: Int[Array, "E 2"]
    faces: Int[Array, "E K"]
    opposite: Int[Array, "E K"]
    kind: Int[Array, " E"]
    first: Int[Array, " E"] | None = None


def build_edges(faces: Int[np.ndarray, "F 3"], points: Float[np.ndarray, "V 3"] | None = None) -> Edges:
    """Find the edges of a triangle list, on the host, in O(F log F). With `points` they are in spatial order.

    Raises `ValueError` if a face names the same vertex twice: such a face has no well-defined edges.
    """
    faces = np.asarray(faces)
    start = faces.reshape(-1).astype(np.int64)
    end = np.roll(faces, -1, axis=1).reshape(-1).astype(np.int64)
    apex = np.roll(faces, -2, axis=1).reshape(-1)
    if np.any(start == end):
        face = int(np.flatnonzero(start == end)[0]) // 3
        raise ValueError(f"build_edges: faces[{face}] = {faces[face].tolist()} names a vertex twice; drop such faces")

    # One integer per half-edge: the undirected edge, then upward half-edges before downward ones.
    low, high = np.minimum(start, end), np.maximum(start, end)
    undirected = low * (high.max(initial=0) + 1) + high
    upward = start < end
    order = np.argsort(undirected * 2 + ~upward, kind="stable")

    sorted_edges = undirected[order]
    first = np.flatnonzero(np.diff(sorted_edges, prepend=-1))
    count = np.diff(first, append=len(order))
    edge = np.repeat(np.arange(len(first)), count)
    slot = np.arange(len(order)) - np.repeat(first, count)

    shape = (len(first), max(2, count.max(initial=0)))
    edge_faces = np.full(shape, -1, np.int32)
    edge_faces[edge, slot] = order // 3
    opposite = np.full(shape, -1, np.int32)
    opposite[edge, slot] = apex[order]

    kind = np.full(len(first), NON_MANIFOLD, np.int32)
    kind[count == 1] = BOUNDARY
    pair = first[count == 2]
    kind[count == 2] = np.where(upward[order[pair]] != upward[order[pair + 1]], INTERIOR, NON_MANIFOLD)

    ends = np.stack([start[order[first]], end[order[first]]], axis=1).astype(np.int32)
    order = slice(None) if points is None else spatial_order(points[ends].mean(1))
    return Edges(*(as_array(table[order], np.int32) for table in (ends, edge_faces, opposite, kind)))


@jax.jit
def dihedral(edges: Edges, vertices: Float[Array, "V 3"]) -> Float[Array, " E"]:
    """Signed height of face 1's opposite vertex over the plane of face 0, in scene units.

    Negative at a convex edge, positive at a concave one, zero at a flat one. Zero as well at boundary and non-manifold
    edges and where face 0 has no area. Differentiable; derivatives are finite for any vertices.
    """
    start, end = vertices[edges.vertices[:, 0]], vertices[edges.vertices[:, 1]]
    # Unit sides first: the cross product of short sides would underflow when normalize squares it.
    side = normalize(vertices[edges.opposite[:, 0]] - start)
    normal = normalize(cross(normalize(end - start), side))
    # Padding (-1) reads the last vertex: finite, and masked by the kind.
    height = dot(normal, vertices[edges.opposite[:, 1]] - start)
    return jnp.where(edges.kind == INTERIOR, height, 0.0)


def is_convex(edges: Edges, vertices: Float[Array, "V 3"]) -> Bool[Array, " E"]:
    """Whether each edge is interior and convex: its faces fold away from their normals. False for flat edges."""
    return dihedral(edges, vertices) < 0


def edge_shares(edges: Edges, vertices: Float[Array, "V 3"]) -> Float[Array, " E"]:
    """One over the number of edges that coincide now and did so when the mesh was made; detached.

    Edges that coincide are one boundary of what is seen, but each of them is found. So a jump there counts with this
    share. An edge that has moved away by more than rounding counts in full.
    """
    if edges.first is None:
        return jnp.ones(edges.vertices.shape[0], vertices.dtype)
    ends = jax.lax.stop_gradient(vertices)[edges.vertices]
    there = ends[edges.first]
    apart = jnp.minimum(*(jnp.abs(ends - other).max((-1, -2)) for other in (there, there[:, ::-1])))
    together = apart <= ROUNDING * jnp.finfo(ends.dtype).eps * jnp.abs(ends).max((-1, -2))
    count = jax.ops.segment_sum(together.astype(ends.dtype), edges.first, ends.shape[0])[edges.first]
    return jnp.where(together, 1.0 / jnp.maximum(count, 1.0), 1.0)
