"""Geodesic chords towards emitters of many faces, for the light of these emitters alone.

A chord on a single face is as short as the face, and short chords are noisy. Here a cluster of faces is chosen first
(`EmitterClusters.cut`). The centre is uniform over the directions in the cone of the cluster's bounding sphere. The
chord is the arc of a great circle inside the cone. Its weight is (pi / 2) k / p of `chords` with k = 1 / length, so it
depends neither on the place of the centre nor on the number of faces. A crossing counts if a face of the cluster lies
behind it.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from jaxdr.boundary.line_sampling.chords import Chords, lobe_rate, random_across
from jaxdr.boundary.line_sampling.crossings import (
    WIDEST,
    ChordKind,
    Chosen,
    Crossings,
    lobe_reach,
    silhouette_crossings,
)
from jaxdr.boundary.shared.background import Behind, ask_behind, look_behind, numbers_behind, seen_edges
from jaxdr.boundary.shared.sampled_arcs import on_same_side, place
from jaxdr.geometry.queries import UNBOUNDED
from jaxdr.geometry.vector import cross, dot, norm, normalize, orthonormal_basis, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.scene.emitter_clusters import EmitterClusters, chosen, picked
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import balance
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.radiance import Requests
from jaxdr.transport.shading import Scatterer


class Cone(NamedTuple):
    """Directions from apexes to clusters' bounding spheres: unit `axis`, `sine` of the half-angle; detached.

    If the apex is inside the sphere or close to it, the cone is `wide`: it has all directions, and chords have the
    half-length `WIDEST`.
    """

    axis: Float[Array, "M 3"]
    sine: Float[Array, " M"]

    @property
    def wide(self):
        return self.sine > math.sin(WIDEST)

    @property
    def height(self) -> Float[Array, " M"]:
        """1 - cosine of the half-angle. The solid angle is 2 pi x height."""
        inside = jnp.minimum(self.sine, 1.0)
        return jnp.where(self.wide, 2.0, inside**2 / (1.0 + jnp.sqrt(1.0 - inside**2)))

    def half_chord(self, plane: Float[Array, "M 3"]) -> Float[Array, " M"]:
        """Half the angle inside the cone of great circles in planes with unit normals `plane`; 0 where they miss it."""
        off2 = dot(plane, self.axis) ** 2
        inside = jnp.minimum(self.sine, 1.0) ** 2
        half = jnp.arctan2(jnp.sqrt(jnp.maximum(inside - off2, 0.0)), jnp.sqrt(1.0 - inside))
        return jnp.where(self.wide, WIDEST, half)


def cone_to(clusters: EmitterClusters, node: Int[Array, " M"], apex: Float[Array, "M 3"]) -> Cone:
    """The cone around a cluster that an apex sees."""
    offset = clusters.centre[node] - apex
    distance = norm(offset)
    away = distance > 0
    sine = safe_divide(clusters.radius[node], distance, away, 2.0)
    return Cone(normalize(jnp.where(away[:, None], offset, 1.0)), sine)


class LampChords(NamedTuple):
    """Chords in cones towards clusters `node`, around unit `centre` directions.

    `pdf` is the density of centres (solid angle), times the probability of the cluster. Chords lie in planes with the
    unit normals `plane`, from the angle `low` <= 0 to `high` (radians) along cross(plane, centre).
    """

    node: Int[Array, " M"]
    centre: Float[Array, "M 3"]
    pdf: Float[Array, " M"]
    plane: Float[Array, "M 3"]
    low: Float[Array, " M"]
    high: Float[Array, " M"]
    ends: Float[Array, " M"]  # 1 if chords end where the cone ends, 0 if they have a fixed length around their centre

    def chords(self, apex: Float[Array, "M 3"], far: Float[Array, ""]) -> Chords:
        """Chords for the search, of unbounded sectors; `far` is a distance larger than the scene."""
        along = cross(self.plane, self.centre)

        def at(angle):
            return apex + scale(self.centre, far * jnp.cos(angle)) + scale(along, far * jnp.sin(angle))

        before, after = -jnp.sin(self.low), jnp.sin(self.high)
        both = before + after
        return Chords(
            first=at(self.low),
            last=at(self.high),
            centre=safe_divide(before, both, both > 0),
            group=jnp.full(self.pdf.shape, UNBOUNDED),
            useful=(self.pdf > 0) & (both > 0),
        )


def lamp_chords(clusters: EmitterClusters, apex: Float[Array, "M 3"], u: Float[Array, "M 4"]) -> LampChords:
    """Chords towards clusters, which are chosen by the light that they may send to the apexes."""
    cut = clusters.cut(apex)
    node, _ = chosen(cut.probability, u[:, 0])
    cone = cone_to(clusters, node, apex)
    height = cone.height
    low = u[:, 1] * height
    sine, angle = jnp.sqrt(low * (2.0 - low)), 2.0 * math.pi * u[:, 2]
    s, t = orthonormal_basis(cone.axis)
    centre = scale(cone.axis, 1.0 - low) + scale(s, sine * jnp.cos(angle)) + scale(t, sine * jnp.sin(angle))
    centre = normalize(centre)
    plane = random_across(centre, u[:, 3])
    half = cone.half_chord(plane)
    along = cross(plane, centre)
    middle = jnp.where(cone.wide, 0.0, jnp.arctan2(dot(cone.axis, along), dot(cone.axis, centre)))
    pdf = picked(cut.probability, node) / (2.0 * math.pi * height)
    start, end = jnp.minimum(middle - half, 0.0), jnp.maximum(middle + half, 0.0)
    return LampChords(node, centre, pdf, plane, start, end, jnp.where(cone.wide, 0.0, 1.0))


class LampShare(NamedTuple):
    """MIS of chords towards clusters and chords around BSDF samples, for the light of emitters past silhouettes.

    `lamps` and `lobes` are the expected numbers of chords from every path vertex, [B, P, n]. Both kinds are geodesic,
    with planes at uniform angles. So their weights (balance heuristic in the space of crossings) need no other factor.
    """

    packed: PackedScene
    reach: float
    lamps: Float[Array, "B P n"]
    lobes: Float[Array, "B P n"]

    def of_lamps(
        self, found: Crossings, scatterer: Scatterer, plane: Float[Array, "C 3"], towards, face: Int[Array, " C"]
    ) -> Float[Array, " C"]:
        """Weight of chords towards clusters at boundary points in unit directions `towards`, in front of `face`.

        The chords lie in planes with normals `plane`; `scatterer` is at the apexes. The faces emit light.
        """
        clusters, apex = self.packed.clusters, stop_gradient(scatterer.point.position)
        assert clusters is not None  # else there is no `LampShare`
        cut = clusters.cut(apex)
        node = clusters.node_at(cut, face)
        cone = cone_to(clusters, node, apex)
        lamps, lobes = (table.reshape(-1)[found.vertex] for table in (self.lamps, self.lobes))
        pdf = picked(cut.probability, node) / (2.0 * math.pi * cone.height)
        rate = pdf * 2.0 * cone.half_chord(plane) / math.pi * lamps
        return balance(rate, lobe_rate(scatterer, lobe_reach(scatterer, self.reach), plane, towards) * lobes)

    def weight_of_lobes(
        self, found: Crossings, scatterer: Scatterer, plane: Float[Array, "C 3"], point: SurfacePoint
    ) -> Float[Array, " C"]:
        """Weight of crossings of chords around BSDF samples; zero where `point` is on no surface."""
        towards = normalize(stop_gradient(point.position - scatterer.point.position))
        share = self.of_lamps(found, scatterer, plane, towards, point.face)
        return jnp.where(point.valid, 1.0 - share, 0.0)


@dataclass(frozen=True)
class LampLines(ChordKind):
    """Chords towards clusters of emitting faces."""

    both: LampShare | None = None

    def search(self, chosen: Chosen, key, room: int):
        packed = self.packed
        key_chord, key_seed = jax.random.split(key)
        scatterer, u = self.starts(chosen, key_chord, 4)
        assert packed.clusters is not None  # else `EmitterLines` finds their light
        drawn = lamp_chords(packed.clusters, stop_gradient(scatterer.point.position), u)
        apex = scatterer.leave_scattering(drawn.centre)
        chords = drawn.chords(apex, 2.0 * self.paths.distance_to_infinity)
        chords = chords.in_sight(scatterer, drawn.centre, jnp.maximum(-drawn.low, drawn.high))
        moves = self.prepared.moving[packed.face_shape[packed.emitter_faces]].any()
        return drawn, *silhouette_crossings(self, chosen, apex, chords, key_seed, room, moves)

    def score(self, drawn: LampChords, found: Crossings) -> Float[Array, " C"]:
        """Contribution of crossings if the cluster is behind them: magnitude per displacement of the edge."""
        seen, scatterer, weight = self._boundary(drawn, found)
        weight = magnitude(weight * scatterer.eval(seen.towards))
        return weight * self.packed.clusters.radiance[drawn.node[found.chord]] / seen.distance

    def look(self, drawn: LampChords, found: Crossings, number, weight, key) -> tuple[Requests, Behind]:
        """Requests for the emission behind crossings, and the factors that it is multiplied with, times `weight`."""
        packed, paths = self.packed, self.paths
        seen, scatterer, value = self._boundary(drawn, found)
        behind, background = look_behind(packed, scatterer, seen, scale(value, weight), found.valid, self.settings)
        clusters, face = packed.clusters, background.face
        cut = clusters.cut(stop_gradient(scatterer.point.position))
        aimed_at = packed.emitter_density[face] > 0
        aimed_at = aimed_at & (clusters.node_at(cut, face) == drawn.node[found.chord])
        share = jnp.ones_like(weight)
        if self.both is not None:
            share = self.both.of_lamps(found, scatterer, drawn.plane[found.chord], seen.towards, face)
        emission = jnp.where(background.valid & aimed_at, share, 0.0)
        # Behind a crossing there may be no face of the cluster, or the sky. Then nothing counts.
        behind = behind._replace(weight=jnp.where((emission > 0)[:, None], behind.weight, 0.0))
        numbers = numbers_behind(key, "lamp_lines", number, seen.distance.dtype)
        return ask_behind(paths, seen, background, numbers, emission, self.settings), behind

    def _boundary(self, drawn: LampChords, found: Crossings):
        """(the crossed edges as seen, BSDFs, contributions without BSDF, radiance and normal velocity).

        The weight is (pi / 2) k / p. k is constant on the part of the chord on the centre's side of the surface.
        """
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        low, high, ends, pdf = (table[found.chord] for table in (drawn.low, drawn.high, drawn.ends, drawn.pdf))
        counts = found.valid & scatterer.above_horizon(seen.edge_point)
        if scatterer.spreads_through() is not None:
            centre, plane = drawn.centre[found.chord], drawn.plane[found.chord]
            along = normalize(cross(plane, seen.towards))
            t = place(seen.towards, along, centre)
            shift = t * ends
            low, high = on_same_side(scatterer, seen.towards, along, centre, low + shift, high + shift)
            counts = counts & (t > low) & (t < high)
        length = high - low
        counts = counts & (pdf > 0) & (length > 0)
        weight = safe_divide(0.5 * math.pi, length * pdf, counts, 0.0)
        return seen, scatterer, scale(self.paths.table.throughput[found.vertex], weight)
