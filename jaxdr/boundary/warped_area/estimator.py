"""Warped-area reparameterisation of boundary path integrals (Xu et al. 2023)."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.face_neighbours import Faces, connect_faces
from jaxdr.boundary.shared.path_segments import PathSegments, SegmentEnds, path_segments
from jaxdr.boundary.shared.projection import affine_coordinates
from jaxdr.boundary.shared.refusals import Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits
from jaxdr.boundary.warped_area.continuous_velocity import Convolution, Kernel
from jaxdr.boundary.warped_area.divergence import (
    Measure,
    Velocities,
    Warped,
    WarpedTerm,
    check_options,
    displacement,
    divergence_term,
    reaches_no_boundary,
)
from jaxdr.geometry.vector import dot, interpolate, normalize, scale, triangle_normals, vanishes
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import on_fixed_ray
from jaxdr.transport.moved_paths import layers, moved_contributions, target_segments
from jaxdr.transport.path import Segments
from jaxdr.transport.shading import Scatterer


def _deep_hard_shadows(asked: Asked) -> str | None:
    if not asked.packed.light_count or asked.settings.max_depth <= 2:
        return None
    return (
        "WarpedArea: indirect light of lights without area has no boundary term here; take lights with an "
        "area, max_depth=2, or another boundary estimator"
    )


# With fewer auxiliary points a clear part of a boundary's velocity is missing (experiments/warped_area).
ENOUGH_POINTS = 6


@checked
class WarpedArea(WarpedTerm):
    """Boundary term as an area integral, for every segment behind the first hit (Xu et al. 2023, Eq. 38).

    It integrates div (f v) = f div v + grad f . v over the surface at the far end of a segment. v is a continuous
    velocity that tends to the boundary's velocity at the boundary. It is a convolution over `samples` auxiliary points.
    No search for edges is needed.

    All fields are static.

    - `distance`: "path_space" (Eq. 16), or "exponential" (Eq. 57, of Bangaru et al. 2020), which has no small scale and
      needs many more auxiliary points.
    - `sigma0`: width of the kernel of Eq. 17, in lengths of the segment. Narrow kernels are noisy. Wide kernels reach
      more boundaries.
    - `power`: a of Eq. 16.
    - `samples`: auxiliary points N_q of every path vertex; each costs one projection onto the surface and one ray.
    - `projections`: room for projections of an auxiliary point onto its shape. A warning reports more projections.

    Each difference from the paper has a switch. Values in brackets are the paper's.

    - `boundary_power` (1): power of the boundary-test function B in the kernel (Eq. 15). With 1 the kernel has no
      singularity at the boundary, and v does not reach the boundary's velocity.
    - `debias` (False): the divergence is exactly that of the mean velocity, for any number of auxiliary points. Without
      it, a large part of the term is missing with 8 points.
    - `spread`: scale of the density of auxiliary points, in kernel widths. The paper draws from a Gaussian of unstated
      width, whose tail is thinner than the kernel's.

    The derivative has a bias where v differs from the boundary's velocity at the boundary: with few auxiliary points a
    small part is missing, most of it at corners. With a `PathTracer` direct light comes from emitter sampling alone,
    without MIS. With a `BidirectionalPathTracer` every strategy counts with its weight.

    Raises ValueError for options out of range.
    """

    distance: Literal["path_space", "exponential"] = eqx.field(static=True, default="path_space")
    sigma0: float = eqx.field(static=True, default=0.006)
    power: float = eqx.field(static=True, default=3.0)
    samples: int = eqx.field(static=True, default=8)
    boundary_power: float = eqx.field(static=True, default=6.0)
    debias: bool = eqx.field(static=True, default=True)
    spread: float = eqx.field(static=True, default=0.5)
    projections: int = eqx.field(static=True, default=2)

    refusals = (
        Refusal(
            "lights without area, from `max_depth=3` on",
            "lights with an area, `max_depth=2`, another estimator",
            _deep_hard_shadows,
        ),
    )

    def __check_init__(self):
        check_options(self, ("samples", "projections"))

    def around(self, packed: PackedScene, finite: bool, infinite: bool, rays: str = "auto") -> Convolution:
        """How velocities are convolved, for targets on surfaces (`finite`), infinitely far away, or both."""
        kernel = Kernel(self.distance, self.sigma0, self.power, self.boundary_power, self.spread)
        room = min(self.projections, packed.faces.shape[0]) if finite else 1
        return Convolution(kernel, self.samples, room, self.debias, finite, infinite, rays=rays)

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`."""
        del found  # on every scene
        if self.samples >= ENOUGH_POINTS:
            return reaches_no_boundary(self)
        return reaches_no_boundary(self) or (
            f"with {self.samples} auxiliary points 5 to 30 % of a derivative are missing; take samples=16, or "
            "LineSampling"
        )

    def prepare(self, context: Context, key: PRNGKeyArray) -> Faces:
        """Normals and neighbours of all faces, once for a whole image. Raises ValueError for what is not covered."""
        del key  # all faces are needed: a face at rest may bound what a moving surface sees
        refuse(self.refusals, Asked(context.packed, context.settings))
        return connect_faces(context.packed)

    def of_paths(self, context: Context, state: Faces, chunk: Chunk, key: PRNGKeyArray) -> Float[Array, "N 3"]:
        """The terms of direct light and of BSDF-sampled segments, one value a path."""
        packed, rays, record = context.packed, context.settings.rays, chunk.record
        total = jnp.zeros_like(record.radiance)
        if record.direct is None:
            return total
        key_direct, key_scattered = jax.random.split(key)
        fixed = jax.tree.map(stop_gradient, packed)
        direct = path_segments(packed, chunk, "direct")
        if packed.has_area_emitters or packed.environment is not None:

            def measure(index, ends):
                return _direct_measure(fixed, direct, index, ends)

            around = self.around(fixed, packed.has_area_emitters, packed.environment is not None, rays)
            total += _term(Warped(packed, fixed, state, direct, around), measure, key_direct)
        if record.scattered is not None:
            scattered = path_segments(packed, chunk, "scattered")

            def measure_beyond(index, ends):
                return _scattered_measure(fixed, scattered, direct, index, ends)

            around = self.around(fixed, True, False, rays)
            total += _term(Warped(packed, fixed, state, scattered, around), measure_beyond, key_scattered)
        return total

    def estimate_connected(
        self, context: Context, state: Faces, chunk: Chunk, weight: Float[Array, "C N"], key: PRNGKeyArray
    ) -> Float[Array, "C N 3"]:
        """Boundary terms of the paths of all strategies: zero in value, right in derivative (Eq. 52-54).

        N paths, C strategies. `weight` is that of the strategies, zero where a path carries nothing. Every target moves
        with its mean velocity v. The term is the derivative of the contribution times the factor 1 + div v.
        """
        packed = context.packed
        fixed, drawn, weight = jax.tree.map(stop_gradient, (packed, chunk.record.drawn, weight))
        paths, used = PathSegments(packed, chunk.primary, target_segments(drawn)), layers(drawn).used()
        lit = (used[:, :, None] & (weight > 0)).any(1)
        around = self.around(fixed, True, packed.environment is not None, context.settings.rays)
        warped = Warped(packed, fixed, state, paths, around)

        def of_layer(numbered):
            layer, lit = numbered
            index = layer * paths.paths + jnp.arange(paths.paths)
            return _target_motion(warped, index, lit, jax.random.fold_in(key, layer))

        moved, stretch = jax.lax.map(jax.checkpoint(of_layer), (jnp.arange(used.shape[0]), lit))
        value = moved_contributions(fixed, drawn, moved)
        whole = jnp.tensordot(jnp.asarray(used.T, stretch.dtype), stretch, 1)
        still = stop_gradient(value)
        return jnp.where((weight > 0)[..., None], weight[..., None] * (value - still + still * whole[..., None]), 0.0)


