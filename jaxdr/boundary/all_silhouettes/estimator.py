"""The sum over all silhouettes that every path vertex sees, with points that fill edges and pixels evenly."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, edge_lunes, passing
from jaxdr.boundary.shared.background import BehindEdges, EdgeSamples, image_past, look_past, seen_edges
from jaxdr.boundary.shared.blocks import map_over_blocks
from jaxdr.boundary.shared.edge_angles import Cone, on_edges
from jaxdr.boundary.shared.path_segments import PathSegments, path_segments
from jaxdr.boundary.shared.projection import never_silhouettes
from jaxdr.boundary.shared.refusals import Asked, edge_refusals, refuse
from jaxdr.boundary.shared.term import Chunk, Context
from jaxdr.geometry import queries
from jaxdr.geometry.vector import norm, normalize, scale, z_of
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.keys import hashed
from jaxdr.transport.radiance import Answers, Requests
from jaxdr.transport.sampler import seed_of, to_unit

ALL = 4.0  # a reach beyond pi: every direction


class Ball(NamedTuple):
    """A ball that contains all area emitters; detached."""

    centre: Float[Array, " 3"]
    radius: Float[Array, ""]


class AllSilhouettesState(NamedTuple):
    """The edges for `passing`, the edges with their tree, and the ball around the emitters if there are any."""

    lunes: EdgeLunes
    edges: queries.EdgeSet
    emitters: Ball | None


@checked
class AllSilhouettes(eqx.Module):
    """Every path vertex looks past every silhouette that it sees. Unbiased.

    Nothing chooses among the silhouettes, so only the points on them and in the pixel are random. These fill edges and
    pixels evenly, and the error falls faster than 1 / sqrt(`spp`). It is for meshes of a few thousand faces, and for
    accurate derivatives: the time grows with the number of silhouettes. All fields are static.

    - `capacity`: silhouettes for which there is room, in the mean over all path vertices. If there are more, they are
      thinned without bias, and a warning says so. Memory is proportional to it.

    Raises ValueError for options out of range.
    """

    capacity: int = eqx.field(static=True, default=64)

    name = "boundary"

    refusals = edge_refusals("AllSilhouettes")

    def __check_init__(self):
        if self.capacity < 1:
            raise ValueError(f"AllSilhouettes: capacity must be at least 1, got {self.capacity}")

    def prepare(self, context: Context, key: PRNGKeyArray) -> AllSilhouettesState:
        """The edges with a tree over them. Raises ValueError for scenes that the estimator does not cover."""
        del key
        refuse(self.refusals, Asked(context.packed, context.settings))
        packed = jax.tree.map(stop_gradient, context.packed)
        rank = jnp.where(never_silhouettes(packed), 0.0, 1.0).astype(packed.vertices.dtype)
        edges = queries.EdgeSet.of(packed.edges, rank)
        tree = queries.edge_tree(packed.geometry, edges, packed.edge_counts, context.settings.rays)
        lunes = edge_lunes(packed, (True,) * len(packed.closed))
        return AllSilhouettesState(lunes, edges._replace(tree=tree), _emitters(packed))

    def draw(
        self, context: Context, state: AllSilhouettesState, chunk: Chunk, key: PRNGKeyArray
    ) -> tuple[Requests | None, BehindEdges | None]:
        """Points on silhouettes, and requests for the radiance of what is seen just past them."""
        if chunk.record.direct is None:  # paths of one segment don't scatter
            return None, None
        packed, settings = context.packed, context.settings
        paths = path_segments(packed, chunk, "direct", differentiated=False)
        key_thinning, key_paths = jax.random.split(key)
        capacity = self.capacity * paths.count
        cones = _cones(packed, state.emitters, paths)
        found = queries.silhouettes(packed.geometry, state.edges, cones, seed_of(key_thinning), capacity, settings.rays)
        used = jnp.minimum(found.count, capacity)
        cosine = jnp.where(cones.reach < jnp.pi, jnp.cos(cones.reach), -1.0)

        def look(pair, number):
            vertex, edge = jnp.maximum(pair.segment, 0), jnp.maximum(pair.element, 0)
            scatterer = paths.scatterer(vertex)
            u = _along(chunk.primary.u[paths.path(vertex), 3], edge, vertex // paths.paths)
            cone = Cone(cones.direction[vertex], cosine[vertex])
            along, angle = on_edges(packed.ends_of(edge), scatterer.point.position, u, cone)
            there = (pair.segment >= 0) & (number < used) & (angle > 0)
            seen = seen_edges(packed, paths, vertex, edge, along, there)
            silhouette = passing(state.lunes, edge, seen.towards).silhouette
            counts = there & silhouette & scatterer.above_horizon(seen.edge_point)
            weight = jnp.where(counts, angle * state.lunes.share[edge] * found.weight, 0.0)
            samples = EdgeSamples(vertex, edge, along, weight, number)
            return look_past(context, paths, samples, counts, key_paths, self.name)

        pairs = found._replace(count=None, weight=None)
        asked, behind = map_over_blocks(look, pairs, used)
        return asked, BehindEdges(behind, used)

    def image(
        self,
        context: Context,
        state: AllSilhouettesState,
        chunk: Chunk,
        held: BehindEdges | None,
        answers: Answers | None,
    ) -> Float[Array, "H W 3"]:
        """Radiance that moving silhouettes cover or uncover: zero in value, right in derivative."""
        return image_past(context, chunk, held, answers)


def _emitters(packed: PackedScene) -> Ball | None:
    """The ball around all emitting faces."""
    if packed.emitter_faces is None:
        return None
    points = packed.corners_of(packed.emitter_faces).reshape(-1, 3)
    centre = 0.5 * (points.min(0) + points.max(0))
    return Ball(centre, norm(points - centre).max())


def _cones(packed: PackedScene, emitters: Ball | None, paths: PathSegments) -> queries.ConeQuery:
    """Where the silhouettes of path vertices count: above the horizon, and before emitters if no other light counts."""
    vertex = jnp.arange(paths.count)
    scatterer = paths.scatterer(vertex)
    apex = scatterer.point.position
    normal = scale(scatterer.normal, jnp.sign(z_of(scatterer.wi)))
    direction, reach = normal, jnp.full(paths.count, ALL, apex.dtype)
    if emitters is not None and packed.environment is None:
        offset = emitters.centre - apex
        distance = norm(offset)
        outside = distance > emitters.radius
        ratio = jnp.where(outside, emitters.radius / jnp.where(outside, distance, 1.0), 0.0)
        # The last vertex of a path gathers direct light alone. A little wider, because arcs of sines round.
        alone = outside & (vertex >= paths.count - paths.paths)
        direction = jnp.where(alone[:, None], normalize(offset), normal)
        reach = jnp.where(alone, jnp.arcsin(ratio) + 1e-3, reach)
    carries = (paths.table.throughput != 0).any(-1)
    return queries.ConeQuery(apex, direction, normal, jnp.where(carries, reach, 0.0))


def _along(u: Float[Array, " n"], edge: Int[Array, " n"], bounce: Int[Array, " n"]) -> Float[Array, " n"]:
    """Uniform numbers for edges: those of the paths, shifted by an amount of the edge's and the bounce's own.

    The numbers of a pixel's paths fill the unit interval evenly, together with their film points. So do shifted ones.
    """
    zero = jnp.zeros_like(edge, jnp.uint32)
    bits = hashed([edge.astype(jnp.uint32), bounce.astype(jnp.uint32), zero, zero])[0]
    shifted = u + to_unit(bits, u.dtype.type)
    return jnp.clip(jnp.where(shifted >= 1.0, shifted - 1.0, shifted), 0.0, 1.0 - 2.0**-24)
