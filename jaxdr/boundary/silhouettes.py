"""Silhouettes as seen from the near end of a path segment, projected to its far end."""

import copy
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.term import Chunk
from jaxdr.geometry.vector import (
    between,
    corners,
    cross,
    dot,
    from_components,
    interpolate,
    norm,
    normalize,
    scale,
    transform,
    triangle_normals,
)
from jaxdr.scene.packed import PackedScene, concave_edges
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.near_field import Footprint, footprint
from jaxdr.transport.path import PathRecord, Segments, Vertices
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
    return between(apex, attached, seen.share(dot(offset, offset)))


class PathSegments:
    """The segments of N paths, flattened over the bounces and looked up by number.

    Where some vertices slide, `vertices` says how all of them move. `fixed` are the same segments, detached; themselves
    where nothing is `differentiated`.
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
        self._positions: Float[Array, "S 3"] | None = None  # known of all where nothing is differentiated
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
        return jax.lax.rem(index, jnp.full_like(index, self.paths))

    def apex(self, index: Int[Array, " C"]) -> SurfacePoint:
        """Near ends: the first hit where the segment is the path's second one, else a material or sliding point."""
        face, barycentric = self.table.apex_face[index], self.table.apex_barycentric[index]
        point = material_point(self.packed, face, barycentric, jnp.ones(face.shape, bool))
        if self.vertices is not None:
            moving = self.vertices
            return point._replace(position=moving.position[index], shading_normal=moving.shading_normal[index])
        return point._replace(position=self._on_ray(index, point.position))

    def position(self, index: Int[Array, " C"], triangle: Float[Array, "C 3 3"] | None = None) -> Float[Array, "C 3"]:
        """Near ends: the positions of `apex`; `triangle`: the corners of their faces, where they are at hand."""
        if self.vertices is not None:
            return self.vertices.position[index]
        if self._positions is not None:
            return self._positions[index]
        if triangle is None:
            triangle = self.packed.vertices[self.packed.faces[self.table.apex_face[index]]]
        return self._on_ray(index, interpolate(triangle, stop_gradient(self.table.apex_barycentric[index])))

    def _on_ray(self, index, position):
        """First hits where the segment is the path's second one."""
        return jnp.where((index < self.paths)[:, None], self.first.position[self.path(index)], position)

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
        apex = self.position(index)
        triangle = self.packed.vertices[self.packed.faces[face]]
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

    def apex_towards(
        self, index: Int[Array, " C"], apex: Float[Array, "C 3"], goal: Float[Array, "C 3"]
    ) -> Float[Array, "C 3"]:
        """Near ends, of positions `apex`, as they move for light from `goal`."""
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
        return scale(weight, far)

    def direction(self, index: Int[Array, " C"], goal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        """From the near ends to `goal`; detached."""
        offset = stop_gradient(goal) - self.fixed.position(index)
        there = dot(offset, offset) > 0
        return normalize(jnp.where(there[:, None], offset, 1.0))

    def scatterer(self, index: Int[Array, " C"], apex: SurfacePoint | None = None) -> Scatterer:
        """The BSDF at the near ends; detached. `apex`: these, detached, where they are at hand."""
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

        `scatterer` is that of the near ends, where it is at hand.
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
    return interpolate(packed.vertices[packed.faces[face]], stop_gradient(barycentric))


def path_segments(
    packed: PackedScene, chunk: Chunk, kind: Literal["direct", "scattered"], differentiated: bool = True
) -> PathSegments:
    """The segments of one kind of a chunk's paths; not `differentiated` in `Term.draw`."""
    record: PathRecord = chunk.record
    segments = getattr(record, kind)
    vertices = jax.tree.map(lambda x: x[: segments.apex_face.shape[0]], record.vertices)
    return PathSegments(packed, chunk.primary, segments, vertices, differentiated)


class Projection(eqx.Module):
    """Edges projected from the apex onto the plane at the target; detached.

    - `along`: the fraction of the 3D edge, `edge_point` the point there; `fraction` of the way to the plane at which
      that lies, `point` its projection.
    - `pole`: unit normal of the plane through apex and edge, `normal`: unit, in the target's plane; both towards the
      side of the edge's faces (the occluded side). `own` marks edges of the apex's own face.
    - `stretch`: length on the plane per length of edge.
    - `barycentric` coordinates of `point` on the target's face.
    """

    along: Float[Array, " C"]
    point: Float[Array, "C 3"]
    edge_point: Float[Array, "C 3"]
    fraction: Float[Array, " C"]
    normal: Float[Array, "C 3"]
    pole: Float[Array, "C 3"]
    own: Bool[Array, " C"]
    stretch: Float[Array, " C"]
    barycentric: Float[Array, "C 3"]


def project_edges(
    packed: PackedScene, edge: Int[Array, " C"], ends: SegmentEnds, along: Float[Array, " C"] | None = None
) -> Projection:
    """Project edges: the foot of the perpendicular from the target, or the point `along` the 3D edge (0 to 1)."""
    packed, ends = stop_gradient((packed, ends))
    p0, p1 = corners(packed.vertices[packed.edges.vertices[edge]])
    apex, normal = ends.apex, ends.normal
    s0, s1, to_target = p0 - apex, p1 - apex, ends.target - apex
    height = _nonzero(dot(normal, to_target))
    if along is None:
        along = foot_on_edge(s0, s1, dot(normal, s0) / height, dot(normal, s1) / height, to_target)
    edge_point = between(p0, p1, along)
    to_edge = edge_point - apex
    depth = _nonzero(dot(normal, to_edge))
    point = apex + scale(to_edge, height / depth)
    pole, own = occluded_side(
        packed, edge, (p0, p1), apex, ends.apex_face, packed.vertices[packed.faces[ends.apex_face]]
    )
    tangent = normalize(s1 - s0)
    across = tangent - scale(to_edge, dot(normal, tangent) / depth)
    return Projection(
        along=along,
        point=point,
        edge_point=edge_point,
        fraction=depth / height,
        normal=normalize(pole - scale(normal, dot(pole, normal))),
        pole=pole,
        own=own,
        stretch=norm(across) * jnp.abs(height / depth),
        barycentric=affine_coordinates(ends.corners, point),
    )


def displacement(
    packed: PackedScene, edge: Int[Array, " C"], ends: SegmentEnds, projection: Projection
) -> Float[Array, " C"]:
    """normal . (projected edge point - material point there): its derivative is the normal velocity V (Eq. 6)."""
    on_plane, in_plane, pole = projection.point, projection.normal, projection.pole
    point = between(*corners(packed.vertices[packed.edges.vertices[edge]]), projection.along)
    moving_apex = ends.apex_towards(on_plane)
    offset = point - moving_apex
    reach = dot(ends.normal, ends.target - moving_apex) / _nonzero(dot(ends.normal, offset))
    projected = moving_apex + scale(offset, reach)
    # The material point under the projected edge: rigid with the target's face, extended beyond it where need be.
    rigid = interpolate(ends.corners, projection.barycentric)
    to_plane = on_plane - stop_gradient(ends.apex)
    sky = to_plane if ends.turn is None else transform(ends.turn, to_plane)
    material = jnp.where(ends.infinite[:, None], ends.apex + sky, rigid)
    # The apex stays in its face, so where that sets, the boundary moves as the plane does. Projected from an edge that
    # is close by, its motion would be the difference of two fast ones.
    apex_triangle = packed.vertices[packed.faces[ends.apex_face]]
    to_corner = corners(apex_triangle)[0] - on_plane
    horizon = dot(horizon_normal(apex_triangle, pole), to_corner) / _nonzero(dot(pole, in_plane))
    return jnp.where(projection.own, horizon, dot(in_plane, projected)) - dot(in_plane, material)


def occluded_side(
    packed: PackedScene,
    edge: Int[Array, " C"],
    ends: tuple[Float[Array, "C 3"], Float[Array, "C 3"]],
    apex: Float[Array, "C 3"],
    apex_face: Int[Array, " C"] | None = None,
    apex_triangle: Float[Array, "C 3 3"] | None = None,
) -> tuple[Float[Array, "C 3"], Bool[Array, " C"]]:
    """(unit normals of the planes through apexes and silhouettes, towards the faces there; own face or not).

    Own are edges of the apex's own face: silhouettes where that face sets. The plane is the face's there. All positions
    are detached: `ends` of the edges, and `apex_triangle`, the corners of the apexes' faces; None where they lie in no
    face.
    """
    (p0, p1), opposite = ends, packed.edges.opposite[edge]
    plane, counts, own = cross(p0 - apex, p1 - p0), opposite >= 0, jnp.zeros(edge.shape, bool)
    if apex_face is not None and apex_triangle is not None:
        of_apex = (packed.edges.faces[edge] == apex_face[:, None]) & (apex_face >= 0)[:, None]
        own = of_apex.any(-1)
        plane = jnp.where(own[:, None], triangle_normals(apex_triangle), plane)
        counts = counts & ~of_apex  # the apex's own face lies in the plane
    # The face furthest from the plane tells the side.
    height = dot(plane[:, None], stop_gradient(packed.vertices)[opposite] - p0[:, None])
    height = jnp.where(counts, height, 0.0)
    highest, lowest = height.max(-1), height.min(-1)
    furthest = jnp.where(highest >= -lowest, highest, lowest)
    return scale(normalize(plane), jnp.sign(furthest)), own


def horizon_normal(triangle: Float[Array, "C 3 3"], normal: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
    """Unit normals of triangles, turned to the side of `normal`; differentiable."""
    moving = normalize(triangle_normals(triangle))
    return scale(moving, jnp.sign(dot(stop_gradient(moving), normal)))


def past_edge(
    edge_point: Float[Array, "C 3"], apex: Float[Array, "C 3"], normal: Float[Array, "C 3"]
) -> Float[Array, "C 3"]:
    """Points just beside edges for visibility rays from `apex`; `normal` points to the occluded side."""
    beside = BESIDE * jnp.maximum(jnp.abs(edge_point).max(-1), jnp.abs(apex).max(-1))
    return edge_point - scale(normal, beside)


def _nonzero(x):
    """`x`, with 1 in place of 0 for slots that hold no pair."""
    return jnp.where(x == 0, 1.0, x)


@jax.jit
def affine_coordinates(triangles: Float[Array, "*#n 3 3"], point: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Barycentric coordinates of points in the planes of triangles."""
    a, b, c = corners(triangles)
    v, w = _along_sides(b - a, c - a, point - a)
    return from_components(1 - v - w, v, w)


@jax.jit
def affine_rates(triangles: Float[Array, "*#n 3 3"], along: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
    """Rates of change of `affine_coordinates` along vectors."""
    a, b, c = corners(triangles)
    v, w = _along_sides(b - a, c - a, along)
    return from_components(-v - w, v, w)


def _along_sides(one, two, offset):
    """Coordinates of vectors in the plane of two sides of a triangle."""
    normal = cross(one, two)
    squared = dot(normal, normal)
    return dot(cross(offset, two), normal) / squared, dot(cross(one, offset), normal) / squared


def foot_on_edge(s0, s1, f0, f1, target):
    """Fraction of the 3D edge that projects to the foot of the perpendicular from the target; all relative to the apex.

    `f0`, `f1` are the fractions of the way to the plane at which the ends lie; the edge is clipped to what is between.
    """
    c0, c1 = jnp.clip(f0, 1e-6, 1.0), jnp.clip(f1, 1e-6, 1.0)
    rise = _nonzero(f1 - f0)
    t0, t1 = jnp.where(c0 == f0, 0.0, (c0 - f0) / rise), jnp.where(c1 == f1, 1.0, (c1 - f0) / rise)
    start = scale(between(s0, s1, t0), 1.0 / c0)
    line = scale(between(s0, s1, t1), 1.0 / c1) - start
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
