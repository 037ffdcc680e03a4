"""BSDFs at surface points: each point gets its shape's BSDF, with the values of its textures."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry.vector import components, corners, cross, dot, from_components, normalize, orthonormal_basis, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.textures import TexturePoint, textures_in
from jaxdr.transport.interaction import SurfacePoint


def bsdfs_at(packed: PackedScene, point: SurfacePoint, shape: Int[Array, " N"]) -> list[tuple[BSDF, Bool[Array, " N"]]]:
    """(BSDF with a row for each point, which points have it) for each group of BSDFs; `shape`: of the points."""
    at = texture_point(packed, point) if packed.textured else None
    return [(group.at(shape, at), group.member[shape]) for group in packed.bsdfs]


def texture_point(packed: PackedScene, point: SurfacePoint) -> TexturePoint:
    """Where textures are looked up. If the point slides over its face, this does as well."""
    assert point.on_face is not None  # set if the scene has textures
    found = packed.texture_point(point.face, point.on_face)
    return found._replace(axes=_uv_axes(packed, point)) if packed.uses_slopes else found


def _uv_axes(packed: PackedScene, point: SurfacePoint) -> Float[Array, "N 3"]:
    """`TexturePoint.axes`."""
    triangle, (u1, v1), (u2, v2) = _sides(packed, point)
    determinant = u1 * v2 - v1 * u2
    known = determinant != 0
    inverse = safe_divide(1.0, determinant, known, 0.0)
    one, two = triangle.b - triangle.a, triangle.c - triangle.a
    by_u = scale(scale(one, v2) - scale(two, v1), inverse)
    by_v = scale(scale(two, u1) - scale(one, u2), inverse)
    s, t = tangents_along_u(packed, point)
    return from_components(dot(by_u, s), dot(by_v, s), dot(by_v, t))


def _sides(packed: PackedScene, point: SurfacePoint):
    """Faces, and the (u, v) of two of their sides."""
    uv0, uv1, uv2 = corners(packed.uvs[packed.uv_faces[point.face]])
    return packed.triangles(point.face), components(uv1 - uv0), components(uv2 - uv0)


def tangents_along_u(packed: PackedScene, point: SurfacePoint) -> tuple[Float[Array, "N 3"], Float[Array, "N 3"]]:
    """Two tangents, which complete the shading normal to a right-handed frame; the first points to increasing u.

    If the UVs of a face define no direction, the tangents are arbitrary.
    """
    normal = point.shading_normal
    triangle, (u1, v1), (u2, v2) = _sides(packed, point)
    along = scale(triangle.b - triangle.a, v2) - scale(triangle.c - triangle.a, v1)
    along = scale(normalize(along), jnp.sign(u1 * v2 - v1 * u2))  # dp/du at constant v
    along = normalize(along - scale(normal, dot(normal, along)))
    known = dot(along, along)[:, None] > 0
    s = jnp.where(known, along, orthonormal_basis(normal)[0])
    return s, cross(normal, s)


def texture_difference(packed: PackedScene, one: SurfacePoint, two: SurfacePoint) -> Float[Array, " N"]:
    """Sum of the differences of all textured fields between points of the same shapes; mean over channels."""
    shape, total = packed.face_shape[one.face], jnp.zeros_like(one.area)
    if not packed.textured:
        return total
    first, second = texture_point(packed, one), texture_point(packed, two)
    for group in packed.bsdfs:
        for _, texture in textures_in(group.bsdf):
            row = group.row[shape]
            apart = jnp.abs(texture.lookup(row, first) - texture.lookup(row, second)).mean(-1)
            total = total + jnp.where(group.member[shape], apart, 0.0)
    return total
