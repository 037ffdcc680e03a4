"""Geodesic chords around directions from an environment map, for the map's light alone."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.boundary.line_sampling.chords import LobeChords, lobe_rate, random_across
from jaxdr.boundary.line_sampling.crossings import (
    WIDEST,
    ChordKind,
    Chosen,
    Crossings,
    lobe_reach,
    silhouette_crossings,
)
from jaxdr.boundary.shared.background import Behind, ask_behind, look_behind, numbers_behind, seen_edges
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.boundary.shared.sampled_arcs import on_same_side, place
from jaxdr.geometry.vector import cross, dot, normalize, scale
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.sampling import balance
from jaxdr.transport.emission import environment_radiance
from jaxdr.transport.radiance import Requests
from jaxdr.transport.shading import Scatterer


class SkyShare(NamedTuple):
    """MIS of chords around the environment's samples and chords around BSDF samples, for the environment's light.

    `skies` and `lobes` are the expected numbers of chords from every path vertex, [B, P, n]. Both kinds are geodesic,
    with planes at uniform angles. So their weights (balance heuristic in the space of crossings) need no other factor.
    """

    packed: PackedScene
    paths: PathSegments
    reach: float
    skies: Float[Array, "B P n"]
    lobes: Float[Array, "B P n"]

    def of_skies(
        self, found: Crossings, scatterer: Scatterer, plane: Float[Array, "C 3"], towards: Float[Array, "C 3"]
    ) -> Float[Array, " C"]:
        """Weight of chords around the environment's samples at boundary points in unit directions `towards`.

        The chords lie in planes with normals `plane`; `scatterer` is at the apexes.
        """
        skies, lobes = (table.reshape(-1)[found.vertex] for table in (self.skies, self.lobes))
        other = lobe_rate(scatterer, lobe_reach(scatterer, self.reach), plane, towards) * lobes
        sampler = self.packed.environment_sampler
        rate = sampler.pdf(towards) * 2.0 * _extent(self.packed, towards) / math.pi * skies
        return balance(rate, other)


@dataclass(frozen=True)
class SkyLines(ChordKind):
    """Chords around directions from an environment map, for the map's light past silhouettes.

    A crossing counts if the chord's centre is within the map's `extent` of it. There the density of centres varies
    little.
    """

    both: SkyShare | None = None

    def search(self, chosen: Chosen, key, room: int):
        packed = self.packed
        key_chord, key_seed = jax.random.split(key)
        scatterer, u = self.starts(chosen, key_chord, 3)
        centre = packed.environment_sampler.sample(u[:, :2])
        plane = random_across(centre, u[:, 2])
        reach = jnp.minimum(packed.environment_sampler.reach(centre), WIDEST) * jnp.ones_like(u[:, 2])
        pdf = jnp.asarray(packed.environment_sampler.pdf(centre))
        drawn = LobeChords(centre, pdf, plane, reach)

        apex = scatterer.leave_scattering(centre)
        chords = drawn.chords(apex, 2.0 * self.paths.distance_to_infinity).in_sight(scatterer, centre, reach)
        return drawn, *silhouette_crossings(self, chosen, apex, chords, key_seed, room)

    def score(self, drawn: LobeChords, found: Crossings) -> Float[Array, " C"]:
        """Contribution of crossings if the environment is behind them: magnitude per displacement of the edge."""
        seen, scatterer, weight = self._boundary(drawn, found)
        radiance = scale(self._radiance(seen.towards), self._share(drawn, found, scatterer, seen.towards))
        weight = weight * scatterer.eval(seen.towards) * radiance
        return magnitude(weight) / seen.distance

    def look(self, drawn: LobeChords, found: Crossings, number, weight, key) -> tuple[Requests, Behind]:
        """Requests for the environment's radiance behind crossings, and the factors that multiply it x `weight`."""
        packed, paths = self.packed, self.paths
        seen, scatterer, value = self._boundary(drawn, found)
        value = scale(value, weight * self._share(drawn, found, scatterer, seen.towards))
        behind, background = look_behind(packed, scatterer, seen, value, found.valid, self.settings)
        emission = jnp.where(background.valid, 0.0, jnp.ones_like(weight))
        numbers = numbers_behind(key, "sky_lines", number, seen.distance.dtype)
        return ask_behind(paths, seen, background, numbers, emission, self.settings), behind

    def _radiance(self, towards: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
        return environment_radiance(self.packed, towards)

    def _share(self, drawn: LobeChords, found: Crossings, scatterer: Scatterer, towards) -> Float[Array, " C"]:
        if self.both is None:
            return jnp.ones(found.chord.shape, towards.dtype)
        return self.both.of_skies(found, scatterer, drawn.plane[found.chord], towards)

    def _boundary(self, drawn: LobeChords, found: Crossings):
        """(the crossed edges as seen, BSDFs, contributions without BSDF, radiance and normal velocity).

        The weight is (pi / 2) k / p. k is constant over the centres within the environment's `extent` of the boundary
        point that are on its side of the surface.
        """
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        centre, pdf = drawn.centre[found.chord], drawn.pdf[found.chord]
        extent = _extent(self.packed, seen.towards)
        near = dot(seen.towards, centre) > jnp.cos(extent)
        counts = found.valid & near & scatterer.above_horizon(seen.edge_point)
        half = extent
        if scatterer.spreads_through() is not None:
            along = normalize(cross(drawn.plane[found.chord], seen.towards))
            low, high = on_same_side(scatterer, seen.towards, along, centre, -extent, extent)
            t = place(seen.towards, along, centre)
            half, counts = 0.5 * (high - low), counts & (t > low) & (t < high)
        weight = jnp.where(counts, 0.25 * math.pi / (half * jnp.where(pdf > 0, pdf, 1.0)), 0.0)
        return seen, scatterer, scale(self.paths.table.throughput[found.vertex], weight)


def _extent(packed: PackedScene, towards: Float[Array, "C 3"]) -> Float[Array, " C"]:
    """Half-length of the arcs of centres from which boundary points are found (radians)."""
    return jnp.minimum(packed.environment_sampler.extent(towards), WIDEST) * jnp.ones_like(towards[:, 0])
