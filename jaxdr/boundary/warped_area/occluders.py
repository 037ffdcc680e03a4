"""What hides auxiliary points from an apex, and how near they are to the boundary of what it sees (Xu et al. 2023)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.face_neighbours import Faces
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.warped_area.continuous_velocity import Auxiliary
from jaxdr.geometry import queries
from jaxdr.geometry.vector import corners, dot, interpolate, norm, normalize, scale, triangle_normals
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import OFFSET, SurfacePoint, leave


class Occluders(NamedTuple):
    """Which auxiliary points are hidden, by which point of which face, and the boundary-test function B.

    `own`: hidden by the apex's own face, below its horizon; None if no light comes from there.
    """

    hidden: Bool[Array, "N Q C"]
    face: Int[Array, "N Q C"]
    barycentric: Float[Array, "N Q C 3"]
    boundary: Float[Array, "N Q C"]
    own: Bool[Array, "N Q C"] | None


def find_occluders(
    packed: PackedScene,
    faces: Faces,
    apex: SurfacePoint,
    ends: SegmentEnds,
    points: Auxiliary,
    rays: str,
    normal_edges: bool = True,
) -> Occluders:
    """One ray from each apex to each auxiliary point on the side of the surface that the target shows; all detached.

    - Points that are seen have no velocity, and B = 1.
    - Hidden points have the velocity of the occluder and its B^dist (Eq. 18). At the silhouette of a faceted occluder
      no cosine goes to zero. So, with `normal_edges`, distances to silhouette edges of the face that is hit count like
      distances to open edges.
    - Back-facing points have no velocity, and their own B^dist.
    - Points below the apex's horizon have no velocity, because f goes to zero at the horizon. With interpolated normals
      it does not: then the plane of the apex's own face hides these points.
    """
    full = points.there.shape
    row = jnp.broadcast_to(jnp.arange(full[0])[:, None, None], full).reshape(-1)
    face = points.face.reshape(-1)
    position, there = points.position.reshape(-1, 3), points.there.reshape(-1)
    origin = jax.tree.map(lambda a: a[row], apex)
    infinite, target_normal = ends.infinite[row], ends.normal[row]
    offset = position - origin.position
    length = norm(offset)

    normal = jnp.where(infinite[:, None], -target_normal, faces.normal[face])
    facing, to_target = -dot(normal, offset), ends.target - ends.apex
    shown = -dot(ends.normal, to_target)[row]
    alike = infinite | (facing * shown > 0)
    height = dot(origin.normal, offset) * jnp.sign(dot(apex.normal, to_target))[row]
    above = height > 0

    largest = jnp.abs(packed.corners_of(face)).max((1, 2))
    end = position + scale(normal, OFFSET * largest * jnp.sign(facing))
    start = leave(origin, offset)
    end = jnp.where(infinite[:, None], start + 2.0 * packed.size * normalize(offset), end)
    reach = jnp.where(there & alike & above, 1.0, 0.0).astype(start.dtype)
    hit, _, at = queries.closest_hit(packed.geometry, queries.Rays(start, end - start, reach), rays)
    hidden = hit >= 0
    hit = jnp.where(hidden, hit, 0)

    back = safe_divide(facing, length) ** 2
    boundary = jnp.where(alike, 1.0, back)
    boundary = jnp.where(hidden, _boundary_distance(packed, faces, hit, at, origin.position, normal_edges), boundary)
    own = None
    if packed.normals is not None:
        own = there & alike & ~above
        boundary = jnp.where(own, safe_divide(-height, length), boundary)
        hidden, hit = hidden | own, jnp.where(own, origin.face, hit)
        own = own.reshape(full)
    hidden, hit, boundary = (a.reshape(full) for a in (hidden, hit, boundary))
    return Occluders(hidden, hit, at.reshape(*full, 3), boundary, own)


def _to_sides(triangles, barycentric):
    """Distances of points on triangles to the three sides."""
    a, b, c = corners(triangles)
    lengths = norm(jnp.stack([c - b, a - c, b - a], 1))
    return safe_divide(barycentric * norm(triangle_normals(triangles))[:, None], lengths)


def _boundary_distance(packed: PackedScene, faces: Faces, face, barycentric, apex, normal_edges):
    """B^dist of points on occluders: the cosine squared, or the angular distance to an edge where the occluder ends."""
    triangles = packed.corners_of(face)
    position = interpolate(triangles, barycentric)
    offset = position - apex
    length = norm(offset)
    length = jnp.where(length > 0, length, 1.0)
    behind = faces.behind[face]
    slope = dot(faces.normal[face], offset)
    # For each side k, a point on it: the corner after k.
    on_side = jnp.roll(triangles, -1, axis=1) - apex[:, None]
    neighbour = dot(faces.normal[jnp.maximum(behind, 0)], on_side)
    ends_here = (behind < 0) | (neighbour * slope[:, None] <= 0) if normal_edges else behind < 0
    to_side = jnp.where(ends_here, _to_sides(triangles, barycentric), jnp.inf).min(-1)
    # At a smooth silhouette the cosine goes to zero like the root of the distance, so its square is a distance.
    return jnp.minimum((slope / length) ** 2, to_side / length)
