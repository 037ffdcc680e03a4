"""Segments of paths, looked up by number: positions of both ends, their motion, and the weight of the path."""

import copy
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.term import Chunk
from jaxdr.geometry.vector import between, dot, interpolate, normalize, scale, triangle_normals, vanishes
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.near_field import Footprint, footprint
from jaxdr.transport.path import PathRecord, Segments, Vertices
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer


class SegmentEnds(eqx.Module):
    """Both ends of C segments.

    - `apex` (on `apex_face`) and `target`: positions of the near and the far end, differentiable. The target is a
      material point. If it is `infinite`, it lies in one direction from the apex, at the distance of the scene's size.
    - `face`, `corners`: the target's face and its vertices.
    - `normal`: unit normal of the plane at the target: of its face, or at infinity of the plane across the segment.
    - `turn`: how directions to the environment turn, the identity in value; None if they do not.
    - `attached`: the apex as a material point, if it also has the form of a point on a fixed ray; else None.
    - `footprint`: the pixel's footprint at the apex; its size is zero where the apex has one form only.
    """

    apex: Float[Array, "C 3"]
    apex_face: Int[Array, " C"]
    target: Float[Array, "C 3"]
    normal: Float[Array, "C 3"]
    face: Int[Array, " C"]
    corners: Float[Array, "C 3 3"]
    infinite: Bool[Array, " C"]
    turn: Float[Array, "3 3"] | None = None
    attached: Float[Array, "C 3"] | None = None
    footprint: Footprint | None = None

    def apex_towards(self, goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """The apex, moving in the form that light from `goal` has."""
        return _mixed(self.apex, self.attached, self.footprint, goal)


def _mixed(apex, attached, seen: Footprint | None, goal):
    """Both forms of the apex, mixed by the near field's share of light from `goal`."""
    if seen is None:
        return apex
    offset = goal - stop_gradient(apex)
    return between(apex, attached, seen.share(dot(offset, offset)))


class PathSegments:
    """The segments of N paths, flattened over the bounces and looked up by number.

    If some vertices slide, `vertices` says how all of them move. `fixed` has the same segments, detached. If not
    `differentiated`, everything counts as detached already.
    """

    def __init__(
        self,
        packed: PackedScene,
        primary: PrimarySamples,
        segments: Segments,
        vertices: Vertices | None = None,
        differentiated: bool = True,
    ):
        bounces, self.paths = segments.apex_face.shape
        self.packed, self.view, self.near = packed, primary.view, primary.near
        self.first, self.first_wi = primary.first, -primary.direction
        self.table = jax.tree.map(lambda a: a.reshape(bounces * self.paths, *a.shape[2:]), segments)
        self.vertices = jax.tree.map(lambda a: a.reshape(bounces * self.paths, *a.shape[2:]), vertices)
        self.count = bounces * self.paths
        self.distance_to_infinity = packed.size
        self._positions: Float[Array, "S 3"] | None = None  # of all near ends, in `fixed` only
        self.fixed = copy.copy(self)
        if differentiated:
            moving = (packed, self.view, self.near, self.first, self.first_wi, self.table, self.vertices)
            fixed = self.fixed
            fixed.packed, fixed.view, fixed.near, fixed.first, fixed.first_wi, fixed.table, fixed.vertices = (
                stop_gradient(moving)
            )
        self.fixed.fixed = self.fixed
        self.fixed._positions = self.fixed.position(jnp.arange(self.count))

    def stand_still(self, moving: Bool[Array, " S"]) -> Bool[Array, " s"]:
        """Which segments have both ends at rest, if these shapes are `moving`; detached.

        If vertices slide, a vertex moves with its own shape and with those of all earlier vertices.
        """
        shape, table = self.packed.face_shape, self.table
        apex = moving[shape[table.apex_face]]
        if self.vertices is not None:
            before = jax.lax.cummax(apex.reshape(-1, self.paths).astype(jnp.int32), axis=0)
            apex = before.reshape(-1) > 0
        target = jnp.where(table.infinite, self.packed.environment_turns, moving[shape[table.target_face]])
        return ~(apex | target)

    def path(self, index: Int[Array, " C"]) -> Int[Array, " C"]:
        """Which path a segment belongs to."""
        return jax.lax.rem(index, jnp.full_like(index, self.paths))

    def apex(self, index: Int[Array, " C"]) -> SurfacePoint:
        """Near ends: the first hit if the segment is the path's second, else a material or sliding point."""
        face, barycentric = self.table.apex_face[index], self.table.apex_barycentric[index]
        point = material_point(self.packed, face, barycentric, jnp.ones(face.shape, bool))
        if self.vertices is not None:
            moving = self.vertices
            return point._replace(position=moving.position[index], shading_normal=moving.shading_normal[index])
        return point._replace(position=self._on_ray(index, point.position))

    def position(self, index: Int[Array, " C"], triangle: Float[Array, "C 3 3"] | None = None) -> Float[Array, "C 3"]:
        """Positions of the near ends. `triangle`: the corners of their faces, if known."""
        if self.vertices is not None:
            return self.vertices.position[index]
        if self._positions is not None:
            return self._positions[index]
        if triangle is None:
            triangle = self.packed.corners_of(self.table.apex_face[index])
        return self._on_ray(index, interpolate(triangle, stop_gradient(self.table.apex_barycentric[index])))

    def _on_ray(self, index, position):
        """The first hit if the segment is the path's second, else `position`."""
        return jnp.where((index < self.paths)[:, None], self.first.position[self.path(index)], position)

    def ends(self, index: Int[Array, " C"]) -> SegmentEnds:
        """Both ends of segments."""
        face, barycentric = self.table.target_face[index], self.table.target_barycentric[index]
        return self.ends_to(index, face, barycentric, self.table.infinite[index], self.table.direction[index])

    def ends_to(
        self,
        index: Int[Array, " C"],
        face: Int[Array, " C"],
        barycentric: Float[Array, "C 3"],
        infinite: Bool[Array, " C"],
        direction: Float[Array, "C 3"],
    ) -> SegmentEnds:
        """The near ends of segments, with other far ends: material points, or directions where `infinite`."""
        apex = self.position(index)
        triangle = self.packed.corners_of(face)
        far = infinite[:, None]
        attached, seen = self._attached(index, apex)
        if seen is not None:
            seen = seen._replace(size2=jnp.where(infinite, 0.0, seen.size2))
        return SegmentEnds(
            apex=apex,
            apex_face=self.table.apex_face[index],
            target=jnp.where(
                far,
                apex + self.distance_to_infinity * self.packed.turned(direction),
                interpolate(triangle, barycentric),
            ),
            normal=jnp.where(far, direction, normalize(triangle_normals(triangle))),
            face=face,
            corners=triangle,
            infinite=infinite,
            turn=self.packed.environment.turn() if self.packed.environment_turns else None,
            attached=attached,
            footprint=seen,
        )

    def _attached(self, index, apex):
        """(the apex as a material point, the pixel's footprint there); None if no apex has both forms."""
        if self.near is None:
            return None, None
        on_ray, path = index < self.paths, self.path(index)
        if self.vertices is not None:  # directions in delta lobes have one form
            on_ray = on_ray & ~self.vertices.delta[index]
        attached = jnp.where(on_ray[:, None], self.near.point.position[path], apex)
        seen = footprint(self.view.row(path), apex, self.first.normal[path])
        seen = jax.tree.map(stop_gradient, seen._replace(size2=jnp.where(on_ray, seen.size2, 0.0)))
        return attached, seen

    def apex_towards(
        self, index: Int[Array, " C"], apex: Float[Array, "C 3"], goal: Float[Array, "C 3"]
    ) -> Float[Array, "C 3"]:
        """Near ends at `apex`, moving in the form that light from `goal` has."""
        return _mixed(apex, *self._attached(index, apex), goal)

    def weight(
        self, index: Int[Array, " C"], goal: Float[Array, "C 3"], radiance: Float[Array, "C 3"] | None = None
    ) -> Float[Array, "C 3"]:
        """f / pdf without the segment's own BSDF value and geometric term, per area of the plane at the target.

        The environment's radiance is taken in the direction of `goal`. A surface's radiance is `radiance` if given,
        else that of the target.
        """
        infinite = self.table.infinite[index]
        far = jnp.where(infinite, self.distance_to_infinity**2, 1.0)
        weight, unlit = self.table.weight[index], self.table.unlit
        if unlit is not None and self.packed.has_varying_sky:
            sky = stop_gradient(environment_radiance(self.packed, self.direction(index, goal)))
            weight = jnp.where(infinite[:, None], unlit[index] * sky, weight)
        if unlit is not None and radiance is not None:
            weight = jnp.where(infinite[:, None], weight, unlit[index] * radiance)
        return scale(weight, far)

    def direction(self, index: Int[Array, " C"], goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """Unit directions from the near ends to `goal`; detached."""
        offset = stop_gradient(goal) - self.fixed.position(index)
        return normalize(jnp.where(vanishes(offset)[:, None], 1.0, offset))

    def scatterer(self, index: Int[Array, " C"], apex: SurfacePoint | None = None) -> Scatterer:
        """The BSDF at the near ends; detached. `apex`: the detached near ends, if known."""
        fixed = self.fixed
        if apex is None:
            apex = fixed.apex(index)
        previous = fixed.position(jnp.maximum(index - self.paths, 0))
        on_ray = (index < self.paths)[:, None]
        wi = jnp.where(on_ray, fixed.first_wi[self.path(index)], normalize(previous - apex.position))
        return Scatterer(fixed.packed, apex, wi)

    def transfer(
        self, index: Int[Array, " C"], ends: SegmentEnds, goal: Float[Array, "C 3"], scatterer: Scatterer | None = None
    ) -> Float[Array, "C 3"]:
        """BSDF value at the apex times geometric term towards points of the target's plane, RGB per area; detached.

        `scatterer`: that of the near ends, if known.
        """
        if scatterer is None:
            scatterer = self.scatterer(index)
        offset = goal - scatterer.point.position
        distance2 = dot(offset, offset)
        distance2 = jnp.where(distance2 > 0, distance2, 1.0)
        towards = normalize(offset)
        return scale(scatterer.eval(towards), jnp.abs(dot(stop_gradient(ends.normal), towards)) / distance2)


def on_face(packed: PackedScene, face: Int[Array, " C"], barycentric: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
    """Positions of material points."""
    return interpolate(packed.corners_of(face), stop_gradient(barycentric))


def path_segments(
    packed: PackedScene, chunk: Chunk, kind: Literal["direct", "scattered"], differentiated: bool = True
) -> PathSegments:
    """The segments of one kind of a chunk's paths. `Term.draw` needs them without `differentiated`."""
    record: PathRecord = chunk.record
    segments = getattr(record, kind)
    vertices = jax.tree.map(lambda x: x[: segments.apex_face.shape[0]], record.vertices)
    return PathSegments(packed, chunk.primary, segments, vertices, differentiated)
