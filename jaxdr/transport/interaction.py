"""Surface points as differentiable functions of the scene: on a fixed ray, or as a material point."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, interpolate, norm, normalize, orthonormal_basis
from jaxdr.scene.packed import PackedScene

# Ray origins leave the surface by this share of the largest coordinate involved: some 32 float32 roundings.
OFFSET = 4e-6


class SurfacePoint(NamedTuple):
    """N points on the scene's surfaces; only `valid` ones mean anything (the others sit on face 0).

    `normal` is the unit geometric normal (orientation of the face), `shading_normal` the interpolated one, `area` the
    area of the face, all differentiable; `barycentric`, `face` and `scale`, the largest coordinate that the position
    was computed from, are detached. `on_face` are the barycentric coordinates as they change where the point slides
    over its face, differentiable; None in scenes without textures.
    """

    valid: Bool[Array, " N"]
    face: Int[Array, " N"]
    barycentric: Float[Array, "N 3"]
    position: Float[Array, "N 3"]
    normal: Float[Array, "N 3"]
    shading_normal: Float[Array, "N 3"]
    area: Float[Array, " N"]
    scale: Float[Array, " N"]
    on_face: Float[Array, "N 3"] | None = None

    def area_ratio(self) -> Float[Array, " N"]:
        """J = dA(x) / dA(p), one in value (Eq. 4): the Jacobian from the reference surface to the moving one."""
        return self.area / stop_gradient(self.area)


def _barycentric(corners, position, normal2):
    """Barycentric coordinates of points on their faces; `normal2` = cross product of two sides."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    squared = dot(normal2, normal2)
    u = dot(jnp.cross(c - b, position - b), normal2) / squared
    v = dot(jnp.cross(a - c, position - c), normal2) / squared
    return jnp.stack([u, v, 1.0 - u - v], -1)


def _surface_point(packed, valid, face, barycentric, position, corners, normal2, scale):
    length = norm(normal2)
    normal = normal2 / length[:, None]
    return SurfacePoint(
        valid=valid,
        face=face,
        barycentric=stop_gradient(barycentric),
        position=position,
        normal=normal,
        shading_normal=_shading_normal(packed, face, barycentric, normal),
        area=0.5 * length,
        scale=scale,
        on_face=barycentric if packed.textured else None,
    )


def _shading_normal(packed: PackedScene, face, barycentric, normal):
    if packed.normals is None:
        return normal
    groups = packed.normal_faces[face]
    interpolated = normalize(interpolate(packed.normals[groups], barycentric))
    return jnp.where(groups[:, :1] >= 0, interpolated, normal)


def on_fixed_ray(
    packed: PackedScene, origin: Float[Array, "N 3"], direction: Float[Array, "N 3"], face: Int[Array, " N"]
) -> SurfacePoint:
    """Where rays meet the moving planes of their faces: the points slide over the surface (DESIGN 1, fixed camera ray).

    `face` is -1 for a miss.
    """
    valid = face >= 0
    face = jnp.where(valid, face, 0)
    corners = packed.vertices[packed.faces[face]]
    normal2 = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = jnp.where(valid, dot(direction, normal2), 1.0)
    t = dot(corners[:, 0] - origin, normal2) / jnp.where(slope == 0, 1.0, slope)
    position = origin + t[:, None] * direction
    barycentric = _barycentric(corners, position, normal2)
    scale = jnp.maximum(_largest(corners), _max_of_three(jnp.abs(stop_gradient(origin))))
    return _surface_point(packed, valid, face, barycentric, position, corners, normal2, scale)


def _largest(corners):
    """Largest coordinate of the corners of each face, detached."""
    size = jnp.abs(stop_gradient(corners))
    return _max_of_three(jnp.maximum(jnp.maximum(size[:, 0], size[:, 1]), size[:, 2]))


def _max_of_three(v: Float[Array, "N 3"]) -> Float[Array, " N"]:
    """Written out, see `vector.interpolate`."""
    return jnp.maximum(jnp.maximum(v[:, 0], v[:, 1]), v[:, 2])


def material_point(
    packed: PackedScene, face: Int[Array, " N"], barycentric: Float[Array, "N 3"], valid: Bool[Array, " N"]
) -> SurfacePoint:
    """Points that move with their faces: fixed barycentric coordinates (Eq. 3)."""
    barycentric = stop_gradient(barycentric)
    corners = packed.vertices[packed.faces[face]]
    normal2 = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    position = interpolate(corners, barycentric)
    return _surface_point(packed, valid, face, barycentric, position, corners, normal2, _largest(corners))


def displaced(packed: PackedScene, point: SurfacePoint, moved: Float[Array, "N 3"]) -> SurfacePoint:
    """Points `moved` within the planes of their faces; shading normals and textures from as far as the faces reach."""
    corners = packed.vertices[packed.faces[point.face]]
    normal2 = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rate = _barycentric(corners, corners[:, 0] + moved, normal2) - jnp.asarray([1.0, 0.0, 0.0], moved.dtype)
    barycentric = jnp.maximum(point.barycentric + rate, 0.0)
    barycentric = barycentric / barycentric.sum(-1, keepdims=True)
    position = point.position + moved
    return _surface_point(packed, point.valid, point.face, barycentric, position, corners, normal2, _largest(corners))


def either(condition: Bool[Array, " N"], one: SurfacePoint, two: SurfacePoint) -> SurfacePoint:
    """Row by row, one point or the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b), one, two)


def intersect(
    packed: PackedScene,
    origin: Float[Array, "N 3"],
    direction: Float[Array, "N 3"],
    active: Bool[Array, " N"],
    rays: str,
    reach: Float[Array, " N"] | float = 1e30,
) -> Int[Array, " N"]:
    """The nearest face on each active ray within `reach`, -1 for none. `rays` names the query implementation."""
    reach = jnp.where(active, reach, 0.0).astype(origin.dtype)
    return queries.closest_hit(packed.geometry, queries.Rays(origin, direction, reach), rays).face


def detached_barycentric(packed: PackedScene, origin, direction, face) -> Float[Array, "N 3"]:
    """Barycentric coordinates of the hits of rays on known faces, detached and kept inside the face."""
    corners = stop_gradient(packed.vertices)[packed.faces[face]]
    normal2 = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    slope = dot(direction, normal2)
    t = dot(corners[:, 0] - origin, normal2) / jnp.where(slope == 0, 1.0, slope)
    barycentric = jnp.maximum(_barycentric(corners, origin + t[:, None] * direction, normal2), 0.0)
    return barycentric / barycentric.sum(-1, keepdims=True)


def leave(point: SurfacePoint, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Detached ray origins just off the surface, on the side of `towards`; the offset scales with the coordinates."""
    position, normal = stop_gradient(point.position), stop_gradient(point.normal)
    side = jnp.where(dot(normal, stop_gradient(towards)) >= 0, OFFSET, -OFFSET)
    return position + (side * point.scale)[:, None] * normal


def local_frame(normal: Float[Array, "N 3"], tangents: tuple[Float[Array, "N 3"], Float[Array, "N 3"]] | None = None):
    """Functions world -> local and local -> world for the frame around unit normals (z along the normal).

    Its x and y are the `tangents`, or any where none are given.
    """
    s, t = orthonormal_basis(normal) if tangents is None else tangents

    def to_local(w):
        return jnp.stack([dot(w, s), dot(w, t), dot(w, normal)], -1)

    def to_world(v):
        return v[..., :1] * s + v[..., 1:2] * t + v[..., 2:] * normal

    return to_local, to_world
