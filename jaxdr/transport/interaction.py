"""Surface points as differentiable functions of the scene: on a fixed ray, or as a material point."""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.geometry import queries
from jaxdr.geometry.gather import rows_of
from jaxdr.geometry.vector import components, cross, dot, from_components, interpolate, normalize, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene, Triangles

# Ray origins leave the surface by this share of the largest coordinate: about 32 float32 roundings.
OFFSET = 4e-6


class SurfacePoint(NamedTuple):
    """N points on the scene's surfaces; only `valid` points count (the others are on face 0).

    - `position`; `normal`: unit geometric normal, with the face's orientation; `shading_normal`: interpolated normal;
      `area`: of the face. All are differentiable.
    - `face`, `barycentric`, `scale` (the largest coordinate from which the position was computed): detached.
    - `on_face`: barycentric coordinates that change as the point slides over its face, differentiable; None in scenes
      without textures.
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


def _barycentric(triangle: Triangles, position) -> Float[Array, "N 3"]:
    """Barycentric coordinates of points on their faces."""
    a, b, c, normal, area, _ = triangle
    twice = 2.0 * area
    u = dot(cross(c - b, position - b), normal) / twice
    v = dot(cross(a - c, position - c), normal) / twice
    return from_components(u, v, 1.0 - u - v)


def _surface_point(packed, valid, face, barycentric, position, triangle: Triangles, largest):
    return SurfacePoint(
        valid=valid,
        face=face,
        barycentric=stop_gradient(barycentric),
        position=position,
        normal=triangle.normal,
        shading_normal=_shading_normal(packed, face, barycentric, triangle.normal),
        area=triangle.area,
        scale=largest,
        on_face=barycentric if packed.textured else None,
    )


def _shading_normal(packed: PackedScene, face, barycentric, normal):
    if packed.normals is None:
        return normal
    groups = packed.normal_faces[face]
    interpolated = normalize(interpolate(rows_of(packed.normals, groups), barycentric))
    return jnp.where(groups[:, :1] >= 0, interpolated, normal)


def on_fixed_ray(
    packed: PackedScene,
    origin: Float[Array, "N 3"],
    direction: Float[Array, "N 3"],
    face: Int[Array, " N"],
    barycentric: Float[Array, "N 3"] | None = None,
) -> SurfacePoint:
    """Where rays meet the moving planes of their faces: the points slide over the surface (fixed camera ray).

    `face` is -1 for a miss. `barycentric`: coordinates of the hits, if known.
    """
    valid = face >= 0
    face = jnp.where(valid, face, 0)
    triangle = packed.triangles(face)
    slope = jnp.where(valid, dot(direction, triangle.normal), 1.0)
    t = safe_divide(dot(triangle.a - origin, triangle.normal), slope)
    position = origin + scale(direction, t)
    if packed.textured or packed.normals is not None:
        barycentric = _barycentric(triangle, position)
    elif barycentric is None:  # no derivative depends on the place of a point on its face
        barycentric = _barycentric(*stop_gradient((triangle, position)))
    largest = jnp.maximum(triangle.largest, _largest(origin))
    return _surface_point(packed, valid, face, barycentric, position, triangle, largest)


def _largest(point):
    """Largest coordinate of points; detached."""
    return reduce(jnp.maximum, components(jnp.abs(stop_gradient(point))))


def material_point(
    packed: PackedScene, face: Int[Array, " N"], barycentric: Float[Array, "N 3"], valid: Bool[Array, " N"]
) -> SurfacePoint:
    """Points that move with their faces: fixed barycentric coordinates (Eq. 3)."""
    barycentric = stop_gradient(barycentric)
    triangle = packed.triangles(face)
    position = interpolate(triangle[:3], barycentric)
    return _surface_point(packed, valid, face, barycentric, position, triangle, triangle.largest)


def material_hit(packed: PackedScene, hit: queries.Hit) -> SurfacePoint:
    """The material points that rays hit."""
    valid = hit.face >= 0
    return material_point(packed, jnp.where(valid, hit.face, 0), hit.barycentric, valid)


def displaced(packed: PackedScene, point: SurfacePoint, moved: Float[Array, "N 3"]) -> SurfacePoint:
    """Points `moved` within the planes of their faces. Outside a face, shading normal and texture are its border's."""
    triangle = packed.triangles(point.face)
    rate = _barycentric(triangle, triangle.a + moved) - jnp.asarray([1.0, 0.0, 0.0], moved.dtype)
    barycentric = _inside(point.barycentric + rate)
    position = point.position + moved
    return _surface_point(packed, point.valid, point.face, barycentric, position, triangle, triangle.largest)


def _inside(barycentric):
    """Barycentric coordinates kept inside the face."""
    u, v, w = (jnp.maximum(x, 0.0) for x in components(barycentric))
    return from_components(*(x / (u + v + w) for x in (u, v, w)))


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
) -> queries.Hit:
    """The nearest hit on each active ray within `reach`. `rays` names the query implementation."""
    reach = jnp.where(active, reach, 0.0).astype(origin.dtype)
    return queries.closest_hit(packed.geometry, queries.Rays(origin, direction, reach), rays)


def detached_barycentric(packed: PackedScene, origin, direction, face) -> Float[Array, "N 3"]:
    """Barycentric coordinates of the hits of rays on known faces, detached and kept inside the face."""
    triangle, origin, direction = stop_gradient((packed.triangles(face), origin, direction))
    slope = dot(direction, triangle.normal)
    t = safe_divide(dot(triangle.a - origin, triangle.normal), slope)
    return _inside(_barycentric(triangle, origin + scale(direction, t)))


def leave(point: SurfacePoint, towards: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
    """Detached ray origins just off the surface, on the side of `towards`; the offset scales with the coordinates."""
    position, normal = stop_gradient(point.position), stop_gradient(point.normal)
    side = jnp.where(dot(normal, stop_gradient(towards)) >= 0, OFFSET, -OFFSET)
    return position + scale(normal, side * point.scale)
