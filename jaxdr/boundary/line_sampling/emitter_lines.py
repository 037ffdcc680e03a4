"""Chords on area emitters, and their MIS weight beside geodesic chords that find the same light."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float

from jaxdr.boundary.line_sampling.chords import (
    EmitterChords,
    angle_ratio,
    emitter_chords,
    emitter_rate,
    lobe_rate,
)
from jaxdr.boundary.line_sampling.crossings import (
    ChordKind,
    Chosen,
    Crossings,
    LineSamplingState,
    lobe_reach,
    silhouette_crossings,
)
from jaxdr.boundary.shared.emitter_planes import chord_inside, emitter_face_at
from jaxdr.boundary.shared.on_planes import OnPlanes
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.boundary.shared.projection import project_edges
from jaxdr.geometry.vector import between, corners, cross, dot, normalize, scale, vanishes
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import balance
from jaxdr.transport.emission import emitted, emitting_surface_pdf
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.shading import Scatterer


class Centres(NamedTuple):
    """MIS of both kinds of chords, which find the same crossings (balance heuristic in the space of crossings).

    `emitters` and `lobes` are the expected numbers of chords from every path vertex, [B, P, n]. A crossing is a
    boundary point and the angle of a chord there. The MIS weights depend on both, so both kinds must integrate over the
    angle with the same measure. But each kind has |sin(phi - phi_l)| dphi / 2 in its own space. So a mean of both is
    integrated here, with weights that depend on the boundary point alone.
    """

    packed: PackedScene
    prepared: LineSamplingState
    paths: PathSegments
    reach: float
    emitters: Float[Array, "B P n"]
    lobes: Float[Array, "B P n"]

    def weight_of_emitters(
        self, found: Crossings, scatterer: Scatterer, plane: Float[Array, "C 3"], point: SurfacePoint, pdf, length
    ) -> Float[Array, " C"]:
        """Weight of crossings of chords on emitters, in planes with the normals `plane`.

        `scatterer` is at the apexes, `point` on the emitter. `pdf` is the density of the chords' centres (per area),
        `length` their length.
        """
        share, both, ratio = self._shares(found, scatterer, plane, point, pdf, length)
        return share * both / ratio

    def weight_of_lobes(
        self, found: Crossings, scatterer: Scatterer, plane: Float[Array, "C 3"], point: SurfacePoint
    ) -> Float[Array, " C"]:
        """The same weight for geodesic chords; zero where `point` is on no surface."""
        normal = stop_gradient(point.normal)
        along = cross(plane, normal)
        meets = ~vanishes(along) & point.valid
        along = normalize(jnp.where(meets[:, None], along, 1.0))
        _, _, length = chord_inside(self.packed, self.prepared.group, point.face, stop_gradient(point.position), along)
        share, both, _ = self._shares(found, scatterer, plane, point, emitting_surface_pdf(self.packed, point), length)
        return jnp.where(meets, (1.0 - share) * both, 0.0)

    def _shares(self, found: Crossings, scatterer: Scatterer, plane, point: SurfacePoint, pdf, length):
        """(MIS weight of emitters' chords, mean measure of angles, emitters' measure); measures as in `angle_ratio`."""
        vertex, expected = found.vertex, (self.emitters.reshape(-1), self.lobes.reshape(-1))
        emitters, lobes = (table[vertex] for table in expected)
        position, normal = stop_gradient(point.position), stop_gradient(point.normal)
        apex = scatterer.point.position
        towards = normalize(position - apex)
        rate = emitter_rate(pdf, length, apex, position, normal, plane) * emitters
        other = lobe_rate(scatterer, lobe_reach(scatterer, self.reach), plane, towards) * lobes

        start, end = corners(stop_gradient(self.packed.vertices)[self.packed.edges.vertices[found.edge]])
        ratio = angle_ratio(apex, position, normal, plane, end - start)
        cosine, offset = dot(normal, towards), position - apex
        density = pdf * dot(offset, offset) / jnp.where(cosine == 0, 1.0, jnp.abs(cosine)) * emitters
        mixed = balance(density, scatterer.pdf(towards) * lobes)
        return balance(rate, other), mixed * ratio + 1.0 - mixed, ratio


@dataclass(frozen=True)
class EmitterLines(ChordKind):
    """Chords on area emitters, for their light."""

    both: Centres | None = None
    traces_paths = False

    def search(self, chosen: Chosen, key, room: int):
        key_chord, key_seed = jax.random.split(key)
        scatterer, u = self.starts(chosen, key_chord, 3)
        through, horizon = scatterer.spreads_through(), None
        if through is not None:
            horizon = jnp.where(through[:, None], scatterer.normal, 0.0)
        drawn = emitter_chords(self.packed, self.prepared.group, scatterer.point.position, u, horizon)
        # Start on the side that scatters, even if the chord's centre is below the horizon, which a chord may cross.
        # Where both sides scatter, the chord ends at the horizon.
        apex = scatterer.leave_scattering(stop_gradient(drawn.centre.position) - scatterer.point.position)
        return drawn, *silhouette_crossings(self, chosen, apex, drawn.chords, key_seed, room)

    def score(self, drawn: EmitterChords, found: Crossings) -> Float[Array, " C"]:
        projection, weight, _, _ = self._boundary(drawn, found)
        return safe_divide(magnitude(weight), projection.fraction, projection.fraction > 0)

    def on_planes(self, drawn: EmitterChords, found: Crossings, weight: Float[Array, " C"]) -> OnPlanes:
        """The crossings as points on the emitters' planes, with their contributions times `weight`."""
        projection, value, point, scatterer = self._boundary(drawn, found)
        if self.both is not None:
            chords = jax.tree.map(lambda table: table[found.chord], drawn.chords)
            plane = chords.plane(scatterer.point.position)
            pdf, length = drawn.pdf[found.chord], drawn.length[found.chord]
            weight = weight * self.both.weight_of_emitters(found, scatterer, plane, point, pdf, length)
        here = point.face, point.barycentric, jnp.zeros_like(found.valid), jnp.zeros_like(point.position)
        return OnPlanes(found.vertex, found.edge, projection, *here, scale(value, weight))

    def _boundary(self, drawn: EmitterChords, found: Crossings):
        """(the crossed edges projected onto the emitter, contributions without normal velocity, the points, BSDFs)."""
        packed, paths, group = self.packed, self.paths, self.prepared.group
        face = drawn.centre.face[found.chord]
        scatterer = paths.scatterer(found.vertex)
        on_plane = _projected(self, found, scatterer.point.position, drawn.centre)
        # The point may lie in another triangle than the chord's centre, and its vertices may move differently.
        face, barycentric, inside = emitter_face_at(packed, group, face, on_plane)
        ends = paths.ends_to(found.vertex, face, barycentric, jnp.zeros_like(inside), jnp.zeros_like(barycentric))
        projection = project_edges(packed, found.edge, ends, found.along)
        point = material_point(paths.fixed.packed, face, barycentric, inside)
        # The radiance at this point, not at the centre. Behind the emitter it is zero.
        radiance = emitted(paths.fixed.packed, point, stop_gradient(ends.apex) - projection.point)
        value = paths.table.throughput[found.vertex] * radiance
        value = scale(value, drawn.weight()[found.chord])
        value = value * paths.transfer(found.vertex, ends, projection.point, scatterer)
        counts = found.valid & inside & scatterer.above_horizon(projection.edge_point)
        return projection, jnp.where(counts[:, None], value, 0.0), point, scatterer


def _projected(lines: EmitterLines, found: Crossings, apex, centre: SurfacePoint) -> Float[Array, "C 3"]:
    """Projections of the crossed edges onto the planes of the chords' centres; detached."""
    target, normal = stop_gradient(centre.position)[found.chord], stop_gradient(centre.normal)[found.chord]
    fixed = lines.paths.fixed.packed
    offset = between(*corners(fixed.vertices[fixed.edges.vertices[found.edge]]), found.along) - apex
    slope = dot(normal, offset)
    return apex + scale(offset, safe_divide(dot(normal, target - apex), slope))
