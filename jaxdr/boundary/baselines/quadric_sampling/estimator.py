"""Edge sampling with silhouettes drawn from a tree (Li et al. 2018; Soroka et al. 2025); docs/baselines.md."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.baselines.quadric_sampling.importance import Balls, Importance, emitter_balls
from jaxdr.boundary.baselines.quadric_sampling.silhouette_tree import (
    NUMBERS,
    SilhouetteTree,
    draw_edges,
    silhouette_tree,
)
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, edge_lunes, passing
from jaxdr.boundary.shared.background import (
    BehindEdges,
    ask_behind,
    look_behind,
    numbers_behind,
    seen_edges,
    sum_behind,
)
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.path_segments import PathSegments, path_segments
from jaxdr.boundary.shared.refusals import Asked, edge_refusals, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.geometry.vector import corners, dot, norm, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.radiance import Answers, Requests
from jaxdr.transport.sampler import lattice

SHORT = 1e-3  # edges that are seen under less are drawn evenly over their length: sines would cancel


class QuadricSamplingState(NamedTuple):
    """The edges, the tree over them, and balls around the emitters."""

    lunes: EdgeLunes
    tree: SilhouetteTree
    balls: Balls | None


class _Points(NamedTuple):
    """Points on edges in slots: the path vertex, the edge, the fraction along it, and the weight."""

    vertex: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    weight: Float[Array, " C"]


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
        packed, settings = context.packed, context.settings
        paths = path_segments(packed, chunk, "direct", differentiated=False)
        key_points, key_paths = jax.random.split(key)
        points = self._points(context, state, paths, key_points)
        used = (points.weight > 0).sum()
        slots = rows_where(points.weight > 0, points.weight.shape[0])

        def look(slot, number):
            row = jax.tree.map(lambda table: table[slot], points)
            valid = number < used
            seen = seen_edges(packed, paths, row.vertex, row.edge, row.along, valid)
            weight = scale(paths.table.throughput[row.vertex], row.weight)
            behind, background = look_behind(packed, paths.scatterer(row.vertex), seen, weight, valid, settings)
            numbers = numbers_behind(key_paths, self.name, slot, row.weight.dtype)
            return ask_behind(paths, seen, background, numbers, 1.0, settings), behind

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
        total = jnp.zeros_like(chunk.record.radiance)
        if held is not None and answers is not None:
            paths = path_segments(context.packed, chunk, "direct")
            total = sum_behind(context.packed, paths, held, answers.total)
        return chunk.image(context.packed, total)

    def _points(self, context: Context, state: QuadricSamplingState, paths: PathSegments, key) -> _Points:
        """Edges for all path vertices, a point on each, and the weight: an angle over the density. Zero: no silhouette.

        Edges have the probability of their descent, points a density per angle of the edge as the vertex sees it.
        """
        packed, lunes = context.packed, state.lunes
        number = jnp.arange(self.samples * paths.count)
        vertex = number % paths.count
        u = lattice(key, 1, number, NUMBERS + 1, lunes.start.dtype)[0]
        scatterer = paths.scatterer(vertex)
        scattered = vertex < paths.count - paths.paths  # the last vertex of a path gathers direct light alone
        other = jnp.full(vertex.shape, True) if packed.environment is not None else scattered
        drawn = draw_edges(state.tree, Importance(scatterer, state.balls, other), u[:, :NUMBERS])
        there, edge = drawn.edge >= 0, jnp.maximum(drawn.edge, 0)
        along, angle = _on_edges(packed, edge, scatterer.point.position, u[:, NUMBERS])
        seen = seen_edges(packed, paths, vertex, edge, along, there)
        silhouette = passing(lunes, edge, seen.towards).silhouette
        carries = (paths.table.throughput[vertex] != 0).any(-1)
        counts = there & silhouette & carries & scatterer.above_horizon(seen.edge_point)
        weight = safe_divide(angle * lunes.share[edge], drawn.probability * self.samples, counts)
        return _Points(vertex, edge, along, jnp.where(counts, weight, 0.0))


def _on_edges(
    packed: PackedScene, edge: Int[Array, " n"], apex: Float[Array, "n 3"], u: Float[Array, " n"]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """(fractions along edges, angles over the density of the points).

    At the distance h of the apex from the edge's line, a point at the angle a from the line's foot contributes in
    proportion to cos a da: a length of the edge is seen as an angle, and its motion is seen slower the farther it is.
    So sin a is drawn evenly. A short edge is drawn evenly over its length.
    """
    start, end = corners(packed.ends_of(edge))
    side = end - start
    length = norm(side)
    tangent = scale(side, 1.0 / jnp.where(length > 0, length, 1.0))
    first = dot(start - apex, tangent)
    across = start - apex - scale(tangent, first)
    height = norm(across)
    reach0, reach1 = jnp.hypot(first, height), jnp.hypot(first + length, height)
    there = (height > 0) & (length > 0)
    sine0 = safe_divide(first, reach0, there, 0.0)
    sine1 = safe_divide(first + length, reach1, there, 0.0)
    long = there & (sine1 - sine0 > SHORT)
    sine = sine0 + u * (sine1 - sine0)
    cosine = jnp.sqrt(jnp.maximum((1.0 - sine) * (1.0 + sine), 0.0))
    along = (safe_divide(height * sine, cosine, long & (cosine > 0)) - first) / jnp.where(length > 0, length, 1.0)
    along = jnp.where(long, jnp.clip(along, 0.0, 1.0), u)
    distance = jnp.hypot(first + along * length, height)
    evenly = safe_divide(length * height, distance * distance, there, 0.0)
    return along, jnp.where(long, safe_divide(sine1 - sine0, cosine, cosine > 0), evenly)
