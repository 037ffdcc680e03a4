"""Silhouettes as seen from the near end of a path segment, projected to its far end."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.term import Chunk
from jaxdr.geometry.vector import dot, interpolate, norm, normalize
from jaxdr.scene.packed import PackedScene, concave_edges
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.near_field import Footprint, footprint
from jaxdr.transport.path import Segments, Vertices
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer

# How far beside an edge visibility rays pass, as a share of the largest coordinate: some 100 float32 roundings.
BESIDE = 1.2e-5


class SegmentEnds(eqx.Module):
    """Both ends of C segments; `apex`, on `apex_face`, and `target` are differentiable.

    `target` follows its material point; at infinity it stays in one direction from the apex, as far away as the scene
    is large. `face` is the target's and `corners` are its vertices; `normal` is that of the plane at the target: its
    face, or at infinity the plane across the segment. `turn`, the identity in value, is how directions to the
    environment move, where they do. `attached` is the apex as a material point where it has both forms, `footprint`
    that of a pixel there, of size zero where it has one form.
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
        """The apex as it moves for light from `goal`."""
        return _mixed(self.apex, self.attached, self.footprint, goal)


def _mixed(apex, attached, seen: Footprint | None, goal):
    """Both forms of the apex, mixed by the share that the near field has of light from `goal`."""
    if seen is None:
        return apex
    offset = goal - stop_gradient(apex)
    share = seen.share(dot(offset, offset))[:, None]
    return (1 - share) * apex + share * attached


