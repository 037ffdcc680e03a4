"""For each cone of directions the angles to silhouette edges, and the nearest one. All edges are tried, in blocks."""

import jax.numpy as jnp

from jaxdr import loops
from jaxdr.geometry.queries.jax.edge_sides import side_of_faces
from jaxdr.geometry.queries.records import BESIDE
from jaxdr.geometry.vector import between, corners, cross, dot, norm, normalize
from jaxdr.safe_divide import safe_divide

BLOCK = 32


def closest_silhouettes(geometry, edges, cones):
    """(edge [N], along [N]): see `queries.closest_silhouettes`."""
    count = edges.ends.shape[0]
    index = jnp.arange(-(-count // BLOCK) * BLOCK).reshape(-1, BLOCK)

    def visit(best, number):
        row = jnp.minimum(number, count - 1)
        angle, along = silhouette_angles(geometry, edges.ends[row], edges.opposite[row], edges.rank[row], cones)
        angle = jnp.where(number < count, angle, jnp.inf)
        k = jnp.argmin(angle, axis=1)[:, None]
        angle, along = (jnp.take_along_axis(a, k, 1)[:, 0] for a in (angle, along))
        closer = angle < best[0]
        found = angle, row[k[:, 0]].astype(jnp.int32), along
        return tuple(jnp.where(closer, new, old) for new, old in zip(found, best, strict=True)), None

    zero = jnp.zeros_like(cones.reach)
    start = cones.reach, jnp.full(zero.shape, -1, jnp.int32), zero
    _, edge, along = loops.scan(visit, start, index)[0]
    return edge, along


def silhouette_angles(geometry, ends, opposite, rank, cones):
    """(angles [N, B] between cones' axes and edges, infinite where an edge does not count; fractions along edges)."""
    apex, w, normal = (a[:, None] for a in (cones.apex, cones.direction, cones.normal))
    p0, p1 = corners(geometry.vertices[ends])
    first, last = p0 - apex, p1 - apex
    along = nearest_on_arc(w, first, last)
    angle = angle_between(w, normalize(between(first, last, along)))
    plane = cross(first, last - first)
    silhouette = side_of_faces(geometry.vertices, opposite, p0, p1, plane, cones.apex) != 0
    largest = jnp.maximum(jnp.abs(cones.apex).max(-1)[:, None], jnp.abs(jnp.concatenate([p0, p1], -1)).max(-1))
    above = jnp.maximum(dot(normal, first), dot(normal, last)) > BESIDE * largest
    counts = silhouette & (above | (dot(normal, normal) == 0)) & (rank > 0)
    return jnp.where(counts, angle, jnp.inf), along


def angle_between(a, b):
    """The angle between unit vectors, exact for small ones."""
    return 2.0 * jnp.arcsin(jnp.minimum(1.0, 0.5 * norm(a - b)))


def nearest_on_arc(w, first, last):
    """The fraction along edges, between offsets from the apex, of their points nearest to direction `w` in angle.

    The plane through apex and edge cuts the sphere in the edge's great circle. `w` projected onto this plane is a sum
    of the two ends. If both of its coefficients are positive it lies between them, and their ratio is the fraction.
    """
    normal = cross(first, last - first)
    to_first, to_last = dot(cross(w, last), normal), dot(cross(first, w), normal)
    inside = (to_first >= 0) & (to_last >= 0) & (to_first + to_last > 0)
    end = jnp.where(dot(w, normalize(last)) > dot(w, normalize(first)), 1.0, 0.0)
    return jnp.where(inside, safe_divide(to_last, to_first + to_last, inside), end)
