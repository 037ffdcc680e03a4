"""Chords from path vertices and the edges that cross them: the common part of all kinds of chords."""

import abc
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.line_sampling.chords import Chords
from jaxdr.boundary.shared.path_segments import PathSegments
from jaxdr.geometry import queries
from jaxdr.geometry.edge_tree import EdgeTree
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import lattice, seed_of
from jaxdr.transport.shading import Scatterer

# Ranks of edges: edges that only hide others, edges that may bound what is visible, and moving edges of the latter.
HIDES, BOUNDS, MOVES = 1, 2, 3
WIDEST = 1.4  # half-length of geodesic chords, radians


class RankedEdges(NamedTuple):
    """Ranks of the edges, 0 for those that are left out, and the tree over them."""

    rank: Float[Array, " E"]
    tree: EdgeTree


class LineSamplingState(NamedTuple):
    """State for all chunks of an image.

    - `edges`: ranked edges for silhouettes.
    - `group`: numbers of the emitters' planes.
    - `moving`: which shapes move.
    - `count_layers`: look at all edges for bounded chords, even if only moving edges can bound what they see.
    """

    edges: RankedEdges
    group: Int[Array, " F"]
    moving: Bool[Array, " S"]
    count_layers: Bool[Array, ""]


class Chosen(NamedTuple):
    """M chords: the path vertices they start from (-1: unused slot), and 1 / the expected number of chords there."""

    vertex: Int[Array, " M"]
    inverse: Float[Array, " M"]


class Crossings(NamedTuple):
    """Crossings of chords: path vertex, chord and edge, the fraction `along` the edge, whether the slot is used.

    `share` is the part of a crossing that counts where edges coincide; None if all crossings count in full.
    """

    vertex: Int[Array, " C"]
    chord: Int[Array, " C"]
    edge: Int[Array, " C"]
    along: Float[Array, " C"]
    valid: Bool[Array, " C"]
    share: Float[Array, " C"] | None = None


@dataclass(frozen=True)
class ChordKind(abc.ABC):
    """One kind of chords. `score` gets what `search` has drawn.

    `traces_paths`: a path is traced from behind each crossing. Such paths are expensive, so few crossings are kept.
    """

    packed: PackedScene
    prepared: LineSamplingState
    paths: PathSegments
    settings: PathSettings
    traces_paths: ClassVar[bool] = True

    @abc.abstractmethod
    def search(self, chosen: Chosen, key, room: int) -> tuple[Any, Crossings, Float[Array, ""], Int[Array, ""]]:
        """(chords, crossings, weight of the thinning, number of crossings)."""

    @abc.abstractmethod
    def score(self, drawn: Any, found: Crossings) -> Float[Array, " C"]:
        """Contribution of crossings to the pilot: magnitude per displacement of the edge."""

    def starts(self, chosen: Chosen, key, numbers: int) -> tuple[Scatterer, Float[Array, "M n"]]:
        """(BSDFs at the path vertices that chords start from, some uniform numbers for each)."""
        u = lattice(key, 1, jnp.arange(chosen.vertex.shape[0]), numbers, self.packed.vertices.dtype)
        return self.paths.scatterer(jnp.maximum(chosen.vertex, 0)), u


def lobe_reach(scatterer: Scatterer, reach: float) -> Float[Array, " M"]:
    """Half-length of geodesic chords (radians): `reach` x width of the lobe."""
    return jnp.minimum(reach * scatterer.lobe_width(), WIDEST)


def apex_moves(lines: ChordKind, vertex: Int[Array, " M"]) -> Bool[Array, " M"]:
    """Whether path vertices or their lobes may move: with their own shape, or with that of an earlier vertex.

    Earlier vertices count only where vertices slide.
    """
    paths, moving, shape = lines.paths, lines.prepared.moving, lines.packed.face_shape
    if paths.vertices is None:
        return moving[shape[paths.table.apex_face[vertex]]]
    moves = moving[shape[paths.table.apex_face]].reshape(-1, paths.paths)
    return jax.lax.cummax(moves.astype(jnp.int32)).reshape(-1)[vertex] > 0


def silhouette_crossings(
    lines: ChordKind,
    chosen: Chosen,
    apex: Float[Array, "M 3"],
    chords: Chords,
    key,
    room: int,
    far_moves: bool | Bool[Array, ""] = True,
) -> tuple[Crossings, Float[Array, ""], Int[Array, ""]]:
    """(crossings of chords with the silhouettes seen from path vertices, weight of the thinning, number of crossings).

    `far_moves`: whether the far ends of unbounded chords may move.
    """
    packed, prepared = lines.packed, lines.prepared
    vertex, shape = jnp.maximum(chosen.vertex, 0), packed.face_shape
    bounded = chords.group != queries.UNBOUNDED
    # Crossings count if the edge, the apex or the far end moves. The far end of an unbounded chord may be anywhere.
    moves = jnp.zeros(packed.faces.shape[0], jnp.int32)
    moves = moves.at[jnp.where(prepared.group < 0, moves.shape[0], prepared.group)].max(
        prepared.moving[shape].astype(jnp.int32), mode="drop"
    )
    end_moves = apex_moves(lines, vertex)
    end_moves = end_moves | jnp.where(bounded, moves[jnp.maximum(chords.group, 0)] > 0, far_moves)
    needed = jnp.where(end_moves, jnp.where(bounded, HIDES, BOUNDS), MOVES)
    needed = jnp.where(bounded & prepared.count_layers, HIDES, needed)
    needed = jnp.where((chosen.vertex >= 0) & chords.useful, needed, 0)
    edges, table = prepared.edges, packed.edges
    found = queries.sector_crossings(
        packed.geometry,
        queries.EdgeSet.of(table, edges.rank, edges.tree),
        prepared.group,
        queries.SectorQuery(apex, chords.first, chords.last, chords.centre, needed.astype(apex.dtype), chords.group),
        seed_of(key),
        HIDES,
        room,
        lines.settings.rays,
    )
    valid = found.chord >= 0
    chord = jnp.where(valid, found.chord, 0)
    crossings = Crossings(vertex[chord], chord, found.edge, found.along.astype(apex.dtype), valid)
    if table.share is not None:
        # Edges may coincide. The number of layers changes between none and some at one of them only, which counts in
        # full. But if rays test visibility, they pass all of these edges, so the edges share the crossing.
        by_rays = ~bounded | (needed > HIDES) | (lines.settings.rays == "jax")
        crossings = crossings._replace(share=jnp.where(by_rays[chord], table.share[found.edge], 1.0))
    return crossings, found.weight.astype(apex.dtype), valid.sum()
