"""Kernel-density estimation of boundary path integrals (Xu et al. 2026).

A path segment that passes close to a silhouette, seen from its camera-side end, stands for the boundary segments
there: its contribution is spread over a strip (or disc) of radius r around the projected silhouette.
"""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.kernel_density.lobe_kernel import lobe_edges
from jaxdr.boundary.kernel_density.moving_edges import MovingEdges, apart_candidates, moving_edges
from jaxdr.boundary.kernel_density.plain_kernel import near_points, share_of_disc, shrinking_radii
from jaxdr.boundary.kernel_density.strips import sees_past_edge, strip_in_face
from jaxdr.boundary.shared.background import BehindEdges, sum_behind
from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.emitter_planes import emitter_face_at, emitter_groups
from jaxdr.boundary.shared.on_planes import OnPlanes, sum_on_planes
from jaxdr.boundary.shared.path_segments import PathSegments, SegmentEnds, path_segments
from jaxdr.boundary.shared.projection import (
    Projection,
    displacement,
    never_silhouettes,
    project_edges,
)
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits, too_fine
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.geometry.vector import dot, norm, normalize, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.emitter_clusters import FEW_FACES
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.moved_paths import layers, moved_contributions, rows_of, target_segments
from jaxdr.transport.radiance import Answers, Requests
from jaxdr.transport.sampler import seed_of


class KernelDensityState(NamedTuple):
    """State for all chunks of an image: the kernel radius of every edge, and the tree over the edges.

    `group` numbers the emitters' planes; None if no emitter has a texture. `moving`: the edges that move, for segments
    that stand still; None if all segments use all edges.
    """

    radius: Float[Array, " E"]
    tree: EdgeTree
    group: Int[Array, " F"] | None = None
    moving: MovingEdges | None = None


class BoundaryPoints(NamedTuple):
    """Points of boundaries near the targets of segments; only `valid` ones count.

    `goal` is where the contribution is evaluated. `share` is the kernel's density there: per area of the plane at the
    target, times length of boundary. `ends` and `projection` are differentiable as their classes say; `apex` is
    detached. `used` slots are filled.
    """

    segment: Int[Array, " C"]
    edge: Int[Array, " C"]
    apex: SurfacePoint
    ends: SegmentEnds
    projection: Projection
    goal: Float[Array, "C 3"]
    share: Float[Array, " C"]
    valid: Bool[Array, " C"]
    used: Int[Array, ""]


class _Near(NamedTuple):
    """A search for boundary points near the targets of segments.

    - `shrunk`: radius of every segment's iteration, relative to the first; zero leaves a segment out.
    - `sky`: an environment of varying radiance counts.
    - `there`: the widest radius is relative to the distance from apex to boundary point, else to the target.
    """

    paths: PathSegments
    prepared: KernelDensityState
    shrunk: Float[Array, " S"]
    both_sides: bool
    sky: bool
    rays: str
    there: bool = False


class _Held(NamedTuple):
    """Boundary points near direct and scattered segments, with the number of filled slots, and traced backgrounds."""

    direct: tuple[OnPlanes, Int[Array, ""]] | None
    scattered: tuple[OnPlanes, Int[Array, ""]] | None
    behind: BehindEdges | None


