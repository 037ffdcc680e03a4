"""Kernel-density estimation of boundary path integrals (Xu et al. 2026).

A path segment that passes close to a silhouette, seen from its camera-side end, stands for the boundary segments
there: its contribution is spread over a strip (or disc) of radius r around the projected silhouette. Biased by the
radius, consistent as the radius shrinks (Eq. 21-22).
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.geometry.vector import dot, norm, normalize
from jaxdr.scene.packed import PackedScene, concave_edges
from jaxdr.transport.interaction import SurfacePoint, leave, material_point
from jaxdr.transport.path import PathSettings, Segments
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer

# How far inside the visible side the visibility ray passes, as a share of the radius (DESIGN 2).
INSIDE = 0.005


class KernelDensity(eqx.Module):
    """Boundary term of every segment behind the first hit, by kernel density (Eq. 15-20).

    - `radius`: kernel radius relative to the bounding-box diagonal of the shape whose edge
      it is.
    - `widest`: the radius counts at the edge and is magnified by the projection to the far end, up to this share of the
      segment's length. 0 takes the radius at the far end, as the paper does; then edges close to the apex, whose projections
      move fast, are rarely met and noisy (ten times the variance on a self-shadowing mesh).
    - `kernel`: "edge" integrates the kernel along the projected edge exactly; "point" is the paper's: `points` points
      drawn uniformly on all edges, a disc around each projection (Eq. 16, 19).
    - `alpha`, `iterations`: the samples of a pixel are dealt to `iterations` radii that shrink by Eq. 21; their average
      is Eq. 22. One iteration keeps the radius.
    - `concave_edges`: also count edges that fold inwards on closed one-sided shapes. They never bound what is visible
      from outside.
    - `visibility_ray`: drop silhouettes that are hidden, by one ray past the edge to a point just inside the visible side.
    - `at_boundary`: evaluate BSDF and geometric term on the boundary instead of at the path's own vertex. The path sees
      one side of the boundary only, so its own vertex is off by r/2 on average: a bias of first order in r.
    - `clip_to_face`: where the target's face is larger than the kernel, the strip ends at the outline of the face and is
      normalised by the width that is left ("edge" kernel). Without it the strip is cut off by the outlines of emitters
      and receivers: a bias of first order in r.
    - `capacity`: room for (segment, edge) pairs, as a share of the number of segments. What exceeds it is thinned at
      random without bias, with a warning.

    With all switches turned over and `widest=0`, `kernel="point"` is the paper's plain version.
    """

    radius: float = eqx.field(static=True, default=0.02)
    widest: float = eqx.field(static=True, default=0.1)
    kernel: Literal["edge", "point"] = eqx.field(static=True, default="edge")
    alpha: float = eqx.field(static=True, default=0.3)
    iterations: int = eqx.field(static=True, default=4)
    concave_edges: bool = eqx.field(static=True, default=False)
    visibility_ray: bool = eqx.field(static=True, default=True)
    at_boundary: bool = eqx.field(static=True, default=True)
    clip_to_face: bool = eqx.field(static=True, default=True)
    points: int = eqx.field(static=True, default=1 << 16)
    capacity: float = eqx.field(static=True, default=0.125)

    def __check_init__(self):
        if not self.radius > 0:
            raise ValueError(f"KernelDensity: radius must be positive (share of the shape's size), got {self.radius}")
        if self.kernel not in ("edge", "point"):
            raise ValueError(f"KernelDensity: kernel must be 'edge' or 'point', got {self.kernel!r}")
        if not 0 < self.alpha < 1:
            raise ValueError(f"KernelDensity: alpha must lie between 0 and 1 (Eq. 21), got {self.alpha}")
        for name in ("iterations", "points"):
            if getattr(self, name) < 1:
                raise ValueError(f"KernelDensity: {name} must be at least 1, got {getattr(self, name)}")
        if not self.capacity > 0:
            raise ValueError(f"KernelDensity: capacity must be positive, got {self.capacity}")

    def radius_schedule(self) -> list[float]:
        """Radius of every iteration relative to the first: r_{t+1} = r_t sqrt((t + alpha) / (t + 1)) (Eq. 21)."""
        radii = [1.0]
        for t in range(self.iterations - 1):
            radii.append(radii[-1] * ((t + self.alpha) / (t + 1)) ** 0.5)
        return radii

    def estimate(
        self,
        packed: PackedScene,
        first: SurfacePoint,
        first_wi: Float[Array, "N 3"],
        segments: Segments,
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        settings: PathSettings,
    ) -> Float[Array, "N 3"]:
        """Boundary term of N paths: zero in value, right in derivative.

        `first` are the paths' first hits (differentiable), `first_wi` the directions from them to the camera,
        `sample_index` numbers the samples of a pixel.
        """
        bounces, paths = segments.apex_face.shape
        flat = jax.tree.map(lambda a: a.reshape(bounces * paths, *a.shape[2:]), segments)
        path = jnp.tile(jnp.arange(paths), bounces)
        bounce = jnp.repeat(jnp.arange(bounces), paths)
        ends = _Ends(packed, first, flat, path, bounce == 0)
        detached = jax.tree.map(stop_gradient, ends.endpoints(slice(None)))

        schedule = jnp.asarray(self.radius_schedule(), detached.target.dtype)
        lit = (flat.contribution != 0).any(-1)
        scale = jnp.where(lit, schedule[sample_index[path] % self.iterations], 0.0)
        reach = self._edge_radii(packed)
        capacity = min(max(4096, round(self.capacity * scale.shape[0])), 1 << 24)
        span = norm(detached.target - detached.apex)
        widest = self.widest * span if self.widest else jnp.zeros_like(span)
        arguments = (detached.apex, detached.target, detached.normal, scale, widest)
        key_points, key_seed = jax.random.split(key)
        seed = jax.random.randint(key_seed, (), 0, 1 << 30, jnp.int32)
        table = (packed.vertices, packed.edges.vertices, packed.edges.opposite)
        if self.kernel == "edge":
            pairs = queries.edge_candidates(*table, reach, *arguments, seed, capacity, settings.rays)
            edge, point_fraction, density = pairs.element, None, None
        else:
            edges, fractions, total = self._edge_points(packed, reach, key_points)
            ends0, ends1 = (stop_gradient(packed.vertices)[packed.edges.vertices[edges, k]] for k in (0, 1))
            points = ends0 + fractions[:, None] * (ends1 - ends0)
            pairs = queries.point_candidates(
                *table, points, edges, reach[edges], *arguments, seed, capacity, settings.rays
            )
            edge, point_fraction, density = edges[pairs.element], fractions[pairs.element], total / self.points

        valid = pairs.segment >= 0
        segment = jnp.where(valid, pairs.segment, 0)
        pair_ends = ends.endpoints(segment)
        crossing = _project_edge(packed, edge, pair_ends, point_fraction)
        r = reach[edge] * scale[segment]
        magnified = r / jnp.where(crossing.fraction == 0, 1.0, crossing.fraction)
        r = jnp.maximum(r, jnp.minimum(magnified, widest[segment]))
        r = jnp.where(valid, r, 1.0)
        weight = flat.contribution[segment] * pairs.weight
        if self.kernel == "edge":
            width = r
            if self.clip_to_face:
                width, on_face = _strip_in_face(crossing, r)
                valid = valid & on_face
            weight = weight / jnp.where(valid, width, 1.0)[:, None]
        else:
            weight = weight * (density * crossing.stretch / (0.5 * jnp.pi * r**2))[:, None]  # Eq. 16, 19
        if self.at_boundary:
            factor = _boundary_factor(packed, first_wi, flat, segment, path, bounce, pair_ends, crossing.point)
            weight = weight * factor
        if self.visibility_ray:
            valid = valid & self._is_visible(packed, pair_ends, crossing, r, flat, segment, ends, valid, settings)
        displacement = crossing.displacement - stop_gradient(crossing.displacement)
        value = stop_gradient(jnp.where(valid[:, None], weight, 0.0)) * displacement[:, None]
        return jnp.zeros((paths, 3), value.dtype).at[path[segment]].add(value)

    def _edge_radii(self, packed: PackedScene) -> Float[Array, " E"]:
        """Kernel radius of every edge (scene units); zero leaves the edge out."""
        radius = self.radius * packed.shape_sizes()[packed.edges.shape]
        if self.concave_edges:
            return radius
        culled = concave_edges(packed) & _opaque_from_outside(packed)[packed.edges.shape]
        return jnp.where(culled, 0.0, radius)

    def _edge_points(self, packed: PackedScene, reach, key):
        """(edge, fraction along it, total length): points uniform over the length of all edges that count."""
        ends = stop_gradient(packed.vertices)[packed.edges.vertices]
        length = jnp.where(reach > 0, norm(ends[:, 1] - ends[:, 0]), 0.0)
        cdf = jnp.cumsum(length)
        u = (jnp.arange(self.points) + uniform(key, (self.points,), cdf.dtype)) / self.points * cdf[-1]
        edge = jnp.clip(jnp.searchsorted(cdf, u, side="right"), 0, cdf.shape[0] - 1)
        before = jnp.where(edge > 0, cdf[edge - 1], 0.0)
        fraction = jnp.clip((u - before) / jnp.where(length[edge] > 0, length[edge], 1.0), 0.0, 1.0)
        return edge, fraction, cdf[-1]

    def _is_visible(self, packed, pair_ends, crossing, r, flat, segment, ends, valid, settings) -> Bool[Array, " C"]:
        """Whether the apex sees past the edge, along a ray just inside the visible side."""
        # The ray passes the edge itself at the chosen distance, wherever exactly it starts.
        fraction = crossing.fraction
        past = crossing.edge_point - (INSIDE * r * fraction)[:, None] * crossing.normal
        start = leave(ends.apex_point(segment), past - stop_gradient(pair_ends.apex))
        goal = start + (past - start) / jnp.where(fraction == 0, 1.0, fraction)[:, None]
        # Stop one radius before the target's plane: a curved receiver rises above its tangent plane. The path itself
        # shows that the target, less than a radius away, is seen.
        short = r / jnp.maximum(norm(goal - start), r)
        stop = jnp.where(flat.infinite[segment], 1.0, jnp.maximum(1.0 - short, 0.5 * (1.0 + fraction)))
        reach = jnp.where(valid, stop, 0.0)
        return ~queries.occluded(packed.vertices, packed.faces, start, goal - start, reach, settings.rays)


class _Endpoints(eqx.Module):
    """Both ends of segments and the plane at the far end; positions differentiable, `normal` detached.

    `target` follows the material point (or, at infinity, the apex), `corners` those of the target's face.
    """

    apex: Float[Array, "C 3"]
    target: Float[Array, "C 3"]
    normal: Float[Array, "C 3"]
    corners: Float[Array, "C 3 3"]
    moving_normal: Float[Array, "C 3"]
    infinite: Bool[Array, " C"]


class _Ends:
    """Looks up the ends of flattened segments."""

    def __init__(self, packed: PackedScene, first: SurfacePoint, flat: Segments, path, at_first):
        self.packed, self.first, self.flat, self.path, self.at_first = packed, first, flat, path, at_first
        self.far = packed.size()

    def apex_point(self, index) -> SurfacePoint:
        flat = self.flat
        face, barycentric = flat.apex_face[index], flat.apex_barycentric[index]
        point = material_point(self.packed, face, barycentric, jnp.ones(face.shape, bool))
        slides = self.at_first[index][:, None]
        return point._replace(position=jnp.where(slides, self.first.position[self.path[index]], point.position))

    def endpoints(self, index) -> _Endpoints:
        flat = self.flat
        apex = self.apex_point(index).position
        face, barycentric = flat.target_face[index], flat.target_barycentric[index]
        infinite = flat.infinite[index]
        beyond = infinite[:, None]
        corners = self.packed.vertices[self.packed.faces[face]]
        normal = normalize(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        direction = flat.direction[index]
        normal = jnp.where(beyond, direction, normal)
        # The environment is cut by a plane across the segment, as far away as the scene is large.
        target = jnp.where(beyond, apex + self.far * direction, (corners * barycentric[..., None]).sum(1))
        return _Endpoints(apex, target, stop_gradient(normal), corners, normal, infinite)


class _Crossing(eqx.Module):
    """A silhouette projected from the apex onto the target's plane.

    `point` on the projected edge (differentiable), unit `normal` in the plane towards the occluded side (detached),
    `edge_point` on the 3D edge (detached), `displacement` = normal . (projected edge point - material point there), `stretch` = projected length per length of
    edge, `fraction` of the way from apex to plane at which the edge lies. `barycentric` coordinates of the point on the
    target's face, their change per length towards the visible side (`inwards`), and the face's `inradius` (0 at infinity).
    """

    point: Float[Array, "C 3"]
    normal: Float[Array, "C 3"]
    displacement: Float[Array, " C"]
    edge_point: Float[Array, "C 3"]
    barycentric: Float[Array, "C 3"]
    inwards: Float[Array, "C 3"]
    inradius: Float[Array, " C"]
    stretch: Float[Array, " C"]
    fraction: Float[Array, " C"]


def _project_edge(packed: PackedScene, edge, ends: _Endpoints, point_fraction) -> _Crossing:
    """Project edges onto the planes of their segments: the foot nearest to the target, or a given point of the edge."""
    vertices = packed.vertices[packed.edges.vertices[edge]]
    p0, p1 = vertices[:, 0], vertices[:, 1]
    apex, target, normal = (stop_gradient(x) for x in (ends.apex, ends.target, ends.normal))
    s0, s1 = stop_gradient(p0) - apex, stop_gradient(p1) - apex
    height = dot(normal, target - apex)
    height = jnp.where(height == 0, 1.0, height)
    f0, f1 = dot(normal, s0) / height, dot(normal, s1) / height
    if point_fraction is None:
        fraction = _foot(s0, s1, f0, f1, target - apex)
    else:
        fraction = point_fraction
    fraction = fraction[:, None]
    point = (1 - fraction) * p0 + fraction * p1

    moving_height = dot(ends.moving_normal, ends.target - ends.apex)
    offset = point - ends.apex
    depth = dot(ends.moving_normal, offset)
    projected = ends.apex + offset * (moving_height / jnp.where(depth == 0, 1.0, depth))[:, None]

    plane = jnp.cross(s0, s1)
    first_opposite = stop_gradient(packed.vertices)[packed.edges.opposite[edge, 0]]
    side = jnp.sign(dot(plane, first_opposite - apex))
    in_plane = normalize(plane - dot(plane, normal)[:, None] * normal) * side[:, None]

    # The material point under the projected edge: rigid with the target's face, extended beyond it where need be.
    corners = stop_gradient(ends.corners)
    foot = stop_gradient(projected)
    e1, e2, q = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], foot - corners[:, 0]
    n2 = jnp.cross(e1, e2)
    squared = jnp.where(ends.infinite, 1.0, dot(n2, n2))
    v, w = dot(jnp.cross(q, e2), n2) / squared, dot(jnp.cross(e1, q), n2) / squared
    barycentric = jnp.stack([1 - v - w, v, w], -1)
    rigid = (ends.corners * barycentric[..., None]).sum(1)
    material = jnp.where(ends.infinite[:, None], ends.apex + (foot - apex), rigid)
    inwards = -in_plane
    dv, dw = dot(jnp.cross(inwards, e2), n2) / squared, dot(jnp.cross(e1, inwards), n2) / squared

    tangent = normalize(s1 - s0)
    q = stop_gradient(point) - apex
    qn = dot(normal, q)
    qn = jnp.where(qn == 0, 1.0, qn)[:, None]
    stretch = norm(height[:, None] * (tangent / qn - q * dot(normal, tangent)[:, None] / qn**2))
    return _Crossing(
        point=projected,
        normal=in_plane,
        displacement=dot(in_plane, projected - material),
        edge_point=stop_gradient(point),
        barycentric=barycentric,
        inwards=jnp.stack([-dv - dw, dv, dw], -1),
        inradius=jnp.where(ends.infinite, 0.0, _inradius(corners)),
        stretch=stretch,
        fraction=dot(normal, q) / height,
    )


def _inradius(corners):
    """Radius of the largest circle in each face."""
    a, b, c = (corners[:, k] for k in range(3))
    perimeter = norm(b - a) + norm(c - b) + norm(a - c)
    return norm(jnp.cross(b - a, c - a)) / perimeter


def _strip_in_face(crossing: _Crossing, r):
    """(width, whether it counts) of the kernel's strip at a boundary point, where the target's face is larger than it."""
    shrinking = crossing.inwards < 0
    room = jnp.where(shrinking, crossing.barycentric / jnp.where(shrinking, -crossing.inwards, 1.0), jnp.inf).min(-1)
    inside = (crossing.barycentric > 0).all(-1)
    small = crossing.inradius < r
    return jnp.where(small, r, jnp.minimum(r, room)), small | (inside & (room > 0))


def _foot(s0, s1, f0, f1, target):
    """Fraction of the 3D edge under the foot of the perpendicular from the target onto the projected edge."""
    c0, c1 = jnp.clip(f0, 1e-6, 1.0), jnp.clip(f1, 1e-6, 1.0)
    rise = jnp.where(f1 == f0, 1.0, f1 - f0)
    t0, t1 = jnp.where(c0 == f0, 0.0, (c0 - f0) / rise), jnp.where(c1 == f1, 1.0, (c1 - f0) / rise)
    q0, q1 = s0 + t0[:, None] * (s1 - s0), s0 + t1[:, None] * (s1 - s0)
    m0 = q0 / c0[:, None]
    along = q1 / c1[:, None] - m0
    squared = dot(along, along)
    s = jnp.clip(dot(target - m0, along) / jnp.where(squared == 0, 1.0, squared), 0.0, 1.0)
    tau = s * c0 / jnp.where(s * c0 + (1 - s) * c1 == 0, 1.0, s * c0 + (1 - s) * c1)
    return t0 + tau * (t1 - t0)


def _opaque_from_outside(packed: PackedScene) -> Bool[Array, " S"]:
    """Closed one-sided shapes that no other shape reaches into: everything that scatters light is outside of them.

    Decided by bounding boxes, the shape's own shrunk by one per cent so that touching is not reaching in.
    """
    points = stop_gradient(packed.vertices)[packed.faces]
    count = len(packed.closed)
    lower = jax.ops.segment_min(points.min(1), packed.face_shape, count)
    upper = jax.ops.segment_max(points.max(1), packed.face_shape, count)
    margin = 0.01 * (upper - lower)
    apart = (lower[None] > (upper - margin)[:, None]) | (upper[None] < (lower + margin)[:, None])
    alone = (apart.any(-1) | jnp.eye(count, dtype=bool)).all(1)
    return alone & jnp.asarray(packed.closed) & ~packed.two_sided


def _boundary_factor(packed, first_wi, flat, segment, path, bounce, ends: _Endpoints, crossing):
    """f_s G on the boundary over f_s G at the path's own vertex, RGB; detached.

    What arrives from the far end (emitted radiance, or radiance scattered there) is taken to be the same at both.
    """
    index = path[segment]
    paths = first_wi.shape[0]
    apex_face, barycentric = flat.apex_face[segment], flat.apex_barycentric[segment]
    point = material_point(packed, apex_face, barycentric, jnp.ones(apex_face.shape, bool))
    before = jnp.maximum(bounce[segment] - 1, 0) * paths + index
    previous = material_point(packed, flat.apex_face[before], flat.apex_barycentric[before], point.valid)
    wi = jnp.where((bounce[segment] == 0)[:, None], first_wi[index], normalize(previous.position - point.position))
    point = jax.tree.map(stop_gradient, point)
    scatterer = Scatterer(jax.tree.map(stop_gradient, packed), point, stop_gradient(wi))
    apex = stop_gradient(ends.apex)

    def value(goal):
        offset = goal - apex
        distance2 = jnp.maximum(dot(offset, offset), 1e-30)
        towards = offset / jnp.sqrt(distance2)[:, None]
        # At infinity the plane stands for directions: dω = |cos| dA / d^2 there as well.
        geometry = jnp.abs(dot(ends.normal, towards)) / distance2
        return scatterer.eval(towards) * geometry[:, None]

    own = value(stop_gradient(ends.target))
    return jnp.where(own > 0, value(stop_gradient(crossing)) / jnp.where(own > 0, own, 1.0), 0.0)
