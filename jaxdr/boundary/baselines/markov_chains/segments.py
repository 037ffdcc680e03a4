"""What a chain is in: a segment past an edge, the light it sends to the film, and how likely it is drawn afresh."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxdr.boundary.baselines.markov_chains.walks import EdgeRings, Seen
from jaxdr.boundary.guided_edges.beam import moves
from jaxdr.boundary.guided_edges.boundary_segments import (
    DirectionSampling,
    EmitterSampling,
    lines_past,
    segment_ends,
    segments,
)
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes, LunePoints
from jaxdr.boundary.guided_edges.flux_maps import FluxMaps
from jaxdr.boundary.guided_edges.guide_target import StrategyPlan, segment_magnitude
from jaxdr.geometry.vector import dot, norm
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.keys import fixed_key
from jaxdr.transport.path_settings import PathSettings

TO_EMITTERS = 0.5  # share of the fresh segments that are drawn towards emitters
SKY, ANY = -1, -2  # in place of the face that a segment ends on: the environment; wherever it ends


class Space(NamedTuple):
    """The scene, its edges, and which light counts; `maps` for indirect light, else None. `reach`: the longest walk."""

    packed: PackedScene
    lunes: EdgeLunes
    rings: EdgeRings
    moving: Bool[Array, " S"]
    maps: FluxMaps | None
    reach: Float[Array, ""]
    plan: StrategyPlan
    settings: PathSettings


class Lines(NamedTuple):
    """Lines past points of edges, in unit directions. They count if they are `there` and end on the face `source`."""

    point: LunePoints
    towards: Float[Array, "n 3"]
    source: Int[Array, " n"]
    there: Bool[Array, " n"]


class States(NamedTuple):
    """Segments that n chains are in.

    - `source`: the face that they end on, or `SKY`; `seen`: the point there.
    - `magnitude`: the chains' target: what the film receives, for a displacement of one unit, per length of edge and
      solid angle at the edge. Zero where a segment does not count.
    - `density`: of `fresh_lines`, in the same measure.
    - `spread`: solid angle per area of the source; 1 towards the environment.
    """

    point: LunePoints
    towards: Float[Array, "n 3"]
    source: Int[Array, " n"]
    seen: Seen
    magnitude: Float[Array, " n"]
    density: Float[Array, " n"]
    spread: Float[Array, " n"]


def fresh_lines(space: Space, u: Float[Array, "n 4"]) -> Lines:
    """Lines that depend on nothing but uniform numbers: some towards emitters, some in any silhouette direction."""
    packed, lunes = space.packed, space.lunes
    drawn = segments(packed, lunes, [DirectionSampling], u[:, :3])
    anywhere = jnp.full_like(drawn.point.row, ANY)
    if not space.plan.emission:
        return Lines(drawn.point, drawn.towards, anywhere, drawn.silhouette)
    lit = segments(packed, lunes, [EmitterSampling], u[:, :3])
    assert lit.aim is not None  # this strategy has one
    emitter = lit.aim.emitter
    chosen = u[:, 3] < TO_EMITTERS
    face = jnp.where(emitter.valid, emitter.face, SKY)
    return Lines(
        drawn.point,
        jnp.where(chosen[:, None], lit.towards, drawn.towards),
        jnp.where(chosen, face, anywhere),
        jnp.where(chosen, lit.silhouette, drawn.silhouette),
    )


def states_of(space: Space, lines: Lines) -> States:
    """Trace lines both ways, and find their light."""
    packed, lunes, settings = space.packed, space.lunes, space.settings
    drawn = lines_past(lunes, lines.point, lines.towards)
    ends = segment_ends(packed, drawn, lines.there & drawn.silhouette, settings.rays)
    source = jnp.where(ends.source.valid, ends.source.face, SKY)
    counts = (lines.source == ANY) | (lines.source == source)
    ends = ends._replace(valid=ends.valid & counts & moves(packed, space.moving, lunes, drawn, ends))
    ones = jnp.where(ends.valid, 1.0, 0.0).astype(drawn.sine.dtype)
    key = fixed_key(0)  # nothing is drawn for detectors that the camera sees directly
    magnitude = segment_magnitude(packed, space.maps, space.plan, drawn, ends, ones, key, settings)
    density = DirectionSampling.density(packed, lunes, drawn)
    if space.plan.emission:
        to_emitters = EmitterSampling.density(packed, lunes, drawn, ends)
        density = TO_EMITTERS * to_emitters + (1 - TO_EMITTERS) * density
    infinite = ~ends.source.valid
    distance = norm(ends.source.position - drawn.position)
    facing = jnp.abs(dot(ends.source.normal, drawn.towards))
    spread = jnp.where(infinite, 1.0, safe_divide(facing, distance * distance, ~infinite & (distance > 0)))
    seen = Seen(jnp.where(infinite[:, None], drawn.towards, ends.source.position), infinite)
    return States(lines.point, lines.towards, source, seen, magnitude, density, spread)
