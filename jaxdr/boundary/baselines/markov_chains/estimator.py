"""Boundary segments by Markov chains (Xu et al. 2024): the term; docs/baselines.md."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.baselines.markov_chains.metropolis import Steps, run_chains
from jaxdr.boundary.baselines.markov_chains.segments import Space
from jaxdr.boundary.baselines.markov_chains.walks import EdgeRings, edge_rings
from jaxdr.boundary.guided_edges.beam import detect, moves
from jaxdr.boundary.guided_edges.boundary_segments import DirectionSampling, lines_past, segment_ends
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, edge_lunes
from jaxdr.boundary.guided_edges.flux_maps import FluxMaps, flux_maps
from jaxdr.boundary.guided_edges.guide_target import StrategyPlan
from jaxdr.boundary.guided_edges.seen_segments import DrawnSegments, ask_sources, seen_segments, segments_image
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.refusals import Asked, edge_refusals, perspective_refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.boundary.shared.traits import Traits, too_fine
from jaxdr.geometry.vector import norm
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.emission import emitted, has_emitters
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.radiance import Answers, Requests, joined

WALK = 4.0  # the longest walk, in mean lengths of edges


class MarkovChainsState(NamedTuple):
    """The edges, their rings around vertices, which shapes move, maps of indirect light, and the longest walk."""

    lunes: EdgeLunes
    rings: EdgeRings
    moving: Bool[Array, " S"]
    maps: FluxMaps | None
    reach: Float[Array, ""]


@checked
class MarkovChains(eqx.Module):
    """Boundary segments by Markov chains that walk along silhouettes, from edge to edge; for comparison. Unbiased.

    Chains are started anew for every chunk of samples, from independent segments (`seeds`). Their states have a density
    in proportion to the light that they send to the film (Xu et al. 2024). Every proposed state is splatted. All fields
    are static.

    - `samples`: steps for each path sample, of all chains together.
    - `length`: steps of a chain.
    - `large`: probability of a step that forgets where the chain is.
    - `seeds`: independent segments for each step, of which chains start from the brighter ones.

    Raises ValueError for options out of range.
    """

    samples: float = eqx.field(static=True, default=1.0)
    length: int = eqx.field(static=True, default=32)
    large: float = eqx.field(static=True, default=0.3)
    seeds: float = eqx.field(static=True, default=1.0)

    name = "boundary"

    refusals = (*edge_refusals("MarkovChains"), perspective_refusal("MarkovChains"))

    def __check_init__(self):
        if not (self.samples > 0 and self.seeds > 0 and self.length >= 1):
            raise ValueError("MarkovChains: samples, seeds and length must be positive")
        if not 0 <= self.large <= 1:
            raise ValueError(f"MarkovChains: large must be a probability, got {self.large}")

    def known_failure(self, found: Traits) -> str | None:
        """See `jaxdr.boundary.shared.traits`."""
        return too_fine(found)

    def prepare(self, context: Context, key: PRNGKeyArray) -> MarkovChainsState | None:
        """Edges, and maps for indirect light. Raises ValueError for scenes that the estimator does not cover."""
        refuse(self.refusals, Asked(context.packed, context.settings))
        packed, settings = jax.tree.map(stop_gradient, context.packed), context.settings
        if _plan(packed, settings) is None:
            return None
        lunes = edge_lunes(packed, context.moving.seen)
        maps = _everywhere(flux_maps(packed, key, settings)) if settings.max_depth > 2 else None
        counts = lunes.density > 0
        reach = WALK * jnp.where(counts, norm(lunes.side), 0.0).sum() / jnp.maximum(counts.sum(), 1)
        return MarkovChainsState(lunes, edge_rings(lunes), jnp.asarray(context.moving.seen), maps, reach)

    def draw(
        self, context: Context, state: MarkovChainsState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, DrawnSegments]:
        """The states of chains, and requests for what their sources scatter."""
        packed, settings, lunes = context.packed, context.settings, state.lunes
        key_chains, key_detector, key_source = jax.random.split(key, 3)
        chains = max(1, round(chunk.paths * self.samples / self.length))
        steps = Steps(chains, self.length, max(1, round(chains * self.length * self.seeds)), self.large)
        space = space_of(context, state)
        plan, visits = space.plan, run_chains(space, steps, key_chains).visits
        visits = jax.tree.map(lambda table: table.reshape(-1, *table.shape[2:]), visits)
        used = (visits.weight > 0).sum()
        slots = rows_where(visits.weight > 0)

        def rows(slot, place):
            visit = jax.tree.map(lambda table: table[slot], visits)
            segments = lines_past(lunes, visit.point, visit.towards)
            ends = segment_ends(packed, segments, place < used, settings.rays)
            ends = ends._replace(valid=ends.valid & moves(packed, state.moving, lunes, segments, ends))
            seen = detect(packed, segments, ends, visit.weight, slot, key_detector, settings)
            share, sent = lunes.share[segments.point.row], jnp.zeros_like(segments.towards)
            share = jnp.broadcast_to(share, seen.value.shape[:2])
            if plan.emission:
                sent = emitted(packed, ends.source, -segments.towards)
            row = seen_segments(segments, ends, seen, sent, share, share)
            return ask_sources(row, slot, self.name, key_source, settings.max_depth) if plan.gathered else [], row

        asked, found = map_over_blocks(rows, slots, used)
        return joined(asked) if asked else None, DrawnSegments(found, used)

    def image(
        self,
        context: Context,
        state: MarkovChainsState,
        chunk: Chunk,
        held: DrawnSegments,
        answers: Answers | None,
    ) -> Float[Array, "H W 3"]:
        """Boundary term, an estimate of the whole film by itself: zero in value, right in derivative."""
        scattered = None if answers is None else answers.total
        return chunk.share * segments_image(context.packed, state.lunes, held, scattered, context.form)


def space_of(context: Context, state: MarkovChainsState) -> Space:
    """What chains live in. There is light, else there would be no state."""
    plan = _plan(context.packed, context.settings)
    assert plan is not None
    return Space(
        context.packed, state.lunes, state.rings, state.moving, state.maps, state.reach, plan, context.settings
    )


def _plan(packed: PackedScene, settings: PathSettings) -> StrategyPlan | None:
    """Which light counts; None if there is none behind the first hit."""
    emission, gathered = packed.has_area_emitters or packed.environment is not None, settings.max_depth > 2
    if settings.max_depth == 1 or not has_emitters(packed) or not (emission or gathered):
        return None
    return StrategyPlan(DirectionSampling, emission, gathered)


def _everywhere(maps: FluxMaps) -> FluxMaps:
    """The same maps, or ones where no cell has anything: chains must be able to go wherever light may be."""
    radiance, importance = (jnp.where(table.max() > 0, table, 1.0) for table in (maps.radiance, maps.importance))
    return maps._replace(radiance=radiance, importance=importance)
