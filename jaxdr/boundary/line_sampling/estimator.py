"""Line sampling: boundary path integrals from silhouette crossings on random chords, without a radius."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.line_sampling.crossings import (
    BOUNDS,
    HIDES,
    MOVES,
    ChordKind,
    Chosen,
    Crossings,
    LineSamplingState,
    RankedEdges,
)
from jaxdr.boundary.line_sampling.emitter_lines import Centres, EmitterLines
from jaxdr.boundary.line_sampling.lamp_lines import LampLines, LampShare
from jaxdr.boundary.line_sampling.lobe_lines import LobeLines
from jaxdr.boundary.line_sampling.sky_lines import SkyLines, SkyShare
from jaxdr.boundary.shared.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.shared.background import BehindEdges, sum_behind
from jaxdr.boundary.shared.blocks import map_over_blocks, sum_over_blocks
from jaxdr.boundary.shared.emitter_planes import emitter_groups
from jaxdr.boundary.shared.kinds import any_above, asked_for, glossy_at, lobes_along, of_kind, present
from jaxdr.boundary.shared.on_planes import OnPlanes, sum_on_planes
from jaxdr.boundary.shared.path_segments import PathSegments, path_segments
from jaxdr.boundary.shared.projection import never_silhouettes
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.geometry import queries
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.transport.radiance import Answers, Requests, joined

ROW = 64  # expected numbers of kept crossings are rounded together in rows of so many crossings


class Spread(NamedTuple):
    """One kind of chords, their expected number from every path vertex, and the share of crossings that is kept."""

    lines: ChordKind
    expected: Float[Array, "B P n"]
    kept: Float[Array, ""]
    key: PRNGKeyArray

    def beside(self, **ways: Any) -> "Spread":
        """The same spread, whose kind gets the fields `ways`: its MIS with other kinds of chords."""
        return self._replace(lines=dataclasses.replace(self.lines, **ways))


class _Held(NamedTuple):
    """Boundary points on emitters with the number of filled slots, and boundary points with traced backgrounds."""

    emitters: tuple[OnPlanes, Int[Array, ""]] | None
    behind: list[BehindEdges]


@checked
class LineSampling(eqx.Module):
    """Boundary term by line sampling: every silhouette that crosses a random chord. All fields are static.

    It is unbiased and has no radius. Light of area emitters is found by chords on the emitters; if these have more than
    16 faces, by geodesic chords across clusters of faces. All other light (environment, indirect) is found by geodesic
    chords around BSDF-sampled directions. If the integrator's sampling is "mis", both kinds find the light of area
    emitters, and chords around an environment map's samples find the map's light.

    - `chords`: chords of each kind per path sample. A pilot sends them to the pixels whose shadows it finds, and to the
      path vertices that carry most.
    - `pilot`: pilot chords per chord. 0 spreads chords by throughput alone.
    - `floor`: importance that every pixel keeps, relative to the mean over pixels.
    - `reach`: half-length of geodesic chords, relative to the lobe's width (`BSDF.lobe_width`); at most 1.4 radians.
    - `backgrounds`: paths traced from what lies behind silhouettes, per path sample.
    - `capacity`: room for crossings, as a share of the number of chords. If there are more crossings, a random part is
      left out without bias, with a warning.

    Raises ValueError for options out of range.
    """

    chords: float = eqx.field(static=True, default=1.0)
    pilot: float = eqx.field(static=True, default=0.25)
    floor: float = eqx.field(static=True, default=0.2)
    reach: float = eqx.field(static=True, default=1.0)
    backgrounds: float = eqx.field(static=True, default=1.0)
    capacity: float = eqx.field(static=True, default=4.0)

    name, takes_kinds = "boundary", True

    def __check_init__(self):
        for name in ("chords", "floor", "reach", "backgrounds", "capacity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LineSampling: {name} must be positive, got {getattr(self, name)}")
        if not self.pilot >= 0:
            raise ValueError(f"LineSampling: pilot must not be negative, got {self.pilot}")

    def prepare(self, context: Context, key: PRNGKeyArray) -> LineSamplingState:
        """Ranks of the edges and the tree over them."""
        del key
        packed, moving = context.packed, context.moving.seen
        edges, flags = packed.edges, jnp.asarray(moving)
        rank = jnp.where(flags[edges.shape], MOVES, BOUNDS)
        rank = jnp.where(never_silhouettes(packed), HIDES, rank).astype(packed.vertices.dtype)
        ranked = queries.EdgeSet.of(edges, rank)
        tree = queries.edge_tree(packed.geometry, ranked, packed.edge_counts, context.settings.rays)
        faces = np.diff(packed.first_face)
        still = faces[~np.asarray(moving)].sum()
        group = jnp.full(packed.faces.shape[0], -1, jnp.int32)
        if packed.has_area_emitters and packed.clusters is None:
            group = emitter_groups(packed)
        count_layers = jnp.asarray(bool(still <= faces.sum() // 2))
        return LineSamplingState(RankedEdges(rank, tree), group, flags, count_layers)

    def draw(
        self, context: Context, state: LineSamplingState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, "_Held | None"]:
        """Crossings of chords, and requests for the radiance behind crossings of geodesic chords."""
        packed = context.packed
        if chunk.record.direct is None:
            return None, None
        paths = path_segments(packed, chunk, "direct", differentiated=False)
        emitters, others = self._spreads(context, state, paths, key)
        found = None if emitters is None else self._on_emitters(emitters)
        asked, behind = [], []
        for spread in others:
            requests, edges = self._look_behind(spread)
            asked.append(requests)
            behind.append(edges)
        return joined(asked) if asked else None, _Held(found, behind)

    def image(
        self, context: Context, state: LineSamplingState, chunk: Chunk, held: "_Held | None", answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """Boundary term: zero in value, right in derivative."""
        packed, total = context.packed, jnp.zeros_like(chunk.record.radiance)
        if held is None:
            return chunk.image(packed, total)
        paths = path_segments(packed, chunk, "direct")
        if held.emitters is not None:
            total += sum_on_planes(packed, paths, *held.emitters)
        first = 0
        for edges in held.behind:
            last = first + edges.behind.segment.shape[0]
            total += sum_behind(packed, paths, edges, answers.total[first:last])
            first = last
        return chunk.image(packed, total)

    def _spreads(self, context: Context, state: LineSamplingState, paths: PathSegments, key):
        """(chords on emitters or None; chords around BSDF samples, around a map's samples, and towards clusters)."""
        packed, settings = context.packed, context.settings
        kinds = present(packed, settings.max_depth, context.kinds)
        key_emitters, key_lobes = jax.random.split(key)
        throughput, vertex = magnitude(paths.table.throughput), jnp.arange(paths.count)
        glossy = glossy_at(packed, paths.table.apex_face.reshape(-1, paths.paths))
        lobe = lobes_along(glossy, any_above(glossy)).reshape(-1)

        def carries(light: str):
            return jnp.where(of_kind(kinds, light, lobe), throughput, 0.0)

        one_light = settings._replace(max_depth=2)  # no light that the surface behind a silhouette scatters
        emitters = lobes = skies = lamps = None
        if asked_for(kinds, "emitters") and packed.clusters is None:
            lines = EmitterLines(packed, state, paths, settings)
            emitters = self._spread(lines, carries("emitters"), key_emitters)
        if asked_for(kinds, "environment") or asked_for(kinds, "scattered"):
            # No indirect light reaches the last vertex.
            onwards = jnp.where(vertex < paths.count - paths.paths, carries("scattered"), 0.0)
            lines = LobeLines(packed, state, paths, settings, self.reach, kinds, lobe)
            lobes = self._spread(lines, jnp.maximum(carries("environment"), onwards), key_lobes)
        if settings.mis and packed.has_varying_sky and asked_for(kinds, "environment"):
            lines = SkyLines(packed, state, paths, one_light)
            skies = self._spread(lines, carries("environment"), jax.random.fold_in(key, 3))
            numbers = skies.expected * skies.kept, lobes.expected * lobes.kept
            share = SkyShare(packed, paths, self.reach, *numbers)
            skies, lobes = skies.beside(both=share), lobes.beside(skies=share)
        if asked_for(kinds, "emitters") and packed.clusters is not None:
            lines = LampLines(packed, state, paths, one_light)
            lamps = self._spread(lines, carries("emitters"), key_emitters)
            if lobes is not None and settings.mis:
                numbers = lamps.expected * lamps.kept, lobes.expected * lobes.kept
                share = LampShare(packed, self.reach, *numbers)
                lamps, lobes = lamps.beside(both=share), lobes.beside(both=share)
        if emitters is not None and lobes is not None and settings.mis:
            share = Centres(packed, state, paths, self.reach, emitters.expected, lobes.expected * lobes.kept)
            emitters, lobes = emitters.beside(both=share), lobes.beside(both=share)
        return emitters, [spread for spread in (lobes, skies, lamps) if spread is not None]

    def _spread(self, lines: ChordKind, carries, key) -> Spread:
        """Where chords of one kind go, and how many; `carries` is the importance of every path vertex."""
        paths = lines.paths
        _, _, width, height = paths.packed.camera.film.window
        pixels, samples = width * height, paths.paths // (width * height)
        layout = (paths.count // paths.paths, pixels, samples)
        key_pilot, key_pilot_chords, key_rest = jax.random.split(key, 3)
        chords = self.chords * paths.paths
        importance = carries.reshape(layout)
        kept = jnp.ones((), importance.dtype)
        if self.pilot > 0:
            count = self.pilot * chords
            chosen = Chosen(*allocate(shares(importance, count), capacity(round(count), pixels), key_pilot))
            drawn, found, thinned, used = lines.search(chosen, key_pilot_chords, self._room(count))

            def scores(block: Crossings, number):
                score = lines.score(drawn, block) * safe_divide(thinned, carries[block.vertex], block.valid)
                score = jnp.where(block.valid & (number < used), score, 0.0)
                return jnp.zeros(chosen.vertex.shape[0], score.dtype).at[block.chord].add(score)

            per_chord = sum_over_blocks(scores, found, used)
            pixel = paths.path(jnp.maximum(chosen.vertex, 0)) // samples
            of_pixel = pixel_importance(per_chord, pixel, chosen.vertex >= 0, (height, width), self.floor)
            importance = importance * of_pixel[None, :, None]
            if lines.traces_paths:
                kept = jnp.minimum(kept, self.backgrounds * self.pilot * paths.paths / jnp.maximum(used * thinned, 1))
        return Spread(lines, shares(importance, chords), kept, key_rest)

    def _crossings(self, spread: Spread):
        """(chords of one kind, crossings that count, their weights, their number)."""
        lines, paths = spread.lines, spread.lines.paths
        key_main, key_chords, key_kept = jax.random.split(spread.key, 3)
        chords = self.chords * paths.paths
        room = capacity(round(chords), spread.expected.shape[1])
        chosen = Chosen(*allocate(spread.expected, room, key_main))
        drawn, found, thinned, used = lines.search(chosen, key_chords, self._room(chords))
        found = found._replace(valid=found.valid & (jnp.arange(found.valid.shape[0]) < used))
        weight = thinned * chosen.inverse[found.chord]
        if found.share is not None:
            weight = weight * found.share
        if lines.traces_paths:
            found, weight, used = self._kept(lines, drawn, found, weight, used, key_kept)
        return drawn, found, weight, used

    def _on_emitters(self, spread: Spread) -> tuple[OnPlanes, Int[Array, ""]]:
        """(boundary points that chords on emitters find, how many slots are filled)."""
        lines = spread.lines
        assert isinstance(lines, EmitterLines)
        drawn, found, weight, used = self._crossings(spread)

        def points(block, number):
            block, weight = block
            block = block._replace(valid=block.valid & (number < used))
            return lines.on_planes(drawn, block, weight)

        return map_over_blocks(points, (found, weight), used), used

    def _look_behind(self, spread: Spread) -> tuple[Requests, BehindEdges]:
        """What is behind crossings of geodesic chords, and requests for its radiance."""
        lines = spread.lines
        assert isinstance(lines, LobeLines | SkyLines | LampLines)
        drawn, found, weight, used = self._crossings(spread)
        key = jax.random.fold_in(spread.key, 1)

        def look(block, number):
            block, weight = block
            block = block._replace(valid=block.valid & (number < used))
            return lines.look(drawn, block, number, weight, key)

        asked, behind = map_over_blocks(look, (found, weight), used)
        return asked, BehindEdges(behind, used)

    def _kept(self, lines: ChordKind, drawn, found: Crossings, weight, used, key):
        """Crossings drawn in proportion to their expected contributions, their weights, and their number.

        A path from behind a crossing is expensive. So as many crossings are kept as `backgrounds` asks for.
        """
        rows = -(-found.chord.shape[0] // ROW)
        room = rows * ROW

        def scores(block, number):
            block, weight = block
            return jnp.where(block.valid & (number < used), lines.score(drawn, block) * weight, 0.0)

        score = map_over_blocks(scores, (found, weight), used)
        score = score + jnp.where(score > 0, self.floor * score.sum() / jnp.maximum((score > 0).sum(), 1), 0.0)
        count = self.backgrounds * lines.paths.paths
        expected = shares(jnp.pad(score, (0, room - score.shape[0])).reshape(1, rows, ROW), count)
        slot, inverse = allocate(expected, capacity(round(count), rows), key)
        kept = jax.tree.map(lambda table: table[jnp.maximum(slot, 0)], found)
        kept = kept._replace(valid=kept.valid & (slot >= 0))
        return kept, weight[jnp.maximum(slot, 0)] * inverse, (slot >= 0).sum()

    def _room(self, chords: float) -> int:
        return max(1024, round(self.capacity * chords))