class PathSegments:
    """The segments of N paths, flattened over the bounces and looked up by number.

    Where some vertices slide, `vertices` says how all of them move.
    """

    def __init__(
        self, packed: PackedScene, primary: PrimarySamples, segments: Segments, vertices: Vertices | None = None
    ):
        bounces, self.paths = segments.apex_face.shape
        self.packed, self.view, self.near = packed, primary.view, primary.near
        self.first, self.first_wi = primary.first, -primary.direction
        self.table = jax.tree.map(lambda a: a.reshape(bounces * self.paths, *a.shape[2:]), segments)
        self.vertices = jax.tree.map(lambda a: a.reshape(bounces * self.paths, *a.shape[2:]), vertices)
        self.count = bounces * self.paths
        self.distance_to_infinity = packed.size

    def stand_still(self, moving: Bool[Array, " S"]) -> Bool[Array, " s"]:
        """Which segments have two ends that do not move, from which shapes do; detached.

        Where vertices slide, one moves with its own shape or any one before.
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
        return index % self.paths

    def apex(self, index: Int[Array, " C"]) -> SurfacePoint:
        """Near ends: the first hit where the segment is the path's second one, else a material or sliding point."""
        face, barycentric = self.table.apex_face[index], self.table.apex_barycentric[index]
        point = material_point(self.packed, face, barycentric, jnp.ones(face.shape, bool))
        if self.vertices is not None:
            moving = self.vertices
            return point._replace(position=moving.position[index], shading_normal=moving.shading_normal[index])
        on_ray = (index < self.paths)[:, None]
        return point._replace(position=jnp.where(on_ray, self.first.position[self.path(index)], point.position))

    def ends(self, index: Int[Array, " C"]) -> SegmentEnds:
        """Both ends."""
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
        """The near ends, and other material points (directions where `infinite`) for far ends."""
        apex = self.apex(index).position
        corners = self.packed.vertices[self.packed.faces[face]]
        normal = normalize(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        on_face = interpolate(corners, barycentric)
        far = infinite[:, None]
        attached, seen = self._attached(index, apex)
        if seen is not None:
            seen = seen._replace(size2=jnp.where(infinite, 0.0, seen.size2))
        return SegmentEnds(
            apex=apex,
            apex_face=self.table.apex_face[index],
            target=jnp.where(far, apex + self.distance_to_infinity * self.packed.turned(direction), on_face),
            normal=jnp.where(far, direction, normal),
            face=face,
            corners=corners,
            infinite=infinite,
            turn=self.packed.environment.turn() if self.packed.environment_turns else None,
            attached=attached,
            footprint=seen,
        )

    def _attached(self, index, apex):
        """(the apex as a material point, footprint of a pixel there or of nothing) where it has both forms."""
        if self.near is None:
            return None, None
        on_ray, path = index < self.paths, self.path(index)
        if self.vertices is not None:  # directions in delta lobes have one form
            on_ray = on_ray & ~self.vertices.delta[index]
        attached = jnp.where(on_ray[:, None], self.near.point.position[path], apex)
        seen = footprint(self.view.row(path), apex, self.first.normal[path])
        seen = jax.tree.map(stop_gradient, seen._replace(size2=jnp.where(on_ray, seen.size2, 0.0)))
        return attached, seen

    def apex_towards(self, index: Int[Array, " C"], goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """Near ends as they move for light from `goal`."""
        apex = self.apex(index).position
        return _mixed(apex, *self._attached(index, apex), goal)

    def weight(
        self, index: Int[Array, " C"], goal: Float[Array, "C 3"], radiance: Float[Array, "C 3"] | None = None
    ) -> Float[Array, "C 3"]:
        """f / pdf without the segment's own BSDF value and geometric term, per area of the plane at the target.

        From the environment comes what it sends from the direction of `goal`, from surfaces `radiance` where it is
        given: else what the target sends.
        """
        infinite = self.table.infinite[index]
        far = jnp.where(infinite, self.distance_to_infinity**2, 1.0)
        weight, unlit = self.table.weight[index], self.table.unlit
        if unlit is not None and self.packed.has_varying_sky:
            sky = stop_gradient(environment_radiance(self.packed, self.direction(index, goal)))
            weight = jnp.where(infinite[:, None], unlit[index] * sky, weight)
        if unlit is not None and radiance is not None:
            weight = jnp.where(infinite[:, None], weight, unlit[index] * radiance)
        return weight * far[:, None]

    def direction(self, index: Int[Array, " C"], goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """From the near ends to `goal`; detached."""
        offset = stop_gradient(goal - self.apex(index).position)
        there = dot(offset, offset) > 0
        return normalize(jnp.where(there[:, None], offset, 1.0))

    def scatterer(self, index: Int[Array, " C"]) -> Scatterer:
        """The BSDF at the near ends; detached."""
        apex = jax.tree.map(stop_gradient, self.apex(index))
        before = jnp.maximum(index - self.paths, 0)
        previous = stop_gradient(self.apex(before).position)
        on_ray = (index < self.paths)[:, None]
        wi = jnp.where(on_ray, stop_gradient(self.first_wi)[self.path(index)], normalize(previous - apex.position))
        return Scatterer(jax.tree.map(stop_gradient, self.packed), apex, wi)

    def transfer(self, index: Int[Array, " C"], ends: SegmentEnds, goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """BSDF value at the apex times geometric term towards points of the target's plane, RGB per area; detached."""
        scatterer = self.scatterer(index)
        offset = goal - scatterer.point.position
        distance2 = dot(offset, offset)
        distance2 = jnp.where(distance2 > 0, distance2, 1.0)
        towards = offset / jnp.sqrt(distance2)[:, None]
        return scatterer.eval(towards) * (jnp.abs(dot(stop_gradient(ends.normal), towards)) / distance2)[:, None]


def path_segments(packed: PackedScene, chunk: Chunk, kind: Literal["direct", "scattered"]) -> PathSegments:
    """The segments of one kind of a chunk's paths."""
    record = chunk.record
    segments = getattr(record, kind)
    vertices = jax.tree.map(lambda x: x[: segments.apex_face.shape[0]], record.vertices)
    return PathSegments(packed, chunk.primary, segments, vertices)


class Projection(eqx.Module):
    """Edges projected from the apex onto the plane at the target; all but `displacement` detached.

    - `point` on the projected edge, `edge_point` on the 3D edge, `fraction` of the way to the plane at which that lies.
    - `normal`: unit, in the plane, towards the side of the edge's faces (the occluded side).
    - `displacement` = normal . (projected edge point - material point there): its derivative is the scalar normal
      velocity V (Eq. 6).
    - `stretch`: length on the plane per length of edge.
    - `barycentric` coordinates of `point` on the target's face, and their rate of change along `normal`.
    """

    point: Float[Array, "C 3"]
    edge_point: Float[Array, "C 3"]
    fraction: Float[Array, " C"]
    normal: Float[Array, "C 3"]
    displacement: Float[Array, " C"]
    stretch: Float[Array, " C"]
    barycentric: Float[Array, "C 3"]
    barycentric_rate: Float[Array, "C 3"]


def project_edges(
    packed: PackedScene, edge: Int[Array, " C"], ends: SegmentEnds, along: Float[Array, " C"] | None = None
) -> Projection:
    """Project edges: the foot of the perpendicular from the target, or the point `along` the 3D edge (0 to 1)."""
    vertices = packed.vertices[packed.edges.vertices[edge]]
    p0, p1 = vertices[:, 0], vertices[:, 1]
    apex, target, normal = (stop_gradient(x) for x in (ends.apex, ends.target, ends.normal))
    s0, s1 = stop_gradient(p0) - apex, stop_gradient(p1) - apex
    height = _nonzero(dot(normal, target - apex))
    if along is None:
        along = foot_on_edge(s0, s1, dot(normal, s0) / height, dot(normal, s1) / height, target - apex)
    point = (1 - along)[:, None] * p0 + along[:, None] * p1

    to_edge = stop_gradient(point) - apex
    on_plane = apex + to_edge * (height / _nonzero(dot(normal, to_edge)))[:, None]
    moving_apex = ends.apex_towards(on_plane)
    offset = point - moving_apex
    scale = dot(ends.normal, ends.target - moving_apex) / _nonzero(dot(ends.normal, offset))
    projected = moving_apex + offset * scale[:, None]

    plane, own = occluded_side(packed, edge, apex, ends.apex_face)
    in_plane = normalize(plane - dot(plane, normal)[:, None] * normal)

    # The material point under the projected edge: rigid with the target's face, extended beyond it where need be.
    corners = stop_gradient(ends.corners)
    barycentric = affine_coordinates(corners, on_plane)
    rate = affine_coordinates(corners, corners[:, 0] + in_plane) - jnp.asarray([1.0, 0.0, 0.0], barycentric.dtype)
    rigid = interpolate(ends.corners, barycentric)
    sky = on_plane - apex if ends.turn is None else (on_plane - apex) @ ends.turn.T
    material = jnp.where(ends.infinite[:, None], ends.apex + sky, rigid)
    # The apex stays in its face, so where that sets, the boundary moves as the plane does. Projected from an edge that
    # is close by, its motion would be the difference of two fast ones.
    corner = packed.vertices[packed.faces[ends.apex_face, 0]]
    horizon = dot(horizon_normal(packed, ends.apex_face, plane), corner - on_plane) / _nonzero(dot(plane, in_plane))
    moved = jnp.where(own, horizon, dot(in_plane, projected))

    tangent = normalize(s1 - s0)
    depth = _nonzero(dot(normal, to_edge))[:, None]
    stretch = norm(height[:, None] * (tangent / depth - to_edge * dot(normal, tangent)[:, None] / depth**2))
    return Projection(
        point=on_plane,
        edge_point=stop_gradient(point),
        fraction=depth[:, 0] / height,
        normal=in_plane,
        displacement=moved - dot(in_plane, material),
        stretch=stretch,
        barycentric=barycentric,
        barycentric_rate=rate,
    )


def occluded_side(
    packed: PackedScene, edge: Int[Array, " C"], apex: Float[Array, "C 3"], apex_face: Int[Array, " C"]
) -> tuple[Float[Array, "C 3"], Bool[Array, " C"]]:
    """(unit normals of the planes through apexes and silhouettes, towards the faces there, detached; own face or not).

    Own are edges of the apex's own face: silhouettes where that face sets. The plane is the face's there.
    """
    vertices, edges = stop_gradient(packed.vertices), packed.edges
    p0, p1 = vertices[edges.vertices[edge, 0]], vertices[edges.vertices[edge, 1]]
    a, b, c = (vertices[packed.faces[apex_face, k]] for k in range(3))
    own = (edges.faces[edge] == apex_face[:, None]) & (apex_face >= 0)[:, None]
    plane = jnp.where(own.any(-1, keepdims=True), jnp.cross(b - a, c - a), jnp.cross(p0 - apex, p1 - p0))
    # The apex's own face lies in the plane: the face furthest from it tells the side.
    opposite = edges.opposite[edge]
    height = (plane[:, None] * (vertices[opposite] - p0[:, None])).sum(-1)
    height = jnp.where((opposite >= 0) & ~own, height, 0.0)
    furthest = jnp.take_along_axis(height, jnp.abs(height).argmax(-1)[:, None], 1)
    return normalize(plane) * jnp.sign(furthest), own.any(-1)


def horizon_normal(packed: PackedScene, face: Int[Array, " C"], normal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
    """Unit normals of faces, turned to the side of `normal`; differentiable."""
    a, b, c = (packed.vertices[packed.faces[face, k]] for k in range(3))
    moving = normalize(jnp.cross(b - a, c - a))
    return moving * jnp.sign(dot(stop_gradient(moving), normal))[:, None]


def past_edge(
    edge_point: Float[Array, "C 3"], apex: Float[Array, "C 3"], normal: Float[Array, "C 3"]
) -> Float[Array, "C 3"]:
    """Points just beside edges for visibility rays from `apex`; `normal` points to the occluded side. Detached."""
    edge_point = stop_gradient(edge_point)
    beside = BESIDE * jnp.maximum(jnp.abs(edge_point).max(-1), jnp.abs(apex).max(-1))
    return edge_point - beside[:, None] * normal


def _nonzero(x):
    """`x`, with 1 in place of 0 for slots that hold no pair."""
    return jnp.where(x == 0, 1.0, x)


def affine_coordinates(corners: Float[Array, "*#n 3 3"], point: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Barycentric coordinates of points in the planes of triangles."""
    origin = corners[..., 0, :]
    e1, e2, q = corners[..., 1, :] - origin, corners[..., 2, :] - origin, point - origin
    normal = jnp.cross(e1, e2)
    squared = dot(normal, normal)
    v, w = dot(jnp.cross(q, e2), normal) / squared, dot(jnp.cross(e1, q), normal) / squared
    return jnp.stack([1 - v - w, v, w], -1)


def foot_on_edge(s0, s1, f0, f1, target):
    """Fraction of the 3D edge that projects to the foot of the perpendicular from the target; all relative to the apex.

    `f0`, `f1` are the fractions of the way to the plane at which the ends lie; the edge is clipped to what is between.
    """
    c0, c1 = jnp.clip(f0, 1e-6, 1.0), jnp.clip(f1, 1e-6, 1.0)
    rise = _nonzero(f1 - f0)
    t0, t1 = jnp.where(c0 == f0, 0.0, (c0 - f0) / rise), jnp.where(c1 == f1, 1.0, (c1 - f0) / rise)
    q0, q1 = s0 + t0[:, None] * (s1 - s0), s0 + t1[:, None] * (s1 - s0)
    start = q0 / c0[:, None]
    line = q1 / c1[:, None] - start
    s = jnp.clip(dot(target - start, line) / _nonzero(dot(line, line)), 0.0, 1.0)
    # Equal steps on the plane are not equal steps on the edge (perspective).
    tau = s * c0 / _nonzero(s * c0 + (1 - s) * c1)
    return t0 + tau * (t1 - t0)


def never_silhouettes(packed: PackedScene) -> Bool[Array, " E"]:
    """Concave edges of shapes that can only be seen from outside: they never bound what is visible."""
    return concave_edges(packed) & _seen_from_outside(packed)[packed.edges.shape]


def _seen_from_outside(packed: PackedScene) -> Bool[Array, " S"]:
    """Closed one-sided shapes that no other shape reaches into: everything that scatters light is outside of them.

    Unless it is they who scatter what is inside.

    Decided by bounding boxes, the shape's own shrunk by one per cent so that touching is not reaching in.
    """
    lower, upper = packed.shape_bounds()
    count = len(packed.closed)
    margin = 0.01 * (upper - lower)
    apart = (lower[None] > (upper - margin)[:, None]) | (upper[None] < (lower + margin)[:, None])
    alone = (apart.any(-1) | jnp.eye(count, dtype=bool)).all(1)
    alone = alone & jnp.asarray(packed.closed) & ~packed.two_sided
    through = packed.spreads_through
    return alone if through is None else alone & ~through