def _term(warped: Warped, measure, key) -> Float[Array, "N 3"]:
    """Boundary term of one kind of segments, bounce by bounce: f div v + grad f . v."""
    paths = warped.paths

    def of_bounce(bounce):
        index = bounce * paths.paths + jnp.arange(paths.paths)
        ends = paths.fixed.ends(index)
        f = measure(index, ends)
        value = f(ends.target)
        lit = paths.table.visible[index] & (value != 0).any(-1)
        velocities = warped.velocities(index, ends, lit, jax.random.fold_in(key, bounce))

        def moved(slot):
            return _moved(warped.packed, paths, index, ends, velocities, slot)

        return divergence_term(f, value, ends, lit, velocities, moved)

    bounces = paths.count // paths.paths
    if bounces == 1:
        return of_bounce(jnp.int32(0))
    return jax.lax.map(jax.checkpoint(of_bounce), jnp.arange(bounces)).sum(0)


def _target_motion(warped: Warped, index, lit, key):
    """(mean velocities of the targets of N segments in their planes, divergences of these); zero in value."""
    ends = warped.paths.fixed.ends(index)
    velocities = warped.velocities(index, ends, lit, key)

    def terms(slot, number):
        row, filled = velocities.row(slot), number < velocities.used
        moved = _moved(warped.packed, warped.paths, index, ends, velocities, slot)
        normal, inside = ends.normal[row], velocities.inside(slot, moved)
        in_plane = scale(inside - scale(normal, dot(inside, normal)), velocities.share[slot])
        in_plane = jnp.where(filled[:, None], in_plane, 0.0)
        stretch = jnp.where(filled, dot(velocities.rate[slot], moved), 0.0)
        shift, whole = jnp.zeros_like(ends.target), jnp.zeros_like(ends.target[:, 0])
        return shift.at[row].add(in_plane), whole.at[row].add(stretch)

    return sum_over_blocks(terms, velocities.slots, velocities.used)


