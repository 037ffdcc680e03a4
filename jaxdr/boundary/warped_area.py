"""Warped-area reparameterisation of boundary path integrals (Xu et al. 2023)."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.blocks import sum_over_blocks
from jaxdr.boundary.continuous_velocity import Kernel, draw_auxiliary, velocity_field
from jaxdr.boundary.occluders import Faces, connect_faces, find_occluders
from jaxdr.boundary.silhouettes import PathSegments, SegmentEnds, affine_coordinates
from jaxdr.geometry.vector import dot, interpolate, norm, normalize, orthonormal_basis
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.bidirectional import Drawn
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.interaction import on_fixed_ray
from jaxdr.transport.moved_paths import layers, moved_contributions, target_segments
from jaxdr.transport.path import PathRecord, PathSettings, Segments
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.shading import Scatterer

# f / pdf of the paths through N segments (RGB), as a function of where the targets are.
Measure = Callable[[Float[Array, "N 3"]], Float[Array, "N 3"]]


class Hidden(NamedTuple):
    """Auxiliary points (material points of their surface) and the material points that hide them; detached.

    `own`: hidden by the plane of the apex's own face, `occluder`; None where there are none.
    """

    position: Float[Array, "*n 3"]
    face: Int[Array, "*n"]
    barycentric: Float[Array, "*n 3"]
    occluder: Int[Array, "*n"]
    on_occluder: Float[Array, "*n 3"]
    own: Bool[Array, "*n"] | None = None


class Velocities(NamedTuple):
    """Auxiliary points that are hidden, `slots` in [N, Q, C], of which the first `used` are filled; detached.

    v(p) = sum of share x velocity, div v = sum of rate . velocity.
    """

    slots: Int[Array, " S"]
    used: Int[Array, ""]
    share: Float[Array, " S"]
    rate: Float[Array, "S 3"]
    table: Hidden

    def moved(self, packed: PackedScene, paths: PathSegments, index: Int[Array, " N"], ends: SegmentEnds, slot):
        """(which of N segments slots belong to, displacements of their occluders: zero, with the derivative v)."""
        row = slot // (self.table.face.shape[1] * self.table.face.shape[2])
        seen, far = jax.tree.map(lambda t: t.reshape(-1, *t.shape[3:])[slot], self.table), ends.infinite[row]
        apex = paths.apex_towards(index[row], seen.position)
        apex = jnp.where(far[:, None], paths.apex(index[row]).position, apex)
        return row, displacement(packed, apex, far, seen)


class WarpedArea(eqx.Module):
    """Boundary term of every segment behind the first hit as an area integral (Eq. 38); every field is static.

    Over the surface at the far end of a segment, div (f v) = f div v + grad f . v, with v a continuous velocity that is
    that of the boundary where it is approached: a convolution over `samples` auxiliary points. No edge is looked for.

    - `distance`: "path_space" (Eq. 16) or "exponential" (Eq. 57, of Bangaru et al. 2020), which has no small scale and
      needs many more auxiliary points.
    - `sigma0`: width of the kernel, that of Eq. 17, in lengths of the segment. Narrow ones are noisy; wide ones have
      to tell more boundaries apart.
    - `power`: a of Eq. 16.
    - `samples`: auxiliary points N_q of every path vertex; each is one projection onto the surface and one ray.
    - `projections`: room for projections of an auxiliary point onto its shape (further ones are reported).

    Where this differs from the paper, each difference has a switch; the values in brackets are the paper's.

    - `boundary_power` (1): power of the boundary-test function B in the kernel (Eq. 15). With 1 the kernel has no
      singularity at the boundary, and v does not reach the boundary's velocity.
    - `debias` (False): the divergence is exactly that of the mean velocity for any number of auxiliary points. Without,
      a quarter to three quarters of the term are missing with 8.
    - `spread`: scale of the auxiliary points' density in kernel widths; the paper draws from a Gaussian of unnamed
      width, whose tail is thinner than the kernel's.

    The derivative is as good as v is at the boundary: of a straight one 1 % is missing with 8 auxiliary points (0.1 %
    with 16), somewhat more at corners. With a `PathTracer` direct light is weighted by emitter sampling alone, without
    MIS; with a `BidirectionalPathTracer` every strategy counts with its weight.
    """

    distance: Literal["path_space", "exponential"] = eqx.field(static=True, default="path_space")
    sigma0: float = eqx.field(static=True, default=0.006)
    power: float = eqx.field(static=True, default=3.0)
    samples: int = eqx.field(static=True, default=8)
    boundary_power: float = eqx.field(static=True, default=3.0)
    debias: bool = eqx.field(static=True, default=True)
    spread: float = eqx.field(static=True, default=0.5)
    projections: int = eqx.field(static=True, default=2)

    def __check_init__(self):
        if self.distance not in ("path_space", "exponential"):
            raise ValueError(f"WarpedArea: distance must be 'path_space' or 'exponential', got {self.distance!r}")
        for name in ("sigma0", "power", "boundary_power", "spread"):
            if not getattr(self, name) > 0:
                raise ValueError(f"WarpedArea: {name} must be positive, got {getattr(self, name)}")
        for name in ("samples", "projections"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise ValueError(f"WarpedArea: {name} must be a whole number of at least 1, got {value}")

    @property
    def kernel(self) -> Kernel:
        """The kernel of the convolution."""
        return Kernel(self.distance, self.sigma0, self.power, self.boundary_power, self.spread)

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Faces:
        """Normals and neighbours of all faces, once for a whole image. Raises ValueError for what is not covered."""
        del moving  # every face may bound what moving surfaces see
        if packed.light_count and settings.max_depth > 2:
            raise ValueError(
                "WarpedArea: indirect light of lights without area has no boundary term here; take lights with an "
                "area, max_depth=2, or another boundary estimator"
            )
        return connect_faces(packed)

    def estimate(
        self,
        packed: PackedScene,
        prepared: Faces,
        primary: PrimarySamples,
        record: PathRecord,
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        settings: PathSettings,
    ) -> Float[Array, "N 3"]:
        """Boundary term of N paths: zero in value, right in derivative. `prepared` by `prepare`."""
        del sample_index
        total = jnp.zeros_like(record.radiance)
        if record.direct is None:
            return total
        key_direct, key_scattered = jax.random.split(key)
        fixed = jax.tree.map(stop_gradient, packed)
        direct = PathSegments(packed, primary, record.direct, record.vertices)
        if packed.has_area_emitters or packed.environment is not None:

            def measure(index, ends):
                return _direct_measure(fixed, direct, index, ends)

            kinds = packed.has_area_emitters, packed.environment is not None
            total += self._term(packed, fixed, prepared, direct, measure, kinds, key_direct, settings)
        if record.scattered is not None:
            bounces = record.scattered.apex_face.shape[0]
            vertices = jax.tree.map(lambda x: x[:bounces], record.vertices)
            scattered = PathSegments(packed, primary, record.scattered, vertices)

            def measure_beyond(index, ends):
                return _scattered_measure(fixed, scattered, direct, index, ends)

            kinds = True, False
            total += self._term(packed, fixed, prepared, scattered, measure_beyond, kinds, key_scattered, settings)
        return total

    def _term(self, packed, fixed, faces, paths: PathSegments, measure, kinds, key, settings) -> Float[Array, "N 3"]:
        """Boundary term of one kind of segments, bounce by bounce."""

        def of_bounce(bounce):
            index = bounce * paths.paths + jnp.arange(paths.paths)
            bounce_key = jax.random.fold_in(key, bounce)
            return self._bounce_term(packed, fixed, faces, paths, measure, index, kinds, bounce_key, settings)

        bounces = paths.count // paths.paths
        if bounces == 1:
            return of_bounce(jnp.int32(0))
        return jax.lax.map(jax.checkpoint(of_bounce), jnp.arange(bounces)).sum(0)

    def _bounce_term(self, packed, fixed, faces, paths, measure, index, kinds, key, settings):
        """f div v + grad f . v of N segments, summed over the hidden auxiliary points (the others are still)."""
        ends = jax.tree.map(stop_gradient, paths.ends(index))
        f = measure(index, ends)
        value = f(ends.target)
        lit = paths.table.visible[index] & (value != 0).any(-1)
        value = jnp.where(lit[:, None], value, 0.0)
        velocities = self._velocities(fixed, faces, paths, index, ends, lit, kinds, key, settings.rays)
        slopes = []
        for tangent in orthonormal_basis(ends.normal):
            slope = jax.jvp(f, (ends.target,), (tangent,))[1]
            slopes.append((tangent, jnp.where(lit[:, None], slope, 0.0)))
        value, slopes = stop_gradient((value, slopes))

        def terms(slot, number):
            row, moved = velocities.moved(packed, paths, index, ends, slot)
            result = value[row] * dot(velocities.rate[slot], moved)[:, None]
            for tangent, slope in slopes:
                result += slope[row] * (velocities.share[slot] * dot(tangent[row], moved))[:, None]
            result = jnp.where((number < velocities.used)[:, None], result, 0.0)
            return jnp.zeros((paths.paths, 3), result.dtype).at[row].add(result)

        return sum_over_blocks(jax.checkpoint(terms), velocities.slots, velocities.used)

    def _velocities(self, fixed, faces, paths, index, ends, lit, kinds, key, rays) -> Velocities:
        """Velocities of the auxiliary points of N segments, and what they count for the targets; all detached."""
        finite, infinite = kinds
        room = min(self.projections, fixed.faces.shape[0]) if finite else 1
        options = self.samples, room, key, rays, finite, infinite
        points = draw_auxiliary(fixed, faces.normal, ends, lit, self.kernel, *options)
        apex = jax.tree.map(stop_gradient, paths.apex(index))
        occluders = find_occluders(fixed, faces, apex, ends, points, self.kernel, rays)
        field = velocity_field(self.kernel, ends, points, occluders.boundary, self.debias, infinite)
        points, occluders, field = stop_gradient((points, occluders, field))

        # Slots that hold nothing repeat the first one: its numbers must be finite.
        hidden = (occluders.hidden & points.there & lit[:, None, None]).reshape(-1)
        shares = jnp.where(hidden, field.share.reshape(-1), 0.0)
        rates = jnp.where(hidden[:, None], field.divergence.reshape(-1, 3), 0.0)
        slots = jnp.nonzero(hidden, size=hidden.shape[0], fill_value=0)[0]
        table = Hidden(
            points.position, points.face, points.barycentric, occluders.face, occluders.barycentric, occluders.own
        )
        return Velocities(slots, hidden.sum(), shares, rates, table)

    def estimate_connected(
        self,
        packed: PackedScene,
        prepared: Faces,
        primary: PrimarySamples,
        drawn: Drawn,
        weight: Float[Array, "C N"],
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        rays: str,
    ) -> Float[Array, "C N 3"]:
        """Boundary terms of the paths of all strategies: zero in value, right in derivative (Eq. 52-54).

        `weight` is that of the strategies, zero where a path carries nothing. Every target moves with its mean
        velocity, which the contribution and its factor 1 + div v are differentiated by.
        """
        del sample_index
        fixed, drawn, weight = jax.tree.map(stop_gradient, (packed, drawn, weight))
        paths, used = PathSegments(packed, primary, target_segments(drawn)), layers(drawn).used()
        lit = (used[:, :, None] & (weight > 0)).any(1)
        kinds = True, packed.environment is not None

        def of_layer(numbered):
            layer, lit = numbered
            index = layer * paths.paths + jnp.arange(paths.paths)
            return self._target_motion(
                packed, fixed, prepared, paths, index, lit, kinds, jax.random.fold_in(key, layer), rays
            )

        moved, stretch = jax.lax.map(jax.checkpoint(of_layer), (jnp.arange(used.shape[0]), lit))
        value = moved_contributions(fixed, drawn, moved)
        whole = jnp.tensordot(jnp.asarray(used.T, stretch.dtype), stretch, 1)
        still = stop_gradient(value)
        return jnp.where((weight > 0)[..., None], weight[..., None] * (value - still + still * whole[..., None]), 0.0)

    def _target_motion(self, packed, fixed, faces, paths, index, lit, kinds, key, rays):
        """(mean velocities of the targets of N segments, in their planes, divergences); zero in value."""
        ends = jax.tree.map(stop_gradient, paths.ends(index))
        velocities = self._velocities(fixed, faces, paths, index, ends, lit, kinds, key, rays)

        def terms(slot, number):
            row, moved = velocities.moved(packed, paths, index, ends, slot)
            filled = number < velocities.used
            normal = ends.normal[row]
            in_plane = (moved - dot(moved, normal)[:, None] * normal) * velocities.share[slot][:, None]
            in_plane = jnp.where(filled[:, None], in_plane, 0.0)
            stretch = jnp.where(filled, dot(velocities.rate[slot], moved), 0.0)
            return jnp.zeros_like(ends.target).at[row].add(in_plane), jnp.zeros_like(ends.target[:, 0]).at[row].add(
                stretch
            )

        return sum_over_blocks(jax.checkpoint(terms), velocities.slots, velocities.used)


def displacement(
    packed: PackedScene, apex: Float[Array, "C 3"], infinite: Bool[Array, " C"], seen: Hidden
) -> Float[Array, "C 3"]:
    """Where occluders are projected to, less the material points there: zero, with the derivative v^dis (Eq. 7-8)."""
    corners = packed.vertices[packed.faces[seen.face]]
    material = interpolate(corners, seen.barycentric)
    normal = jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    before = packed.vertices[packed.faces[seen.occluder]]
    towards = interpolate(before, seen.on_occluder) - apex
    slope = dot(normal, towards)
    reach = dot(normal, material - apex) / jnp.where(slope == 0, 1.0, slope)
    offset, far = seen.position - stop_gradient(apex), infinite[:, None]
    projected = jnp.where(far, norm(offset)[:, None] * normalize(towards), apex + reach[:, None] * towards)
    material = jnp.where(far, packed.turned(offset), material)
    moved = projected - material
    if seen.own is not None:
        moved = jnp.where(seen.own[:, None], _horizon(before, stop_gradient(normal), material, offset, far), moved)
    return moved - stop_gradient(moved)


def _horizon(corners, normal, material, offset, far):
    """How the plane of the apex's face moves over the material points, across its trace in their plane (or sphere).

    The apex stays in that plane, so its own motion does not count.
    """
    plane = normalize(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    across = stop_gradient(plane)
    normal = normalize(jnp.where(far, offset, normal))
    across = across - dot(across, normal)[:, None] * normal
    squared = dot(across, across)
    height = dot(plane, material - jnp.where(far, 0.0, corners[:, 0]))
    return across * (-height / jnp.where(squared > 0, squared, 1.0))[:, None]


def _geometry(ends: SegmentEnds, position) -> tuple[Float[Array, "N 3"], Float[Array, "N 1"]]:
    """(unit directions from the apexes, cosine over squared distance) of points in the planes of the targets.

    At infinity there is no such factor: densities there are per solid angle.
    """
    offset = position - ends.apex
    distance2 = dot(offset, offset)
    there = distance2 > 0
    distance2 = jnp.where(there, distance2, 1.0)
    towards = jnp.where(there[:, None], offset, 1.0) / jnp.sqrt(distance2)[:, None]
    factor = jnp.where(ends.infinite, 1.0, jnp.abs(dot(ends.normal, towards)) / distance2)
    return towards, factor[:, None]


def _direct_measure(packed: PackedScene, paths: PathSegments, index, ends: SegmentEnds) -> Measure:
    """Of emitter samples: emitted radiance x geometric term x BSDF at the apex."""
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
        return weight * scatterer.eval(towards) * factor

    return measure


def _scattered_measure(packed: PackedScene, paths: PathSegments, direct: PathSegments, index, ends) -> Measure:
    """Of BSDF-sampled segments: BSDF at the apex x geometric term x what the target scatters towards the apex.

    That is what its own emitter sample and its own BSDF-sampled segment bring, with the far ends of both held fixed.
    """
    scatterer, after = paths.scatterer(index), index + paths.paths
    seen = stop_gradient(_geometry(ends, ends.target)[1]) * scatterer.eval(_geometry(ends, ends.target)[0])
    # Their weights contain that of the segment itself, at its target.
    itself = jnp.where(seen != 0, 1.0 / jnp.where(seen != 0, seen, 1.0), 0.0)
    parts: list[Onward] = [(direct.table, after, direct.table.visible)]
    if paths.count > paths.paths:
        parts.append((paths.table, after, paths.table.visible))

    def measure(position):
        towards, factor = _geometry(ends, position)
        point = on_fixed_ray(packed, position, ends.normal, ends.face)
        arriving = sent_back(packed, Scatterer(packed, point, -towards), parts)
        return itself * scatterer.eval(towards) * factor * arriving

    return measure


# Segments that lead on from N targets: a table, their numbers in it, and which of the table's are not hidden.
Onward = tuple[Segments, Int[Array, " N"], Bool[Array, " S"]]


def sent_back(packed: PackedScene, target: Scatterer, parts: list[Onward]) -> Float[Array, "N 3"]:
    """f / pdf of what targets scatter as they slide over their faces; the far ends of the segments stay."""
    position, arriving = target.point.position, jnp.zeros_like(target.point.position)
    for table, number, visible in parts:
        there = number < table.target_face.shape[0]
        number = jnp.where(there, number, 0)
        corners = packed.vertices[packed.faces[table.target_face[number]]]
        end = interpolate(corners, table.target_barycentric[number])
        normal = normalize(jnp.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
        infinite, direction = table.infinite[number], table.direction[number]
        beyond = SegmentEnds(position, target.point.face, end, normal, table.target_face[number], corners, infinite)
        outgoing, geometry = _geometry(beyond, jnp.where(infinite[:, None], position + direction, end))
        carried = jnp.where((there & visible[number])[:, None], table.weight[number], 0.0)
        arriving += carried * target.eval(outgoing) * geometry
    return arriving
