"""The lines of all plans in one table: one program traces them, and weighs them by the balance heuristic (Eq. 15)."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.guided_edges.boundary_segments import BoundaryEnds, BoundarySegments, segments
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, acceptance
from jaxdr.boundary.guided_edges.guide_target import StrategyPlan
from jaxdr.boundary.guided_edges.primary_guides import Defended
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.sampler import lattice


class PlanLines(NamedTuple):
    """n lines: first those of the first plan, then those of the second if there is one.

    - `counts`: lines of each plan. `tried`: lines that each plan draws for one segment.
    - `primary`: three primary numbers, and one that decides whether a silhouette is kept.
    """

    packed: PackedScene
    lunes: EdgeLunes
    plans: tuple[StrategyPlan, ...]
    guides: tuple[Defended, ...]
    counts: tuple[int, ...]
    tried: tuple[float, ...]
    primary: Float[Array, "n 4"]

    def of_plan(self, line: Int[Array, " m"], values: Sequence) -> Array:
        """What the plan of each line has, among the `values` of all plans: numbers, flags or arrays [m]."""
        first = jnp.broadcast_to(values[0], line.shape)
        return first if len(values) == 1 else jnp.where(line < self.counts[0], first, values[1])

    def segments(self, line: Int[Array, " m"]) -> BoundarySegments:
        """Lines by their numbers."""
        by = None if len(self.plans) == 1 else self.of_plan(line, range(len(self.plans)))
        strategies = [plan.strategy for plan in self.plans]
        return segments(self.packed, self.lunes, strategies, self.primary[line, :3], by)

    def kept(self) -> Bool[Array, " n"]:
        """Which lines become segments: silhouettes, with the probability `acceptance`."""
        line = jnp.arange(self.primary.shape[0])
        drawn = self.segments(line)
        chance = self.of_plan(line, [acceptance(self.lunes, drawn.point.row, t) for t in self.tried])
        return drawn.silhouette & (self.primary[:, 3] < chance)

    def densities(
        self, line: Int[Array, " m"], drawn: BoundarySegments, ends: BoundaryEnds
    ) -> list[Float[Array, " m"]]:
        """Expected number of segments of each plan, per length of edge and solid angle, at given segments."""
        found, own = [], self.primary[line, :3]
        for number, (plan, guide) in enumerate(zip(self.plans, self.guides, strict=True)):
            u = own
            if len(self.plans) > 1:
                mine = self.of_plan(line, [number == 0, number == 1])
                u = jnp.where(mine[:, None], own, plan.strategy.numbers(self.packed, self.lunes, drawn, ends))
            expected = guide.pdf(u, self.counts[number]) * self.counts[number]
            expected *= acceptance(self.lunes, drawn.point.row, self.tried[number])
            found.append(plan.strategy.density(self.packed, self.lunes, drawn, ends) * expected)
        return found


def plan_lines(
    packed: PackedScene,
    lunes: EdgeLunes,
    plans: tuple[StrategyPlan, ...],
    guides: tuple[Defended, ...],
    tried: tuple[float, ...],
    wanted: float,
    key: PRNGKeyArray,
) -> PlanLines:
    """Lines for `wanted` segments of each plan; fewer where less than one is tried for each."""
    counts = tuple(max(1, round(wanted * t)) for t in tried)
    primary = []
    for number, (guide, count) in enumerate(zip(guides, counts, strict=True)):
        # A lattice in four dimensions: the lattice in three has gaps into which shadows can fall.
        u = lattice(jax.random.fold_in(key, number), 1, jnp.arange(count), 4, packed.vertices.dtype)
        primary.append(jnp.concatenate([guide.sample(u[:, :3]), u[:, 3:]], -1))
    return PlanLines(packed, lunes, plans, guides, counts, tried, jnp.concatenate(primary))
