"""div (f v) over what is seen, with the continuous velocity v of warped areas (Xu et al. 2023), for all its users."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.face_neighbours import Faces
from jaxdr.boundary.shared.path_segments import PathSegments, SegmentEnds
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.warped_area.continuous_velocity import Convolution, draw_auxiliary, velocity_field
from jaxdr.boundary.warped_area.occluders import find_occluders
from jaxdr.boundary.warped_area.outlines import keep_inside
from jaxdr.geometry.vector import (
    corners,
    dot,
    interpolate,
    norm,
    normalize,
    orthonormal_basis,
    scale,
    triangle_normals,
)
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.whole_numbers import whole

# f / pdf of the paths through N segments (RGB), as a function of where the targets are.
Measure = Callable[[Float[Array, "N 3"]], Float[Array, "N 3"]]


class Hidden(NamedTuple):
    """Auxiliary points, as material points of their surface, and the material points that hide them; detached.

    `own`: the plane of the apex's own face hides the point, and `occluder` is that face; None if that cannot happen.
    """

    position: Float[Array, "*n 3"]
    face: Int[Array, "*n"]
    barycentric: Float[Array, "*n 3"]
    occluder: Int[Array, "*n"]
    on_occluder: Float[Array, "*n 3"]
    own: Bool[Array, "*n"] | None = None


def check_options(estimator, counts: tuple[str, ...]) -> None:
    """Raises ValueError if options of the kernel, or the options `counts` (numbers of points), are out of range."""
    name = type(estimator).__name__
    if estimator.distance not in ("path_space", "exponential"):
        raise ValueError(f"{name}: distance must be 'path_space' or 'exponential', got {estimator.distance!r}")
    for option in ("sigma0", "power", "boundary_power", "spread"):
        if not getattr(estimator, option) > 0:
            raise ValueError(f"{name}: {option} must be positive, got {getattr(estimator, option)}")
    for option in counts:
        value = getattr(estimator, option)
        if not whole(value):
            raise ValueError(f"{name}: {option} must be a whole number of at least 1, got {value}")


def reaches_no_boundary(estimator) -> str | None:
    """The failure of the distance function of Eq. 57; None with the other one."""
    if estimator.distance != "exponential":
        return None
    return (
        'with distance="exponential" (Eq. 57) half of a derivative or more is missing, because its velocity does '
        'not reach that of the boundary; take distance="path_space", or LineSampling'
    )


class WarpedTerm(eqx.Module):
    """Terms that request no radiance: they differentiate the contributions that the paths found.

    `state` is what `prepare` returned.
    """

    name = "boundary"

    def draw(self, context: Context, state: Any, chunk: Chunk, key: PRNGKeyArray):
        """No requests; the key is kept for `image`."""
        return None, key

    def image(self, context: Context, state: Any, chunk: Chunk, held: PRNGKeyArray, answers) -> Float[Array, "H W 3"]:
        """Boundary term: zero in value, right in derivative."""
        return chunk.image(context.packed, self.of_paths(context, state, chunk, held))

    @abc.abstractmethod
    def of_paths(self, context: Context, state: Any, chunk: Chunk, key: PRNGKeyArray) -> Float[Array, "N 3"]:
        """The term, one value a path."""


class Warped(NamedTuple):
    """One kind of segments (`paths`), and the inputs of their velocities; `fixed` is `packed`, detached."""

    packed: PackedScene
    fixed: PackedScene
    faces: Faces
    paths: PathSegments
    around: Convolution

    def velocities(self, index, ends: SegmentEnds, lit, key) -> "Velocities":
        """Velocities around the targets of the segments `index`, with their shares and rates."""
        return hidden_velocities(self.fixed, self.faces, self.paths.fixed.apex(index), ends, lit, self.around, key)


class Velocities(NamedTuple):
    """Hidden auxiliary points: `slots` of the [N, Q, C] points, of which the first `used` are filled; detached.

    v(p) = along x sum of share x velocity, and div v = sum of rate . velocity. Points that are not hidden have no
    velocity. `along` is None if all targets are infinitely far away.
    """

    slots: Int[Array, " S"]
    used: Int[Array, ""]
    share: Float[Array, " S"]
    rate: Float[Array, "S 3"]
    along: Float[Array, "N 3 3"] | None
    table: Hidden

    def inside(self, slot: Int[Array, " M"], motion: Float[Array, "M 3"]) -> Float[Array, "M 3"]:
        """`along` x `motion`, the displacements of occluders in slots."""
        return motion if self.along is None else jnp.einsum("njk,nk->nj", self.along[self.row(slot)], motion)

    def row(self, slot: Int[Array, " M"]) -> Int[Array, " M"]:
        """The number of each slot's target."""
        return slot // (self.table.face.shape[1] * self.table.face.shape[2])

    def seen(self, slot: Int[Array, " M"]) -> Hidden:
        """The points in slots."""
        return jax.tree.map(lambda t: t.reshape(-1, *t.shape[3:])[slot], self.table)


