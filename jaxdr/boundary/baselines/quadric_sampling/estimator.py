"""Edge sampling with silhouettes drawn from a tree (Li et al. 2018; Soroka et al. 2025); docs/baselines.md."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.baselines.quadric_sampling.importance import Balls, Importance, emitter_balls
from jaxdr.boundary.baselines.quadric_sampling.silhouette_tree import (
    NUMBERS,
    SilhouetteTree,
    draw_edges,
    silhouette_tree,
)
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, edge_lunes, passing
from jaxdr.boundary.shared.background import BehindEdges, EdgeSamples, image_past, look_past, seen_edges
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.edge_angles import on_edges
from jaxdr.boundary.shared.path_segments import PathSegments, path_segments
from jaxdr.boundary.shared.refusals import Asked, edge_refusals, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.safe_divide import safe_divide
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.radiance import Answers, Requests
from jaxdr.transport.sampler import lattice


class QuadricSamplingState(NamedTuple):
    """The edges, the tree over them, and balls around the emitters."""

    lunes: EdgeLunes
    tree: SilhouetteTree
    balls: Balls | None


@checked
class QuadricSampling(eqx.Module):
    """Every path vertex looks past silhouette edges that it draws from a tree; for comparison. Unbiased.

    The tree's nodes bound the planes of the faces at their edges, in dual space. So a random descent leaves out nodes
    without silhouettes (Soroka et al. 2025). All fields are static.

    - `samples`: edges that every path vertex draws.

    Raises ValueError for options out of range.
    """

    samples: int = eqx.field(static=True, default=1)

    name = "boundary"

    refusals = edge_refusals("QuadricSampling")

    def __check_init__(self):
        if self.samples < 1:
            raise ValueError(f"QuadricSampling: samples must be at least 1, got {self.samples}")

    def prepare(self, context: Context, key: PRNGKeyArray) -> QuadricSamplingState:
        """The tree. Raises ValueError for scenes that the estimator does not cover."""
        del key
        refuse(self.refusals, Asked(context.packed, context.settings))
        packed = jax.tree.map(stop_gradient, context.packed)
        lunes = edge_lunes(packed, context.moving.seen)
        return QuadricSamplingState(lunes, silhouette_tree(packed, lunes), emitter_balls(packed))

    def draw(
        self, context: Context, state: QuadricSamplingState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, BehindEdges | None]:
        """Points on silhouettes, and requests for the radiance of what is seen just past them."""
        if chunk.record.direct is None:  # paths of one segment don't scatter
            return None, None
        paths = path_segments(context.packed, chunk, "direct", differentiated=False)
        key_points, key_paths = jax.random.split(key)
        samples = self._samples(context, state, paths, key_points)
        used = (samples.weight > 0).sum()
        slots = rows_where(samples.weight > 0, samples.weight.shape[0])

        def look(slot, number):
            row = jax.tree.map(lambda table: table[slot], samples)
            return look_past(context, paths, row, number < used, key_paths, self.name)

        asked, behind = map_over_blocks(look, slots, used)
        return asked, BehindEdges(behind, used)

    def image(
        self,
        context: Context,
        state: QuadricSamplingState,
        chunk: Chunk,
        held: BehindEdges | None,
        answers: Answers | None,
    ) -> Float[Array, "H W 3"]:
        """Radiance that moving silhouettes cover or uncover: zero in value, right in derivative."""
        return image_past(context, chunk, held, answers)

    def _samples(self, context: Context, state: QuadricSamplingState, paths: PathSegments, key) -> EdgeSamples:
        """Edges for all path vertices, a point on each, and the weight: an angle over the density. Zero: no silhouette.

        Edges have the probability of their descent, points a density per angle of the edge as the vertex sees it.
        """
        packed, lunes = context.packed, state.lunes
        number = jnp.arange(self.samples * paths.count)
        vertex = number % paths.count
        u = lattice(key, 1, number, NUMBERS + 1, lunes.start.dtype)
        scatterer = paths.scatterer(vertex)
        scattered = vertex < paths.count - paths.paths  # the last vertex of a path gathers direct light alone
        other = jnp.full(vertex.shape, True) if packed.environment is not None else scattered
        drawn = draw_edges(state.tree, Importance(scatterer, state.balls, other), u[:, :NUMBERS])
        there, edge = drawn.edge >= 0, jnp.maximum(drawn.edge, 0)
        along, angle = on_edges(packed.ends_of(edge), scatterer.point.position, u[:, NUMBERS])
        seen = seen_edges(packed, paths, vertex, edge, along, there)
        silhouette = passing(lunes, edge, seen.towards).silhouette
        carries = (paths.table.throughput[vertex] != 0).any(-1)
        counts = there & silhouette & carries & scatterer.above_horizon(seen.edge_point)
        weight = safe_divide(angle * lunes.share[edge], drawn.probability * self.samples, counts)
        return EdgeSamples(vertex, edge, along, jnp.where(counts, weight, 0.0), number)
