"""The target of guides: the approximate contribution of a boundary segment (Yan et al. 2022, Eq. 11-13)."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float

from jaxdr.boundary.guided_edges.beam import detect, moves
from jaxdr.boundary.guided_edges.boundary_segments import (
    BoundaryEnds,
    BoundarySegments,
    Strategy,
    segment_ends,
    segments,
)
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes
from jaxdr.boundary.guided_edges.flux_maps import FluxMaps
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.color import magnitude
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.path_settings import PathSettings


class StrategyPlan(NamedTuple):
    """How segments are drawn by one strategy, and which light along them counts. Static.

    `emission`: light that the source's end emits. `gathered`: light that the source's end scatters.
    """

    strategy: Strategy
    emission: bool
    gathered: bool


def segment_target(
    packed: PackedScene,
    lunes: EdgeLunes,
    moving: Bool[Array, " S"],
    maps: FluxMaps | None,
    plan: StrategyPlan,
    key,
    settings: PathSettings,
) -> Callable[[Float[Array, "n 3"]], Float[Array, " n"]]:
    """|F| (magnitude) as a function of primary numbers, for a displacement of one unit: f_B J_B h_S h_D."""
    strategy = plan.strategy

    def target(primary):
        drawn = segments(packed, lunes, [strategy], primary)
        ends = segment_ends(packed, drawn, drawn.silhouette, settings.rays)
        ends = ends._replace(valid=ends.valid & moves(packed, moving, lunes, drawn, ends))
        density = strategy.density(packed, lunes, drawn, ends)
        weight = jnp.where(ends.valid & (density > 0), safe_divide(1.0, density), 0.0)
        return segment_magnitude(packed, maps, plan, drawn, ends, weight, key, settings)

    return target


def segment_magnitude(
    packed: PackedScene,
    maps: FluxMaps | None,
    plan: StrategyPlan,
    drawn: BoundarySegments,
    ends: BoundaryEnds,
    weight: Float[Array, " n"],
    key,
    settings: PathSettings,
) -> Float[Array, " n"]:
    """The magnitude that segments send to the film, times `weight`, for a displacement of one unit. Detached.

    Emission of the source, and a detector that the camera sees directly, are evaluated. Light that the source scatters
    (`gathered`), and what the detector sends to the film over more bounces, come from `maps`.
    """
    number = jnp.arange(weight.shape[0])
    seen = detect(packed, drawn, ends, weight, number, key, settings._replace(max_depth=2))
    importance = magnitude(seen.value[0])
    radiance = jnp.zeros_like(importance)
    if plan.emission:
        radiance += magnitude(jnp.broadcast_to(emitted(packed, ends.source, -drawn.towards), seen.value[0].shape))
    if maps is not None:
        if plan.gathered:
            radiance += jnp.where(ends.source.valid, maps.radiance_at(ends.source.position), 0.0)
        importance += jnp.where(ends.valid, maps.importance_at(ends.detector.position) * weight * drawn.sine, 0.0)
    return stop_gradient(jnp.where(ends.valid, jnp.maximum(importance * radiance, 0.0), 0.0))