def hidden_velocities(
    packed: PackedScene,
    faces: Faces,
    apex: SurfacePoint,
    ends: SegmentEnds,
    lit: Bool[Array, " N"],
    around: Convolution,
    key,
) -> Velocities:
    """Auxiliary points around the targets of N segments, with their shares and rates; all arguments detached."""
    points = draw_auxiliary(packed, faces.normal, ends, lit, around, key)
    occluders = find_occluders(packed, faces, apex, ends, points, around.rays, around.normal_edges)
    field = velocity_field(around.kernel, ends, points, occluders.boundary, around.debias, around.infinite)
    points, occluders, field = stop_gradient((points, occluders, field))

    rate, along = field.divergence, None
    if around.finite:
        width = around.kernel.sigma * norm(ends.target - ends.apex)
        along, spread = stop_gradient(keep_inside(packed, faces, ends, width))
        rate = jnp.einsum("njk,nqcj->nqck", along, rate) + field.share[..., None] * spread[:, None, None]

    hidden, own = occluders.hidden, occluders.own
    if own is not None and not around.horizon:
        hidden, own = hidden & ~own, None
    # Unused slots repeat the first point, so its numbers must be finite.
    hidden = (hidden & points.there & lit[:, None, None]).reshape(-1)
    shares = jnp.where(hidden, field.share.reshape(-1), 0.0)
    rates = jnp.where(hidden[:, None], rate.reshape(-1, 3), 0.0)
    slots = rows_where(hidden)
    table = Hidden(points.position, points.face, points.barycentric, occluders.face, occluders.barycentric, own)
    return Velocities(slots, hidden.sum(), shares, rates, along, table)


def divergence_term(
    f: Measure,
    value: Float[Array, "N 3"],
    ends: SegmentEnds,
    lit: Bool[Array, " N"],
    velocities: Velocities,
    moved: Callable[[Int[Array, " M"]], Float[Array, "M 3"]],
) -> Float[Array, "N 3"]:
    """f div v + grad f . v at the targets of N segments: zero in value, right in derivative.

    `value` is f at the targets. `moved` gives the displacements of the occluders in slots: zero, with the derivative v.
    """
    value = jnp.where(lit[:, None], value, 0.0)
    slopes = []
    for tangent in orthonormal_basis(ends.normal):
        slope = jax.jvp(f, (ends.target,), (tangent,))[1]
        if velocities.along is not None:
            tangent = jnp.einsum("nj,njk->nk", tangent, velocities.along)
        slopes.append((tangent, jnp.where(lit[:, None], slope, 0.0)))
    value, slopes = stop_gradient((value, slopes))

    def terms(slot, number):
        row, motion = velocities.row(slot), moved(slot)
        result = scale(value[row], dot(velocities.rate[slot], motion))
        for tangent, slope in slopes:
            result += scale(slope[row], velocities.share[slot] * dot(tangent[row], motion))
        result = jnp.where((number < velocities.used)[:, None], result, 0.0)
        return jnp.zeros_like(value).at[row].add(result)

    return sum_over_blocks(terms, velocities.slots, velocities.used)


def displacement(
    packed: PackedScene, apex: Float[Array, "C 3"], infinite: Bool[Array, " C"], seen: Hidden, turns: bool = True
) -> Float[Array, "C 3"]:
    """Projections of occluders minus the material points there: zero in value, with the derivative v^dis (Eq. 7-8).

    With `turns`, directions to the environment turn with it.
    """
    triangle = packed.corners_of(seen.face)
    material, normal = interpolate(triangle, seen.barycentric), triangle_normals(triangle)
    before = packed.corners_of(seen.occluder)
    towards = interpolate(before, seen.on_occluder) - apex
    slope = dot(normal, towards)
    reach = safe_divide(dot(normal, material - apex), slope)
    offset, far = seen.position - stop_gradient(apex), infinite[:, None]
    projected = jnp.where(far, scale(normalize(towards), norm(offset)), apex + scale(towards, reach))
    material = jnp.where(far, packed.turned(offset) if turns else offset, material)
    moved = projected - material
    if seen.own is not None:
        moved = jnp.where(seen.own[:, None], _horizon(before, stop_gradient(normal), material, offset, far), moved)
    return moved - stop_gradient(moved)


def _horizon(triangle, normal, material, offset, far):
    """Displacement of the apex's face plane over the material points, across its trace in their plane (or sphere).

    The apex stays in the plane of its face, so its own motion does not count.
    """
    plane = normalize(triangle_normals(triangle))
    across = stop_gradient(plane)
    normal = normalize(jnp.where(far, offset, normal))
    across = across - scale(normal, dot(across, normal))
    squared = dot(across, across)
    height = dot(plane, material - jnp.where(far, 0.0, corners(triangle)[0]))
    return scale(across, safe_divide(-height, squared))