def _moved(packed: PackedScene, paths: PathSegments, index, ends: SegmentEnds, velocities: Velocities, slot):
    """Displacements of the occluders in slots: zero, with the derivative v."""
    row, seen = velocities.row(slot), velocities.seen(slot)
    far = ends.infinite[row]
    apex = paths.position(index[row])
    near = paths.apex_towards(index[row], apex, seen.position)
    return displacement(packed, jnp.where(far[:, None], apex, near), far, seen)


def _geometry(ends: SegmentEnds, position) -> tuple[Float[Array, "N 3"], Float[Array, " N"]]:
    """(unit directions from the apexes, cosine over squared distance) of points in the planes of the targets.

    At infinity the factor is one, because densities are per solid angle there.
    """
    offset = position - ends.apex
    distance2 = dot(offset, offset)
    there = ~vanishes(offset)
    distance2 = jnp.where(there, distance2, 1.0)
    towards = jnp.where(there[:, None], scale(offset, 1.0 / jnp.sqrt(distance2)), 1.0)
    return towards, jnp.where(ends.infinite, 1.0, jnp.abs(dot(ends.normal, towards)) / distance2)


def _direct_measure(packed: PackedScene, paths: PathSegments, index, ends: SegmentEnds) -> Measure:
    """The measure of emitter samples: emitted radiance x geometric term x BSDF at the apex."""
    scatterer, table = paths.scatterer(index), paths.table

    def measure(position):
        towards, factor = _geometry(ends, position)
        weight = table.weight[index]
        if table.unlit is not None and packed.has_varying_sky:
            sky = environment_radiance(packed, towards)
            weight = jnp.where(ends.infinite[:, None], table.unlit[index] * sky, weight)
        if table.unlit is not None and packed.glow:
            radiance = packed.surface_radiance(ends.face, affine_coordinates(ends.corners, position))
            weight = jnp.where(ends.infinite[:, None], weight, table.unlit[index] * radiance)
        return scale(weight * scatterer.eval(towards), factor)

    return measure


def _scattered_measure(packed: PackedScene, paths: PathSegments, direct: PathSegments, index, ends) -> Measure:
    """The measure of BSDF-sampled segments: BSDF at the apex x geometric term x radiance scattered by the target.

    The target scatters the light of its own emitter sample and its own BSDF-sampled segment. The far ends of both are
    held fixed.
    """
    scatterer, after = paths.scatterer(index), index + paths.paths
    towards, factor = _geometry(ends, ends.target)
    seen = scale(scatterer.eval(towards), stop_gradient(factor))
    # The weights of the target's segments contain the factor `seen` of this segment.
    itself = safe_divide(1.0, seen, otherwise=0.0)
    parts: list[Onward] = [(direct.table, after, direct.table.visible)]
    if paths.count > paths.paths:
        parts.append((paths.table, after, paths.table.visible))

    def measure(position):
        towards, factor = _geometry(ends, position)
        point = on_fixed_ray(packed, position, ends.normal, ends.face)
        arriving = sent_back(packed, Scatterer(packed, point, -towards), parts)
        return scale(itself * scatterer.eval(towards) * arriving, factor)

    return measure


# Segments that lead on from N targets: a table, their numbers in it, and which segments of the table are not hidden.
# Tables differ in length, so the last has no letter.
Onward = tuple[Segments, Int[Array, " N"], Bool[Array, " _"]]


def sent_back(packed: PackedScene, target: Scatterer, parts: list[Onward]) -> Float[Array, "N 3"]:
    """f / pdf of the light that targets scatter, as they slide over their faces; the segments' far ends are fixed."""
    position, arriving = target.point.position, jnp.zeros_like(target.point.position)
    for table, number, visible in parts:
        there = number < table.target_face.shape[0]
        number = jnp.where(there, number, 0)
        triangle = packed.corners_of(table.target_face[number])
        end = interpolate(triangle, table.target_barycentric[number])
        normal = normalize(triangle_normals(triangle))
        infinite, direction = table.infinite[number], table.direction[number]
        beyond = SegmentEnds(position, target.point.face, end, normal, table.target_face[number], triangle, infinite)
        outgoing, geometry = _geometry(beyond, jnp.where(infinite[:, None], position + direction, end))
        carried = jnp.where((there & visible[number])[:, None], table.weight[number], 0.0)
        arriving += scale(carried * target.eval(outgoing), geometry)
    return arriving
