"""Geodesic chords around BSDF-sampled directions."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.line_sampling.chords import LobeChords, lobe_chords, lobe_weight
from jaxdr.boundary.line_sampling.crossings import (
    ChordKind,
    Chosen,
    Crossings,
    lobe_reach,
    silhouette_crossings,
)
from jaxdr.boundary.line_sampling.emitter_lines import Centres
from jaxdr.boundary.line_sampling.lamp_lines import LampShare
from jaxdr.boundary.line_sampling.sky_lines import SkyShare
from jaxdr.boundary.shared.background import Behind, ask_behind, look_behind, numbers_behind, seen_edges
from jaxdr.boundary.shared.kinds import of_kind
from jaxdr.geometry.vector import scale
from jaxdr.scene.color import magnitude
from jaxdr.transport.radiance import Requests


@dataclass(frozen=True)
class LobeLines(ChordKind):
    """Geodesic chords around BSDF-sampled directions, for light from everything but area emitters.

    With `both` they also count for light from area emitters, with their MIS weight. With `skies` they count for light
    from the environment map with their MIS weight only. `reach`: half-length of chords relative to the lobe's width.
    `kinds`: of segments that count; `lobe`: number of every path vertex among `shared.kinds.LOBES`.
    """

    reach: float
    kinds: tuple[str, ...]
    lobe: Int[Array, " S"]
    both: Centres | LampShare | None = None
    skies: SkyShare | None = None

    def search(self, chosen: Chosen, key, room: int):
        key_chord, key_seed = jax.random.split(key)
        scatterer, u = self.starts(chosen, key_chord, 3)
        lobes = lobe_chords(scatterer, lobe_reach(scatterer, self.reach), u)
        apex = scatterer.leave_scattering(lobes.centre)
        chords = lobes.chords(apex, 2.0 * self.paths.distance_to_infinity)
        return lobes, *silhouette_crossings(self, chosen, apex, chords, key_seed, room)

    def score(self, drawn: LobeChords, found: Crossings) -> Float[Array, " C"]:
        seen, scatterer, weight = self._boundary(drawn, found)
        return magnitude(weight * scatterer.eval(seen.towards)) / seen.distance

    def look(self, drawn: LobeChords, found: Crossings, number, weight, key) -> tuple[Requests, Behind]:
        """Requests for the radiance behind crossings, and the factors that it is multiplied with, times `weight`."""
        packed, paths = self.packed, self.paths
        seen, scatterer, value = self._boundary(drawn, found)
        value, plane = scale(value, weight), drawn.plane[found.chord]
        behind, background = look_behind(packed, scatterer, seen, value, found.valid, self.settings)
        # Weights for emission of the environment and of surfaces, which other kinds of chords may find as well.
        emission = jnp.zeros_like(weight)
        if packed.environment is not None or self.both is not None:
            surfaces = 0.0 if self.both is None else self.both.weight_of_lobes(found, scatterer, plane, background)
            sky = 1.0 if self.skies is None else 1.0 - self.skies.of_skies(found, scatterer, plane, seen.towards)
            lights = [self._asked(light, found.vertex) for light in ("emitters", "environment")]
            surfaces, sky = (jnp.where(counts, w, 0.0) for counts, w in zip(lights, (surfaces, sky), strict=True))
            emission = jnp.where(background.valid, surfaces, sky)
        numbers = numbers_behind(key, "lobe_lines", number, seen.distance.dtype)
        scattered = self._asked("scattered", found.vertex)
        return ask_behind(paths, seen, background, numbers, emission, self.settings, scattered), behind

    def _asked(self, light: str, vertex: Int[Array, " C"]) -> Bool[Array, " C"] | bool:
        """Whether the term is asked for this light past path vertices."""
        return of_kind(self.kinds, light, self.lobe[vertex])

    def _boundary(self, drawn: LobeChords, found: Crossings):
        """(the crossed edges as seen, BSDFs, contributions without BSDF, radiance and normal velocity)."""
        seen = seen_edges(self.packed, self.paths, found.vertex, found.edge, found.along, found.valid)
        scatterer = self.paths.scatterer(found.vertex)
        lobes = LobeChords(*(table[found.chord] for table in drawn))
        counts = found.valid & scatterer.above_horizon(seen.edge_point)
        weight = jnp.where(counts, lobe_weight(scatterer, lobes, seen.towards), 0.0)
        return seen, scatterer, scale(self.paths.table.throughput[found.vertex], weight)
