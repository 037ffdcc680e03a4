"""Edge sampling (Li et al. 2018): a boundary estimator in one file, explained in docs/write_an_estimator.md."""

import equinox as eqx
import jax
import jax.numpy as jnp

import jaxdr as jd
from jaxdr.boundary.shared.background import (
    Behind,
    ask_behind,
    background_values,
    look_behind,
    numbers_behind,
    seen_edges,
)
from jaxdr.boundary.shared.path_segments import path_segments
from jaxdr.geometry.vector import normalize


class UniformEdges(eqx.Module):
    """Every path vertex looks past `points` points that are uniform over the length of all edges. Unbiased."""

    points: int = eqx.field(static=True, default=1)
    name = "boundary"

    def prepare(self, context: jd.Context, key: jax.Array) -> jax.Array:
        """Lengths of all edges, added up, [E]. Raises ValueError for mirrors and smooth glass."""
        packed = context.packed
        if packed.has_delta_lobes:
            raise ValueError("UniformEdges: no edge is found in mirrors or behind smooth glass; take KernelDensity")
        ends = packed.vertices[packed.edges.vertices]
        return jnp.cumsum(jnp.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1))

    def draw(
        self, context: jd.Context, state: jax.Array, chunk: jd.Chunk, key: jax.Array
    ) -> tuple[jd.Requests | None, Behind | None]:
        """Points on silhouettes, and requests for the radiance of what is seen just past them."""
        if chunk.record.direct is None:  # paths of one segment don't scatter
            return None, None
        packed, settings = context.packed, context.settings
        paths = path_segments(packed, chunk, "direct")
        key_points, key_paths = jax.random.split(key)
        number = jnp.arange(self.points * paths.count)
        vertex = number % paths.count
        u = jax.random.uniform(key_points, (2, number.size), state.dtype)
        edge = jnp.minimum(jnp.searchsorted(state, u[0] * state[-1], side="right"), state.size - 1)
        seen = seen_edges(packed, paths, vertex, edge, u[1], jnp.ones(number.shape, bool))

        # A length of edge is seen as the angle length x sine / distance; points have the density 1 / total length.
        ends = packed.vertices[packed.edges.vertices[edge]]
        along = normalize(ends[:, 1] - ends[:, 0])
        sine = jnp.linalg.norm(jnp.cross(along, seen.towards), axis=-1)
        weight = packed.edges.shared(edge, state[-1] * sine / seen.distance / self.points)
        weight = weight[:, None] * paths.table.throughput[vertex]

        # A silhouette has all its faces on one side of the plane through it and the path vertex.
        corners = packed.vertices[packed.edges.opposite[edge]]
        height = jnp.einsum("nki,ni->nk", corners - ends[:, :1], seen.pole)
        silhouette = ((packed.edges.opposite[edge] < 0) | (height >= 0)).all(-1)
        scatterer = paths.scatterer(vertex)
        counts = silhouette & scatterer.above_horizon(seen.edge_point)
        behind, background = look_behind(packed, scatterer, seen, weight, counts, settings)
        numbers = numbers_behind(key_paths, self.name, number, state.dtype)
        return ask_behind(paths, seen, background, numbers, 1.0, settings), behind

    def image(
        self, context: jd.Context, state: jax.Array, chunk: jd.Chunk, held: Behind | None, answers: jd.Answers | None
    ) -> jax.Array:
        """Radiance that a moving silhouette covers or uncovers, [H, W, 3]: zero in value, right in derivative."""
        total = jnp.zeros_like(chunk.record.radiance)
        if held is not None and answers is not None:
            paths = path_segments(context.packed, chunk, "direct")
            values = background_values(context.packed, paths, held, answers.total)
            total = values.reshape(-1, paths.paths, 3).sum(0)
        return chunk.image(context.packed, total)
