"""Boundary segments from edges, in the middle of paths (Zhang et al. 2020; Yan et al. 2022); docs/guided_edges.md."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr.boundary.beam import detect, gathered_by_bounces, image, moves
from jaxdr.boundary.blocks import sum_over_blocks
from jaxdr.boundary.boundary_segments import DirectionSampling, EmitterSampling, Strategy, segment_ends
from jaxdr.boundary.edge_lunes import EdgeLunes, edge_lunes
from jaxdr.boundary.primary_guides import Guide, Unguided
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted, has_emitters
from jaxdr.transport.path import PathSettings
from jaxdr.transport.sampler import lattice


class Plan(NamedTuple):
    """How segments are drawn by one strategy, and which of the light they carry counts.

    `emission` of what they end on, `gathered`: light that it scatters. Static.
    """

    strategy: Strategy
    emission: bool
    gathered: bool


class Prepared(NamedTuple):
    """What all chunks of an image share: the edges, which shapes move, a guide for every plan."""

    lunes: EdgeLunes
    moving: Bool[Array, " S"]
    guides: tuple[Guide, ...]


class GuidedEdges(eqx.Module):
    """Boundary term of every segment behind the first hit, from segments drawn on edges; every field is static.

    Unbiased whatever the guide. Contributions are splatted onto the film.

    - `sampling`: "emitter" draws segments for what emitters send towards them and the rest by direction, "direction"
      all by direction, "mis" (Yan et al. 2022, 4.2) the emitters' light by both.
    - `samples`: segments per path sample and strategy.
    """

    sampling: Literal["emitter", "direction", "mis"] = eqx.field(static=True, default="mis")
    samples: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        if self.sampling not in ("emitter", "direction", "mis"):
            raise ValueError(f"GuidedEdges: sampling must be emitter, direction or mis, got {self.sampling!r}")
        if not self.samples > 0:
            raise ValueError(f"GuidedEdges: samples must be positive, got {self.samples}")

    def plans(self, packed: PackedScene, settings: PathSettings) -> tuple[Plan, ...]:
        """The strategies that this scene needs at this depth."""
        indirect = settings.max_depth > 2
        glows = packed.has_area_emitters or packed.environment is not None
        plans = []
        if glows and self.sampling != "direction":
            plans.append(Plan(EmitterSampling, True, False))
        by_direction = glows and self.sampling != "emitter"
        if by_direction or indirect:
            plans.append(Plan(DirectionSampling, by_direction, indirect))
        return tuple(plans) if settings.max_depth > 1 and has_emitters(packed) else ()

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Prepared:
        """Edges and guides, once for a whole image. `moving`: which shapes can move.

        Raises ValueError for scenes with delta lobes: no connection with the camera goes over them.
        """
        if packed.has_delta_lobes:
            raise ValueError(
                "render: GuidedEdges does not see visibility changes over mirrors and smooth glass; take KernelDensity or "
                "LineSampling, or boundary=None for the interior term alone"
            )
        lunes = edge_lunes(packed, moving)
        guides = tuple(Unguided() for _ in self.plans(packed, settings))
        return Prepared(lunes, jnp.asarray(moving), guides)

    def film_term(
        self,
        packed: PackedScene,
        prepared: Prepared,
        count: int,
        key: PRNGKeyArray,
        settings: PathSettings,
        form: str,
    ) -> Float[Array, "H W 3"]:
        """Boundary term for `count` path samples: an image that is zero in value, right in derivative.

        `prepared` by `prepare`; `form` of the first hits, see `primary_samples`.
        """
        _, _, width, height = packed.camera.film.window
        total = jnp.zeros((height, width, 3), packed.vertices.dtype)
        count = max(1, round(count * self.samples))
        for number, plan in enumerate(self.plans(packed, settings)):
            total += self._term(packed, prepared, number, count, jax.random.fold_in(key, number), settings, form)
        return total

    def _term(self, packed, prepared: Prepared, number: int, count: int, key, settings, form) -> Float[Array, "H W 3"]:
        """The term of segments drawn by one plan."""
        detached, lunes = jax.tree.map(stop_gradient, packed), prepared.lunes
        plans = self.plans(packed, settings)
        plan, guide = plans[number], prepared.guides[number]
        key_segments, key_detector, key_source = jax.random.split(key, 3)
        u = lattice(key_segments, 1, jnp.arange(count), 4, packed.vertices.dtype)[0]
        primary = guide.sample(u)
        # Most lines towards emitters pass no edge as a silhouette: the others are gathered in front.
        drawn = plan.strategy.segments(detached, lunes, primary)
        used = drawn.silhouette.sum()
        slots = jnp.nonzero(drawn.silhouette, size=count, fill_value=0)[0]

        def values(slot, place):
            active = place < used
            drawn_here = plan.strategy.segments(detached, lunes, primary[slot])
            ends = segment_ends(detached, drawn_here, active, settings.rays)
            ends = ends._replace(valid=ends.valid & moves(detached, prepared.moving, lunes, drawn_here, ends))
            pdf = [
                p.strategy.density(detached, lunes, drawn_here, ends)
                * g.pdf(p.strategy.numbers(detached, lunes, drawn_here, ends))
                for p, g in zip(plans, prepared.guides, strict=True)
            ]
            seen = detect(detached, drawn_here, ends, jnp.full(slot.shape, 1.0 / count), slot, key_detector, settings)
            carries = (seen.value != 0).any((0, 2))
            radiance = jnp.zeros_like(seen.value)
            if plan.emission:
                density = sum(d for d, p in zip(pdf, plans, strict=True) if p.emission)
                sent = emitted(detached, ends.source, -drawn_here.towards)
                radiance += jnp.where(carries[:, None], sent / _nonzero(density)[:, None], 0.0)
            if plan.gathered:
                source = ends.source._replace(valid=ends.source.valid & carries)
                light = gathered_by_bounces(detached, source, drawn_here.towards, slot, key_source, settings)
                radiance += light[::-1] / _nonzero(pdf[number])[:, None]
            return image(packed, lunes, drawn_here, ends, seen, stop_gradient(radiance), form)

        return sum_over_blocks(values, slots, used)


def _nonzero(x) -> Any:
    return jnp.where(x > 0, x, 1.0)