@checked
class KernelDensity(eqx.Module):
    """Boundary term by kernel density (Xu et al. 2026, Eq. 15-20). All fields are static.

    Path segments that pass close to a silhouette are samples of the boundary integral.

    - `radius`: kernel radius, relative to the bounding-box diagonal of the shape that has the edge.
    - `kernel`: "edge" integrates the kernel along the projected edge exactly. "point" is the paper's: `points` points
      drawn uniformly on all edges, with a disc around each projection (Eq. 16, 19).
    - `alpha`: with `iterations` T > 1 the samples of a pixel are dealt to T radii that shrink by Eq. 21. Their average
      is Eq. 22.
    - `capacity`: room for (segment, edge) pairs, as a share of the number of segments. If there are more pairs, a
      random part is left out without bias, with a warning.

    Each difference from the paper has a switch. Values in brackets are the paper's; all of them together are
    `jaxdr.boundary.kernel_density.plain_kernel.PLAIN`.

    - `widest` (0): the radius is measured at the edge, and magnified by the projection to the far end, up to this share
      of the segment's length. The paper measures it at the far end. Then segments rarely meet edges near the apex,
      whose projections move fast, and meshes that shadow themselves have far more variance.
    - `concave_edges` (True): count concave edges of closed one-sided shapes, which never bound what is visible.
    - `visibility_ray` (False): drop silhouettes that are hidden, by one ray that passes just beside the edge.
    - `at_boundary` (False): evaluate BSDF, geometric term and radiance on the boundary, not at the path's own vertex.
      That vertex lies r/2 to one side on average, which is a bias of first order in r.
    - `both_sides` (False): occluded emitter samples count as well, so direct light has a kernel on both sides. Then
      corners of the boundary cause no bias, and the variance is smaller.
    - `clip_to_face` (False): the strip ends at the outline of an emitter of few faces, and of any face larger than the
      kernel. The kernel is normalised over the width that remains.
    - `trace_background` (False): a ray past the edge finds what lies behind silhouettes near BSDF-sampled directions,
      and a path from there finds its radiance. Then the kernel is over directions, of radius `radius` at the edge and
      at most 45 degrees.
    - `iterations` (4): with `kernel="edge"` and all options above, only light from emitters of many small faces is
      biased. So radii need not shrink.

    Direct light comes from emitter sampling alone, without MIS. With a `BidirectionalPathTracer` every strategy counts
    with its weight. Then kernels lie on the visible side, and `both_sides` and `trace_background` have no effect:
    corners below 180 degrees, and curved targets, cause a bias of first order in r.

    Raises ValueError for options out of range.
    """

    radius: float = eqx.field(static=True, default=0.02)
    kernel: Literal["edge", "point"] = eqx.field(static=True, default="edge")
    alpha: float = eqx.field(static=True, default=0.3)
    iterations: int = eqx.field(static=True, default=1)
    widest: float = eqx.field(static=True, default=0.1)
    concave_edges: bool = eqx.field(static=True, default=False)
    visibility_ray: bool = eqx.field(static=True, default=True)
    at_boundary: bool = eqx.field(static=True, default=True)
    both_sides: bool = eqx.field(static=True, default=True)
    clip_to_face: bool = eqx.field(static=True, default=True)
    trace_background: bool = eqx.field(static=True, default=True)
    points: int = eqx.field(static=True, default=1 << 16)
    capacity: float = eqx.field(static=True, default=0.25)

    name = "boundary"

    def __check_init__(self):
        if not self.radius > 0:
            raise ValueError(f"KernelDensity: radius must be positive (share of the shape's size), got {self.radius}")
        if self.kernel not in ("edge", "point"):
            raise ValueError(f"KernelDensity: kernel must be 'edge' or 'point', got {self.kernel!r}")
        if not 0 < self.alpha < 1:
            raise ValueError(f"KernelDensity: alpha must lie between 0 and 1 (Eq. 21), got {self.alpha}")
        if not self.widest >= 0:
            raise ValueError(f"KernelDensity: widest must not be negative, got {self.widest}")
        for name in ("iterations", "points"):
            if getattr(self, name) < 1:
                raise ValueError(f"KernelDensity: {name} must be at least 1, got {getattr(self, name)}")
        if not self.capacity > 0:
            raise ValueError(f"KernelDensity: capacity must be positive, got {self.capacity}")

    def radius_schedule(self) -> list[float]:
        """Radius of every iteration relative to the first (Eq. 21)."""
        return shrinking_radii(self.alpha, self.iterations)

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`."""
        if found.fine is not None or not found.mesh_lamps:
            return too_fine(found)
        return (
            f"it is too small under area emitters of more than {FEW_FACES} faces if the faces are smaller than its "
            "kernel (by 5 % under a tiny lamp); take LineSampling"
        )

    def prepare(self, context: Context, key: PRNGKeyArray) -> KernelDensityState:
        """Kernel radii (scene units; zero leaves an edge out) and the tree over the edges."""
        del key
        packed, moving, settings = context.packed, context.moving.seen, context.settings
        radius = self.radius * packed.shape_sizes()[packed.edges.shape]
        if not self.concave_edges:
            radius = jnp.where(never_silhouettes(packed), 0.0, radius)
        edges = queries.EdgeSet.of(packed.edges, radius)
        tree = queries.edge_tree(packed.geometry, edges, packed.edge_counts, settings.rays)
        group = emitter_groups(packed) if packed.glow else None
        # A segment that moves may need any edge. A segment with both ends at rest needs only edges that move.
        apart = self.kernel == "edge" and any(moving) and not all(moving)
        return KernelDensityState(
            radius, tree, group, moving_edges(packed, moving, radius, settings) if apart else None
        )

    def draw(
        self, context: Context, state: KernelDensityState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, "_Held"]:
        """Boundary points near segments, and requests for the radiance behind those near BSDF-sampled directions."""
        packed, settings, record, shrunk = context.packed, context.settings, chunk.record, self._scale(chunk)
        key_direct, key_scattered = jax.random.split(key)
        asked = direct = scattered = behind = None
        if record.direct is not None:
            paths = path_segments(packed, chunk, "direct", differentiated=False)
            direct = self._near(packed, state, paths, shrunk, self.both_sides, key_direct, settings)
        if record.scattered is not None:
            paths = path_segments(packed, chunk, "scattered", differentiated=False)
            if self.trace_background:
                edges = queries.EdgeSet.of(packed.edges, state.radius, state.tree)
                asked, behind = lobe_edges(
                    packed, edges, paths, shrunk, self._capacity(paths.count), key_scattered, settings
                )
            else:
                scattered = self._near(packed, state, paths, shrunk, False, key_scattered, settings)
        return asked, _Held(direct, scattered, behind)

    def image(
        self, context: Context, state: KernelDensityState, chunk: Chunk, held: "_Held", answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """Boundary term: zero in value, right in derivative."""
        packed, total = context.packed, jnp.zeros_like(chunk.record.radiance)
        if held.direct is not None:
            total += sum_on_planes(packed, path_segments(packed, chunk, "direct"), *held.direct)
        if held.scattered is not None:
            total += sum_on_planes(packed, path_segments(packed, chunk, "scattered"), *held.scattered)
        if held.behind is not None and answers is not None:
            total += sum_behind(packed, path_segments(packed, chunk, "scattered"), held.behind, answers.total)
        return chunk.image(packed, total)

    def _scale(self, chunk: Chunk) -> Float[Array, " N"]:
        """Radius of each path's iteration, relative to the first."""
        schedule = jnp.asarray(self.radius_schedule(), chunk.weight.dtype)
        return jnp.tile(schedule[chunk.samples % self.iterations], chunk.paths // chunk.samples.shape[0])

    def _near(self, packed, prepared, paths: PathSegments, shrunk, both_sides, key, settings):
        """(boundary points near one kind of segments, how many slots are filled); detached."""
        lit = (paths.table.weight != 0).any(-1)
        # An environment map or a textured emitter may be black at the target and bright at the boundary.
        sky = paths.table.unlit is not None and packed.has_varying_sky
        glow = prepared.group if paths.table.unlit is not None and self.at_boundary else None
        if paths.table.unlit is not None:
            may_glow = (paths.table.unlit != 0).any(-1)
            if sky:
                lit = jnp.where(paths.table.infinite, may_glow, lit)
            if glow is not None:
                lit = jnp.where(paths.table.infinite, lit, may_glow)
        lit = lit & (both_sides | paths.table.visible)
        shrunk = jnp.where(lit, jnp.tile(shrunk, paths.count // paths.paths), 0.0)
        found = self._boundary_points(_Near(paths, prepared, shrunk, both_sides, sky, settings.rays), key)
        segment, ends, projection, goal = found.segment, found.ends, found.projection, found.goal
        radiance = None if glow is None else _radiance_at(packed, glow, ends, projection)
        transfer = paths.transfer(segment, ends, goal, paths.scatterer(segment, found.apex))
        weight = paths.weight(segment, goal, radiance) * transfer
        weight = jnp.where(found.valid[:, None], scale(weight, found.share), 0.0)
        table = paths.table
        target = table.target_face[segment], table.target_barycentric[segment]
        far = table.infinite[segment], table.direction[segment]
        return OnPlanes(segment, found.edge, projection, *target, *far, weight), found.used

    def _boundary_points(self, near: "_Near", key) -> BoundaryPoints:
        """Boundary points within the kernel's radius of the segments' targets."""
        paths, prepared, shrunk, both_sides, sky, rays, there = near
        packed = paths.packed
        ends = paths.fixed.ends(jnp.arange(paths.count))
        span = norm(ends.target - ends.apex)
        widest = self.widest * span
        if there:  # the boundary point is farther from the apex by at most a radius
            widest = widest / max(1.0 - self.widest, 0.5)
        pairs, edge, along, density = self._pairs(near, ends, widest, key)

        valid = pairs.segment >= 0
        used, segment = valid.sum(), jnp.where(valid, pairs.segment, 0)
        ends = paths.ends(segment)
        apex, projection = paths.fixed.apex(segment), project_edges(packed, edge, ends, along)
        r = prepared.radius[edge] * shrunk[segment]
        magnified = safe_divide(r, projection.fraction, projection.fraction > 0)
        limit = self.widest * norm(projection.point - stop_gradient(ends.apex)) if there else widest[segment]
        r = jnp.maximum(r, jnp.minimum(magnified, limit))
        r = jnp.where(valid, r, 1.0)
        if there:
            valid = valid & (norm(projection.point - stop_gradient(ends.target)) < r)

        goal = projection.point if self.at_boundary else stop_gradient(ends.target)
        if sky and self.at_boundary:
            # No wider than details of the map. This bounds the radiance at the boundary over the density at the sample.
            extent = packed.environment_sampler.extent(paths.direction(segment, goal)) * paths.distance_to_infinity
            r = jnp.where(ends.infinite, jnp.minimum(r, extent), r)
            valid = valid & (~ends.infinite | (norm(goal - stop_gradient(ends.target)) < r))
        whole_face = jnp.zeros_like(valid)
        if self.kernel == "edge":
            width = 2 * r if both_sides else r
            if self.clip_to_face:
                width, whole_face, on_face = strip_in_face(packed, ends, projection, r, both_sides)
                valid = valid & on_face
            share = safe_divide(1.0, width, valid)
        else:
            assert density is not None  # `_pairs` returns it if the kernel is "point"
            share = share_of_disc(density, projection.stretch, r, both_sides)
        if self.visibility_ray:
            valid = valid & sees_past_edge(packed, apex, projection, r, whole_face, valid, rays)
        share = packed.edges.shared(edge, share * pairs.weight)
        return BoundaryPoints(segment, edge, apex, ends, projection, goal, share, valid, used)

    def estimate_connected(
        self, context: Context, state: KernelDensityState, chunk: Chunk, weight: Float[Array, "C N"], key: PRNGKeyArray
    ) -> Float[Array, "C N 3"]:
        """Boundary terms of N paths for C strategies: zero in value, right in derivative.

        `weight` is that of the strategies, zero where a path carries nothing. A path with a vertex close to a boundary
        stands for the path with this vertex on the boundary and the same other vertices. Kernels lie on the visible
        side.
        """
        packed = context.packed
        fixed, drawn, weight = jax.tree.map(stop_gradient, (packed, chunk.record.drawn, weight))
        paths, used = PathSegments(packed, chunk.primary, target_segments(drawn)), layers(drawn).used()
        lit = (used[:, :, None] & (weight > 0)).any(1)
        shrunk = jnp.where(lit, self._scale(chunk), 0.0).reshape(-1)
        near = _Near(paths, state, shrunk, False, packed.has_varying_sky, context.settings.rays, there=True)
        found = self._boundary_points(near, key)
        slots, count = rows_where(found.valid), found.valid.sum()
        moved = displacement(packed, found.edge, found.ends, found.projection)
        moved = moved - stop_gradient(moved)
        counts = jnp.asarray(used, weight.dtype)

        def values(slot, number):
            ends, goal = jax.tree.map(lambda a: a[slot], (found.ends, found.goal))
            segment = found.segment[slot]
            path, layer = paths.path(segment), segment // paths.paths
            filled = number < count
            offset = jnp.where(filled[:, None], stop_gradient(goal - ends.target), 0.0)
            shift = jnp.zeros((used.shape[0], *offset.shape), offset.dtype)
            shift = shift.at[layer, jnp.arange(slot.shape[0])].set(offset)
            value = moved_contributions(fixed, rows_of(drawn, path), shift)
            # `share` is per area of the plane at the target. The environment is sampled per solid angle: cosine^3.
            cosine = dot(stop_gradient(ends.normal), normalize(stop_gradient(goal - ends.apex)))
            share = found.share[slot] * jnp.where(ends.infinite, cosine**3, 1.0)
            value = jnp.where(filled[:, None], value * (counts[layer].T * weight[:, path] * share)[..., None], 0.0)
            value = scale(stop_gradient(value), moved[slot])
            return jnp.zeros((*weight.shape, 3), value.dtype).at[:, path].add(value)

        return sum_over_blocks(values, slots, count)

    def _capacity(self, segments: int) -> int:
        return min(max(4096, round(self.capacity * segments)), 1 << 24)

    def _pairs(self, near: "_Near", ends: SegmentEnds, widest, key):
        """(candidates, edge, fraction along the edge or None, length of edges per point or None).

        Segments that stand still are only compared with moving edges.
        """
        packed, prepared, shrunk = near.paths.packed, near.prepared, near.shrunk
        key_points, key_seed = jax.random.split(key)
        seed = seed_of(key_seed)
        every = queries.EdgeSet.of(packed.edges, prepared.radius, prepared.tree)
        strips = queries.StripQuery(ends.apex, ends.target, ends.normal, shrunk, widest)
        options: dict[str, Any] = dict(
            capacity=self._capacity(shrunk.shape[0]), both_sides=near.both_sides, implementation=near.rays
        )
        if self.kernel == "edge":
            if prepared.moving is None:
                pairs = queries.edge_candidates(packed.geometry, every, strips, seed, **options)
            else:
                still = near.paths.stand_still(prepared.moving.shapes)
                pairs = apart_candidates(packed.geometry, every, prepared.moving, strips, still, key_seed, options)
            return pairs, pairs.element, None, None
        return near_points(packed, every, self.points, strips, key_points, seed, options)


def _radiance_at(packed: PackedScene, group, ends: SegmentEnds, projection: Projection) -> Float[Array, "C 3"]:
    """Radiance of the emitters at boundary points; for points outside all faces found, that of the nearest border."""
    detached = jax.tree.map(stop_gradient, packed)
    face, barycentric, _ = emitter_face_at(detached, group, ends.face, projection.point)
    barycentric = jnp.maximum(barycentric, 0.0)
    barycentric = barycentric / barycentric.sum(-1, keepdims=True)
    return detached.surface_radiance(face, barycentric)
