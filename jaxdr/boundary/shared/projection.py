"""Edges as seen from the near end of a path segment: projected to its far end, and which of them are silhouettes."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.geometry import queries
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
from jaxdr.safe_divide import nonzero, safe_divide
from jaxdr.scene.packed import PackedScene, concave_edges


class Projection(eqx.Module):
    """Edges projected from the apex onto the plane at the target; detached.

    - `along`: the fraction of the 3D edge; `edge_point`: the point there.
    - `point`: its projection; `fraction`: distance of the edge point from the apex over that of its projection.
    - `pole`: unit normal of the plane through apex and edge. `normal`: unit normal of the projected edge within the
      target's plane. Both point to the side of the edge's faces (the occluded side).
    - `own`: marks edges of the apex's own face.
    - `stretch`: length on the plane per length of edge.
    - `barycentric`: coordinates of `point` on the target's face.
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
    """Project edges. The point on an edge is at the fraction `along` (0 to 1), or projects closest to the target."""
    packed, ends = stop_gradient((packed, ends))
    p0, p1 = corners(packed.ends_of(edge))
    apex, normal = ends.apex, ends.normal
    s0, s1, to_target = p0 - apex, p1 - apex, ends.target - apex
    height = nonzero(dot(normal, to_target))
    if along is None:
        along = foot_on_edge(s0, s1, dot(normal, s0) / height, dot(normal, s1) / height, to_target)
    edge_point = between(p0, p1, along)
    to_edge = edge_point - apex
    depth = nonzero(dot(normal, to_edge))
    point = apex + scale(to_edge, height / depth)
    pole, own = occluded_side(packed, edge, (p0, p1), apex, ends.apex_face, packed.corners_of(ends.apex_face))
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
    point = between(*corners(packed.ends_of(edge)), projection.along)
    moving_apex = ends.apex_towards(on_plane)
    offset = point - moving_apex
    reach = safe_divide(dot(ends.normal, ends.target - moving_apex), dot(ends.normal, offset))
    projected = moving_apex + scale(offset, reach)
    # The material point under the projected edge moves rigidly with the target's face, also outside the face.
    rigid = interpolate(ends.corners, projection.barycentric)
    to_plane = on_plane - stop_gradient(ends.apex)
    sky = to_plane if ends.turn is None else transform(ends.turn, to_plane)
    material = jnp.where(ends.infinite[:, None], ends.apex + sky, rigid)
    # The edges of the apex's own face are its horizon. The apex stays in its face, so this boundary moves with the
    # plane. A projection from the near edge would give the same motion as the difference of two fast ones.
    apex_triangle = packed.corners_of(ends.apex_face)
    to_corner = corners(apex_triangle)[0] - on_plane
    horizon = safe_divide(dot(horizon_normal(apex_triangle, pole), to_corner), dot(pole, in_plane))
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

    Edges of the apex's own face are its horizon: there the plane is that of the face. All positions are detached.
    `ends` are those of the edges, `apex_triangle` the corners of the apexes' faces; None if apexes lie in no face.
    """
    (p0, p1), opposite = ends, packed.edges.opposite[edge]
    plane, counts, own = cross(p0 - apex, p1 - p0), opposite >= 0, jnp.zeros(edge.shape, bool)
    if apex_face is not None and apex_triangle is not None:
        of_apex = (packed.edges.faces[edge] == apex_face[:, None]) & (apex_face >= 0)[:, None]
        own = of_apex.any(-1)
        plane = jnp.where(own[:, None], triangle_normals(apex_triangle), plane)
        counts = counts & ~of_apex  # the apex's own face lies in the plane
    # The side is that of the face furthest from the plane.
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
    beside = queries.BESIDE * jnp.maximum(jnp.abs(edge_point).max(-1), jnp.abs(apex).max(-1))
    return edge_point - scale(normal, beside)


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

    `f0` and `f1` are the heights of the edge's ends over the apex, relative to the plane's. The edge is clipped to the
    part between apex and plane.
    """
    c0, c1 = jnp.clip(f0, 1e-6, 1.0), jnp.clip(f1, 1e-6, 1.0)
    rise = nonzero(f1 - f0)
    t0, t1 = jnp.where(c0 == f0, 0.0, (c0 - f0) / rise), jnp.where(c1 == f1, 1.0, (c1 - f0) / rise)
    start = scale(between(s0, s1, t0), 1.0 / c0)
    line = scale(between(s0, s1, t1), 1.0 / c1) - start
    s = jnp.clip(safe_divide(dot(target - start, line), dot(line, line)), 0.0, 1.0)
    # Equal steps on the plane are not equal steps on the edge (perspective).
    tau = safe_divide(s * c0, s * c0 + (1 - s) * c1)
    return t0 + tau * (t1 - t0)


def never_silhouettes(packed: PackedScene) -> Bool[Array, " E"]:
    """Which edges never bound what is visible: concave edges of shapes that can only be seen from outside."""
    return concave_edges(packed) & _seen_from_outside(packed)[packed.edges.shape]


def _seen_from_outside(packed: PackedScene) -> Bool[Array, " S"]:
    """Closed one-sided shapes that no other shape reaches into, and that scatter no light to their inside.

    So everything that scatters light is outside of them. Bounding boxes decide. The shape's own box is shrunk by one
    per cent, so that a shape may touch it.
    """
    lower, upper = packed.shape_bounds()
    count = len(packed.closed)
    margin = 0.01 * (upper - lower)
    apart = (lower[None] > (upper - margin)[:, None]) | (upper[None] < (lower + margin)[:, None])
    alone = (apart.any(-1) | jnp.eye(count, dtype=bool)).all(1)
    alone = alone & jnp.asarray(packed.closed) & ~packed.two_sided
    through = packed.spreads_through
    return alone if through is None else alone & ~through
