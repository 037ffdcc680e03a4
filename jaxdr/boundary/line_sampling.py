"""Line sampling: boundary path integrals from silhouette crossings on random chords, without a radius (DESIGN 2b)."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.attached_lines import AttachedLines, folded_edges
from jaxdr.boundary.blocks import map_over_blocks, sum_over_blocks
from jaxdr.boundary.crossings import BOUNDS, HIDES, MOVES, Chosen, Crossings, Lines, Prepared, RankedEdges
from jaxdr.boundary.emitter_lines import Centres, EmitterLines
from jaxdr.boundary.emitter_planes import emitter_groups
from jaxdr.boundary.lobe_lines import LobeLines
from jaxdr.boundary.silhouettes import PathSegments, never_silhouettes
from jaxdr.boundary.sky_lines import SkyLines, SkyShare
from jaxdr.geometry import queries
from jaxdr.scene.color import luminance
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path import PathRecord, PathSettings
from jaxdr.transport.primary import PrimarySamples

ROW = 64  # crossings among which some are kept are rounded together


class Spread(NamedTuple):
    """One kind of chords, how many are expected from every path vertex, and the share of crossings that is kept."""

    lines: Lines
    expected: Float[Array, "B P n"]
    kept: Float[Array, ""]
    key: PRNGKeyArray


class LineSampling(eqx.Module):
    """Boundary term of every segment behind the first hit, by line sampling; every field is static.

    Unbiased, and without a radius. Light of area emitters is found by chords on the emitters, all other light
    (environment, indirect) by geodesic chords around BSDF-sampled directions. Where the integrator's sampling is "mis"
    and there are both kinds, both find the light of area emitters; and chords around an environment map's samples find
    its light as well.

    - `chords`: chords of each kind per path sample. They need not be as many as the paths: a pilot sends them to the
      pixels whose shadows they find, and to the path vertices that carry most.
    - `pilot`: pilot chords per chord; 0 spreads chords by throughput alone.
    - `floor`: importance that every pixel keeps, relative to the mean over pixels.
    - `reach`: half-length of geodesic chords, relative to the lobe's width (`BSDF.lobe_width`); at most 1.4 radians.
    - `backgrounds`: paths traced from what lies behind silhouettes, per path sample.
    - `capacity`: room for crossings, as a share of the number of chords. What exceeds it is thinned at random without
      bias, with a warning.
    - `attached`: lobes narrower than this (radians, `BSDF.lobe_width`) hold their sampled directions fixed, as the
      camera does its rays: less noise the narrower they are, and edges between faces have to be found in them, too.
      0 for none. Which lobes are narrow should depend on the material alone.
    """

    chords: float = eqx.field(static=True, default=1.0)
    pilot: float = eqx.field(static=True, default=0.25)
    floor: float = eqx.field(static=True, default=0.2)
    reach: float = eqx.field(static=True, default=1.0)
    backgrounds: float = eqx.field(static=True, default=1.0)
    capacity: float = eqx.field(static=True, default=4.0)
    attached: float = eqx.field(static=True, default=0.0)

    def __check_init__(self):
        for name in ("chords", "floor", "reach", "backgrounds", "capacity"):
            if not getattr(self, name) > 0:
                raise ValueError(f"LineSampling: {name} must be positive, got {getattr(self, name)}")
        for name in ("pilot", "attached"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"LineSampling: {name} must not be negative, got {getattr(self, name)}")

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Prepared:
        """Ranks of the edges and the tree over them, once for a whole image. `moving`: which shapes can move."""
        edges, flags = packed.edges, jnp.asarray(moving)
        rank = jnp.where(flags[edges.shape], MOVES, BOUNDS)
        rank = jnp.where(never_silhouettes(packed), HIDES, rank).astype(packed.vertices.dtype)
        ranked = queries.EdgeSet.of(edges, rank)
        tree = queries.edge_tree(packed.geometry, ranked, packed.edge_counts, settings.rays)
        faces = np.diff(packed.first_face)
        still = faces[~np.asarray(moving)].sum()
        group = jnp.full(packed.faces.shape[0], -1, jnp.int32)
        if packed.has_area_emitters:
            group = emitter_groups(packed)
        folds = folded_edges(packed, flags, settings.rays) if self.attached > 0 else None
        count_layers = jnp.asarray(bool(still <= faces.sum() // 2))
        return Prepared(RankedEdges(rank, tree), group, flags, count_layers, folds)

    def estimate(
        self,
        packed: PackedScene,
        prepared: Prepared,
        primary: PrimarySamples,
        record: PathRecord,
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        settings: PathSettings,
    ) -> Float[Array, "N 3"]:
        """Boundary term of N paths: zero in value, right in derivative. `prepared` by `prepare`."""
        total = jnp.zeros_like(record.radiance)
        if record.direct is None:
            return total
        paths = PathSegments(packed, primary, record.direct, record.vertices)
        key_emitters, key_lobes = jax.random.split(key)
        throughput = luminance(paths.table.throughput)
        # In narrow lobes attached lines find all that emitter samples do not account for.
        wide = throughput if paths.narrow is None else jnp.where(paths.narrow, 0.0, throughput)
        emitters = lobes = skies = attached = None
        emitter_lines = EmitterLines(packed, prepared, paths, settings)
        lobe_lines = LobeLines(packed, prepared, paths, settings, self.reach)
        if packed.has_area_emitters:
            emitters = self._spread(emitter_lines, throughput, key_emitters)
        if packed.environment is not None or settings.max_depth > 2:
            carries = wide
            if packed.environment is None:  # nothing is gathered behind the last bounce
                carries = jnp.where(jnp.arange(paths.count) < paths.count - paths.paths, wide, 0.0)
            lobes = self._spread(lobe_lines, carries, key_lobes)
        if settings.mis and packed.has_varying_sky:
            sky_lines = SkyLines(packed, prepared, paths, settings)
            skies = self._spread(sky_lines, wide, jax.random.fold_in(key, 3))
            numbers = skies.expected * skies.kept, lobes.expected * lobes.kept
            sky_lines.both = lobe_lines.skies = SkyShare(packed, paths, self.reach, *numbers)
        if paths.narrow is not None:
            lines = AttachedLines(packed, prepared, paths, settings, self.reach, luminance(record.radiance).mean())
            narrow = jnp.where(paths.narrow, throughput, 0.0)
            attached = self._spread(lines, narrow, jax.random.fold_in(key, 2))
        if emitters is not None and lobes is not None and settings.mis:
            both = Centres(packed, prepared, paths, self.reach, emitters.expected, lobes.expected * lobes.kept)
            emitter_lines.both = lobe_lines.both = both
        for spread in (emitters, lobes, skies, attached):
            if spread is not None:
                total = total + self._term(spread)
        return total

    def _spread(self, lines: Lines, carries, key) -> Spread:
        """How many chords of one kind go where; `carries` is the importance of every path vertex."""
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
                score = lines.score(drawn, block) * (thinned / jnp.where(block.valid, carries[block.vertex], 1.0))
                score = jnp.where(block.valid & (number < used), score, 0.0)
                return jnp.zeros(chosen.vertex.shape[0], score.dtype).at[block.chord].add(score)

            per_chord = sum_over_blocks(scores, found, used)
            pixel = paths.path(jnp.maximum(chosen.vertex, 0)) // samples
            of_pixel = pixel_importance(per_chord, pixel, chosen.vertex >= 0, (height, width), self.floor)
            importance = stop_gradient(importance * of_pixel[None, :, None])
            if lines.traces_paths:
                kept = jnp.minimum(kept, self.backgrounds * self.pilot * paths.paths / jnp.maximum(used * thinned, 1))
        return Spread(lines, shares(importance, chords), kept, key_rest)

    def _term(self, spread: Spread) -> Float[Array, "N 3"]:
        """Boundary term of one kind of light."""
        lines, paths = spread.lines, spread.lines.paths
        key_main, key_chords, key_values = jax.random.split(spread.key, 3)
        chords = self.chords * paths.paths
        room = capacity(round(chords), spread.expected.shape[1])
        chosen = Chosen(*allocate(spread.expected, room, key_main))
        drawn, found, thinned, used = lines.search(chosen, key_chords, self._room(chords))
        found = found._replace(valid=found.valid & (jnp.arange(found.valid.shape[0]) < used))
        weight = thinned * chosen.inverse[found.chord]
        if found.share is not None:
            weight = weight * found.share
        if lines.traces_paths:
            key_kept, key_values = jax.random.split(key_values)
            found, weight, used = self._kept(lines, drawn, found, weight, used, key_kept)

        def values(block, number):
            block, weight = block
            block = block._replace(valid=block.valid & (number < used))
            value = lines.value(drawn, block, number, weight, key_values)
            return jnp.zeros((paths.paths, 3), value.dtype).at[paths.path(block.vertex)].add(value)

        return sum_over_blocks(values, (found, weight), used)

    def _kept(self, lines: Lines, drawn, found: Crossings, weight, used, key):
        """Crossings drawn in proportion to what they should contribute, their weights, and their number.

        The paths from behind them are what costs: there are as many as `backgrounds` asks for, whatever was found.
        """
        rows = -(-found.chord.shape[0] // ROW)
        room = rows * ROW

        def scores(block, number):
            block, weight = block
            return jnp.where(block.valid & (number < used), lines.score(drawn, block) * weight, 0.0)

        score = stop_gradient(map_over_blocks(scores, (found, weight), used))
        score = score + jnp.where(score > 0, self.floor * score.sum() / jnp.maximum((score > 0).sum(), 1), 0.0)
        count = self.backgrounds * lines.paths.paths
        expected = shares(jnp.pad(score, (0, room - score.shape[0])).reshape(1, rows, ROW), count)
        slot, inverse = allocate(expected, capacity(round(count), rows), key)
        kept = jax.tree.map(lambda table: table[jnp.maximum(slot, 0)], found)
        kept = kept._replace(valid=kept.valid & (slot >= 0))
        return kept, weight[jnp.maximum(slot, 0)] * inverse, (slot >= 0).sum()

    def _room(self, chords: float) -> int:
        return max(1024, round(self.capacity * chords))
