"""The strip of a kernel at a boundary point: how wide it is inside the emitter, and whether the apex sees it."""

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.boundary.shared.emitter_planes import few_emitter_faces, part_inside
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.shared.projection import (
    Projection,
    affine_coordinates,
    affine_rates,
    past_edge,
)
from jaxdr.geometry import queries
from jaxdr.geometry.vector import corners, dot, norm, scale, triangle_normals
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.interaction import SurfacePoint, leave


def _inradius(triangles) -> Float[Array, " C"]:
    """Radius of the circle inscribed in triangles."""
    a, b, c = corners(triangles)
    return norm(triangle_normals(triangles)) / (norm(b - a) + norm(c - b) + norm(a - c))


def strip_in_face(packed: PackedScene, ends: SegmentEnds, projection: Projection, r, both_sides: bool):
    """(width of the kernel's strip across a boundary point, whether it was cut to the face, whether the point counts).

    Strips are cut to the emitter if emitters have few faces, else to the target's face if that is larger than the
    kernel. Smaller faces belong to a larger surface, so there the strip goes on in the plane of the face.
    """
    low, high = -r, r if both_sides else jnp.zeros_like(r)
    target, normal = stop_gradient((ends.corners, ends.normal))
    width, inside = _overlap(projection.barycentric, affine_rates(target, projection.normal), low, high)
    large = _inradius(target) > r
    if few_emitter_faces(packed):
        on_emitter = (ends.face[:, None] == packed.emitter_faces).any(-1)
        triangles = stop_gradient(packed.vertices)[packed.faces[packed.emitter_faces]]
        same_shape = packed.face_shape[packed.emitter_faces] == packed.face_shape[ends.face][:, None]
        height = jnp.abs(dot(triangles[None] - projection.point[:, None, None], normal[:, None, None]))
        first, second, _ = corners(triangles)
        coplanar = same_shape & (height.max(-1) <= 1e-4 * norm(second - first))
        barycentric = affine_coordinates(triangles, projection.point[:, None])
        rate = affine_rates(triangles, projection.normal[:, None])
        widths, insides = _overlap(barycentric, rate, low[:, None], high[:, None])
        width = jnp.where(on_emitter, jnp.where(coplanar, widths, 0.0).sum(-1), width)
        inside = jnp.where(on_emitter, (coplanar & insides).any(-1), inside)
        large = large | on_emitter
    large = large & ~ends.infinite
    return jnp.where(large, width, high - low), large, (inside & (width > 0)) | ~large


def _overlap(barycentric, rate, low, high):
    """(length of the line's parameter range [low, high] inside triangles, whether the line's origin is inside)."""
    start, end = part_inside(barycentric, rate, low, high)
    return end - start, (barycentric > 0).all(-1)


def sees_past_edge(
    packed, apex: SurfacePoint, projection: Projection, r, whole_face, valid, rays: str
) -> Bool[Array, " C"]:
    """Whether the (detached) apex sees past the edge to the target's plane, along a ray just beside the edge."""
    fraction = projection.fraction
    past = past_edge(projection.edge_point, apex.position, projection.normal)
    start = leave(apex, past - apex.position)
    # The ray goes through `past`, however far the start is moved off the surface.
    reach = scale(past - start, safe_divide(1.0, fraction, fraction > 0))
    # A curved receiver rises above the plane of one of its faces: stop one radius short of it. The path itself shows
    # that the target, less than a radius away, can be seen.
    short = r / jnp.maximum(norm(reach), r)
    stop = jnp.where(whole_face, 1.0 - 1e-4, jnp.maximum(1.0 - short, 0.5 * (1.0 + fraction)))
    stop = jnp.where(valid, stop, 0.0)
    return ~queries.occluded(packed.geometry, queries.Rays(start, reach, stop), rays)
