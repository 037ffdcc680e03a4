"""Boundary segments from edges, in the middle of paths (Zhang et al. 2020; Yan et al. 2022); docs/guided_edges.md."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.guided_edges.beam import detect, moves
from jaxdr.boundary.guided_edges.boundary_segments import DirectionSampling, EmitterSampling, segment_ends
from jaxdr.boundary.guided_edges.edge_chains import EdgeOrder, chain_edges
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, edge_lunes
from jaxdr.boundary.guided_edges.flux_maps import flux_maps
from jaxdr.boundary.guided_edges.guide_target import StrategyPlan, segment_target
from jaxdr.boundary.guided_edges.kdtree_guide import build_kdtree, root_borders
from jaxdr.boundary.guided_edges.plan_lines import plan_lines
from jaxdr.boundary.guided_edges.primary_guides import Defended, Guide, Target, Unguided, build_grid, defended
from jaxdr.boundary.guided_edges.projected_paths import project_paths
from jaxdr.boundary.guided_edges.seeded_tree import SEEDS, build_seeded_tree
from jaxdr.boundary.guided_edges.seen_segments import DrawnSegments, ask_sources, seen_segments, segments_image
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.kinds import KINDS, LIGHTS, asked_for, of_kind, present
from jaxdr.boundary.shared.refusals import Asked, edge_refusals, perspective_refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits, too_fine
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import kept_rows
from jaxdr.transport.emission import emitted, has_emitters
from jaxdr.transport.keys import fixed_key
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.radiance import Answers, Requests, joined

# Lines that are tried towards emitters for one segment: the share of silhouettes among edges falls with the square root
# of their number. A tenth of the root is a compromise: of 1, 4 and 16 tries one was best where other terms have the
# noise, four for the README's shadow (1,922 edges), 16 for that of a scan (8,283 edges).
TRIED, MOST_TRIED = 0.1, 16.0
MOST_LINES = 1 << 22  # in a chunk: they are tried at once, and take some hundred bytes each
# Segments by direction for direct light, relative to `samples`.
BESIDES = 0.125


class GuidedEdgesState(NamedTuple):
    """State for all chunks of an image: the edges, which shapes move, a guide for every plan, `order` if sorted."""

    lunes: EdgeLunes
    moving: Bool[Array, " S"]
    guides: tuple[Defended, ...]
    order: EdgeOrder | None = None


@checked
class GuidedEdges(eqx.Module):
    """Boundary term from segments that are drawn on edges. All fields are static.

    It is unbiased with every guide. Contributions are splatted onto the film.

    - `guide`: where segments are drawn. "none"; "grid", a regular grid over edges and directions (Zhang et al. 2020);
      "kdtree", trees with trilinear fits (Yan et al. 2022, 4.1); "projective", a tree around paths that are projected
      to silhouettes (Zhang et al. 2023), for small emitters. It is built once for every image. At least a tenth of the
      segments is drawn without it.
    - `sampling`: "emitter" draws segments towards emitters for their light, and segments by direction for other light.
      "direction" draws all by direction. "mis" draws segments for the emitters' light by both (Yan et al. 2022, 4.2).
    - `samples`: segments per path sample and strategy. Without a guide most lines towards emitters pass edges that are
      no silhouettes, and cost little. So there are more of them, the more edges a scene has (`TRIED`). With "mis",
      direct light has fewer segments by direction (`BESIDES`): they only help where an emitter is large and near.
    - `cells`: numbers of cells of a grid along the edges and along both numbers of the direction.
    - `leaves`: about how many leaves all kd-trees of a strategy have together. A projective guide has about a quarter
      of that, rounded to a power of two.
    - `guide_samples`: evaluations in every cell of a grid, node of a kd-tree, or leaf of a projective guide.
    - `threshold`: leaves are split while their error is above this share of the mean leaf's mass.
    - `sort`: put the edges into long chains (Yan et al. 2022, 4.3), so that a guide's target has fewer jumps.

    Raises ValueError for options out of range.
    """

    guide: Literal["none", "grid", "kdtree", "projective"] = eqx.field(static=True, default="none")
    sampling: Literal["emitter", "direction", "mis"] = eqx.field(static=True, default="mis")
    samples: float = eqx.field(static=True, default=1.0)
    cells: tuple[int, int, int] = eqx.field(static=True, default=(1024, 8, 8))
    leaves: int = eqx.field(static=True, default=4096)
    guide_samples: int | None = eqx.field(static=True, default=None)
    threshold: float = eqx.field(static=True, default=0.1)
    sort: bool = eqx.field(static=True, default=False)

    name, takes_kinds = "boundary", True

    refusals = (*edge_refusals("GuidedEdges"), perspective_refusal("GuidedEdges"))

    def __check_init__(self):
        guides = "none", "grid", "kdtree", "projective"
        for name, known in (("sampling", ("emitter", "direction", "mis")), ("guide", guides)):
            if getattr(self, name) not in known:
                raise ValueError(f"GuidedEdges: {name} must be one of {', '.join(known)}; got {getattr(self, name)!r}")
        if not (self.samples > 0 and self.threshold > 0):
            raise ValueError("GuidedEdges: samples and threshold must be positive")
        if min(*self.cells, self.leaves) < 1:
            raise ValueError(f"GuidedEdges: need three cells and leaves, 1 or more, got {self.cells} and {self.leaves}")
        if self.guide_samples is not None and self.guide_samples < 1:
            raise ValueError(f"GuidedEdges: guide_samples must be at least 1, got {self.guide_samples}")

    def plans(
        self, packed: PackedScene, settings: PathSettings, kinds: tuple[str, ...] = KINDS
    ) -> tuple[StrategyPlan, ...]:
        """The strategies that this scene needs at this depth, for these kinds of segments."""
        kinds = present(packed, settings.max_depth, kinds)
        indirect = asked_for(kinds, "scattered")
        glows = asked_for(kinds, "emitters") or asked_for(kinds, "environment")
        plans = []
        if glows and self.sampling != "direction":
            plans.append(StrategyPlan(EmitterSampling, True, False))
        by_direction = glows and self.sampling != "emitter"
        if by_direction or indirect:
            plans.append(StrategyPlan(DirectionSampling, by_direction, indirect))
        return tuple(plans) if settings.max_depth > 1 and has_emitters(packed) else ()

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`."""
        return too_fine(found)

    def prepare(self, context: Context, key: PRNGKeyArray) -> GuidedEdgesState:
        """Edges and guides. Raises ValueError for scenes that the estimator does not cover."""
        del key  # all images of the same scene have the same guide
        return self.build(context.packed, context.moving.seen, context.settings, context.kinds)

    def build(
        self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings, kinds: tuple[str, ...] = KINDS
    ) -> GuidedEdgesState:
        """Edges and guides where the shapes `moving` can move. Raises ValueError like `prepare`."""
        refuse(self.refusals, Asked(packed, settings))
        detached = jax.tree.map(stop_gradient, packed)
        lunes, flags, order = edge_lunes(packed, moving), jnp.asarray(moving), None
        if self.sort:
            order = chain_edges(detached.vertices, detached.edges.vertices, lunes.density > 0)
            lunes = edge_lunes(packed, moving, order)
        # A fixed key, independent of the image's.
        key_maps, *keys = jax.random.split(fixed_key(0), 3)
        lines = None
        if self.guide == "projective":
            key_paths = jax.random.fold_in(key_maps, 1)
            lines = project_paths(detached, lunes, SEEDS * self._powers, key_paths, settings.rays)
        target = self._targets(detached, lunes, flags, key_maps, settings)

        def guide(plan: StrategyPlan, key) -> Defended:
            seeds = None if lines is None else (plan.strategy.numbers(detached, lunes, *lines), lines[1].valid)
            return self._defended(self._guide(target(plan, key), lunes, seeds, key), target(plan, key), packed, key)

        plans = self.plans(packed, settings, kinds)
        guides = tuple(guide(plan, key) for plan, key in zip(plans, keys, strict=False))
        return GuidedEdgesState(lunes, flags, guides, order)

    def _targets(
        self, detached: PackedScene, lunes: EdgeLunes, moving: Bool[Array, " S"], key, settings: PathSettings
    ) -> Callable[[StrategyPlan, PRNGKeyArray], Target]:
        """The target of each plan's guide."""
        maps = flux_maps(detached, key, settings) if self.guide != "none" and settings.max_depth > 2 else None

        def target(plan: StrategyPlan, key: PRNGKeyArray) -> Target:
            return segment_target(detached, lunes, moving, maps, plan, key, settings)

        return target

    def refit(
        self,
        packed: PackedScene,
        moving: tuple[bool, ...],
        settings: PathSettings,
        guides: tuple[Defended, ...],
        order: EdgeOrder | None,
        key: PRNGKeyArray,
    ) -> tuple[Defended, ...]:
        """Keep the boxes of the guides and fit their densities to the current scene. Raises like `prepare_with`."""
        plans = self._plans_of(packed, settings, guides)
        detached = jax.tree.map(stop_gradient, packed)
        key_maps, *keys = jax.random.split(key, 3)
        target = self._targets(detached, edge_lunes(packed, moving, order), jnp.asarray(moving), key_maps, settings)

        def refitted(plan: StrategyPlan, old: Defended, key) -> Defended:
            new = old.guide.refitted(target(plan, key), self._evaluations, key)
            return self._defended(new, target(plan, key), packed, key)

        return tuple(refitted(*row) for row in zip(plans, guides, keys, strict=False))

    def prepare_with(
        self,
        packed: PackedScene,
        moving: tuple[bool, ...],
        settings: PathSettings,
        guides: tuple[Defended, ...],
        order: EdgeOrder | None,
    ) -> GuidedEdgesState:
        """`build` with guides that were built for other positions of the same meshes.

        Raises ValueError like `build`, and if the number of guides is not the number of strategies.
        """
        self._plans_of(packed, settings, guides)
        return GuidedEdgesState(edge_lunes(packed, moving, order), jnp.asarray(moving), guides, order)

    def _plans_of(self, packed: PackedScene, settings: PathSettings, guides: tuple) -> tuple[StrategyPlan, ...]:
        """The plans that guides were built for. Raises ValueError if this scene needs another number of plans."""
        refuse(self.refusals, Asked(packed, settings))
        plans = self.plans(packed, settings)
        if len(plans) != len(guides):
            raise ValueError(
                f"render: guides were built for {len(guides)} strategies, and this scene at max_depth="
                f"{settings.max_depth} needs {len(plans)}; build them for it with build_guides"
            )
        return plans

    @property
    def _evaluations(self) -> int:
        """Evaluations of the target for every box."""
        return self.guide_samples or {"none": 0, "grid": 4, "kdtree": 32, "projective": 16}[self.guide]

    @property
    def _powers(self) -> int:
        """Leaves of a projective guide."""
        return 1 << max(1, self.leaves.bit_length() - 3)

    def _defended(self, guide: Guide, target: Target, packed: PackedScene, key) -> Defended:
        dtype = packed.vertices.dtype
        if self.guide == "none":
            return Defended(guide, jnp.asarray(1.0, dtype))
        return defended(guide, target, jax.random.fold_in(key, 1), dtype)

    def _guide(
        self,
        target: Target,
        lunes: EdgeLunes,
        seeds: tuple[Float[Array, "n 3"], Bool[Array, " n"]] | None,
        key: PRNGKeyArray,
    ) -> Guide:
        """The guide of one strategy; `seeds` are primary numbers of projected paths, and which of them are usable."""
        if self.guide == "grid":
            return build_grid(target, self.cells, self._evaluations, key)
        if self.guide == "kdtree":
            borders = root_borders(lunes.cdf, max(1, self.leaves // 4))
            return build_kdtree(target, borders, self.leaves, self._evaluations, self.threshold)
        if seeds is not None:
            edges = lunes.edge.shape[0]
            return build_seeded_tree(target, *seeds, edges, self._powers, self._evaluations, key)
        return Unguided()

    def draw(
        self, context: Context, state: GuidedEdgesState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, DrawnSegments | None]:
        """Segments of all strategies, and requests for what their sources scatter."""
        packed, settings, lunes = context.packed, context.settings, state.lunes
        kinds = context.kinds
        plans, wanted = self.plans(packed, settings, kinds), chunk.paths * self.samples
        if not plans:
            return None, None
        key_segments, key_detector, key_source, key_kept = jax.random.split(key, 4)
        tried = tuple(self._tried(packed, plan, chunk.paths) for plan in plans)
        room = sum(max(1, round(wanted * min(t, 1.0))) for t in tried)
        lines = plan_lines(packed, lunes, plans, state.guides, tried, wanted, key_segments)
        # For most lines towards emitters the edge is not a silhouette. The other lines are moved to the front.
        slots, used, thinned = kept_rows(lines.kept(), room, key_kept)
        emission, gathered = [plan.emission for plan in plans], [plan.gathered for plan in plans]

        def rows(line, place):
            drawn = lines.segments(line)
            ends = segment_ends(packed, drawn, place < used, settings.rays)
            ends = ends._replace(valid=ends.valid & moves(packed, state.moving, lunes, drawn, ends))
            densities = lines.densities(line, drawn, ends)
            seen = detect(packed, drawn, ends, jnp.full(line.shape, thinned), line, key_detector, settings)
            share, lit = lunes.share[drawn.point.row], (seen.value != 0).any(-1)

            def inverse(counts: list[bool], asked: Bool[Array, "*#B m"] | bool) -> Float[Array, "B m"]:
                """The share of the jump over the density of all plans that count; zero at lines of other plans."""
                if not any(counts):
                    return jnp.zeros_like(lit, share.dtype)
                density = sum(d for d, c in zip(densities, counts, strict=True) if c)
                there = (density > 0) & lines.of_plan(line, counts)
                return jnp.where(lit & asked, safe_divide(share, density, there, 0.0), 0.0)

            assert seen.lobe is not None  # `detect` finds it
            asked = {light: of_kind(kinds, light, seen.lobe) for light in LIGHTS}
            lamps = inverse(emission, jnp.where(ends.source.valid, asked["emitters"], asked["environment"]))
            sent = emitted(packed, ends.source, -drawn.towards) if any(emission) else jnp.zeros_like(drawn.towards)
            row = seen_segments(drawn, ends, seen, sent, lamps, inverse(gathered, asked["scattered"]))
            if not any(gathered):
                return [], row
            return ask_sources(row, line, self.name, key_source, settings.max_depth), row

        asked, found = map_over_blocks(rows, slots, used)
        return joined(asked) if asked else None, DrawnSegments(found, used)

    def image(
        self,
        context: Context,
        state: GuidedEdgesState,
        chunk: Chunk,
        held: DrawnSegments | None,
        answers: Answers | None,
    ) -> Float[Array, "H W 3"]:
        """Boundary term, an estimate of the whole film by itself: zero in value, right in derivative."""
        packed = context.packed
        if held is None:
            _, _, width, height = packed.camera.film.window
            return jnp.zeros((height, width, 3), packed.vertices.dtype)
        scattered = None if answers is None else answers.total
        return chunk.share * segments_image(packed, state.lunes, held, scattered, context.form)

    def _tried(self, packed: PackedScene, plan: StrategyPlan, paths: int) -> float:
        """Lines that a plan draws for one segment."""
        if self.guide != "none":
            return 1.0
        if plan.strategy.samples_emitters:
            edges = packed.edges.vertices.shape[0]
            return max(min(TRIED * edges**0.5, MOST_TRIED, MOST_LINES / (paths * self.samples)), 1.0)
        return BESIDES if self.sampling == "mis" and not plan.gathered else 1.0
