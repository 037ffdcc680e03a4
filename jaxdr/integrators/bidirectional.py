"""Bidirectional path tracing with boundary terms."""

from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.film_edges import EdgeDistribution, edge_distribution, film_edge_terms
from jaxdr.geometry.queries import CHOICES
from jaxdr.integrators.base import (
    BoundaryEstimator,
    ConnectedEstimator,
    FilmEstimator,
    check_rough_glass,
    edge_points_per_sample,
    sample_weights,
)
from jaxdr.moving import Moving
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.transport.bidirectional import BidirectionalSettings, bidirectional_paths
from jaxdr.transport.emission import has_emitters
from jaxdr.transport.path import PathSettings

HEURISTICS = {"balance": 1, "power": 2}  # the powers of densities that weights are shares of


class Prepared(NamedTuple):
    """What all chunks share: edges in the image, the estimator, and what it prepared."""

    edges: EdgeDistribution
    estimator: ConnectedEstimator
    boundary: Any


class BidirectionalPathTracer(eqx.Module):
    """Bidirectional path tracing (Veach 1997, chapter 10): the same image as `PathTracer`; every field is static.

    Paths from the camera and from emitters are joined in all ways: caustics and light from behind corners cost a
    fraction of the samples, everything else some more time each. One thing more is in the image: light of points,
    spots, projectors and from one direction that mirrors and smooth glass throw onto surfaces. No path from the camera
    finds it, so that `PathTracer` leaves it out.

    In what moves nothing (reflectance, roughness, radiance, intensity, textures, also the rotation of an environment)
    its derivative needs no boundary terms. In what does (vertices, camera) all vertices of paths are material points,
    the first hits too, so the pixel filter is differentiated and has to be Gaussian where surfaces move in the image.
    `boundary` is the estimator of visibility changes, `KernelDensity` or `WarpedArea`, for the segments of paths that
    all strategies find (docs/bidirectional_boundary.md); silhouettes in the image are explicit, as `PathTracer` has
    them. With None visibility changes are missing. Raises ValueError for the boundary terms of lights without area.
    Paths over delta lobes do not move with what bends them: derivatives by anything that moves, by the index of smooth
    glass or by normals of mirrors raise ValueError in scenes with delta lobes.

    - `max_depth`: longest path in segments, as `PathTracer` counts.
    - `heuristic`: "balance" or "power" (2) combination of all strategies.
    - `boundary`: estimator of visibility changes behind the first hit, or None: the interior term only.
    - `edge_samples`: as of `PathTracer`.
    - `chunk_size`: connections made at once, (max_depth - 1) (max_depth + 2) / 2 for every sample; memory is
      proportional to it and independent of the samples per pixel, but there is a sample of every pixel at least.
    - `rays`: as of `PathTracer`.
    """

    max_depth: int = eqx.field(static=True, default=3)
    heuristic: Literal["balance", "power"] = eqx.field(static=True, default="power")
    boundary: ConnectedEstimator | BoundaryEstimator | FilmEstimator | None = eqx.field(static=True, default=None)
    edge_samples: float | None = eqx.field(static=True, default=None)
    chunk_size: int = eqx.field(static=True, default=1 << 18)
    rays: str = eqx.field(static=True, default="auto")

    def __check_init__(self):
        name = "BidirectionalPathTracer"
        if self.max_depth < 1:
            raise ValueError(f"{name}: max_depth must be at least 1 (emitters seen directly), got {self.max_depth}")
        for field, known in (("heuristic", tuple(HEURISTICS)), ("rays", CHOICES)):
            if getattr(self, field) not in known:
                raise ValueError(f"{name}: {field} must be one of {', '.join(known)}; got {getattr(self, field)!r}")
        if self.boundary is not None and not isinstance(self.boundary, ConnectedEstimator):
            estimator = type(self.boundary).__name__
            raise ValueError(
                f"{name}: boundary must be KernelDensity(...), WarpedArea(...) or None; {estimator} has no form for "
                f"connected subpaths: for it take PathTracer(boundary={estimator}(...))"
            )
        if self.edge_samples is not None and not self.edge_samples > 0:
            raise ValueError(f"{name}: edge_samples must be positive")
        if self.chunk_size < 1:
            raise ValueError(f"{name}: chunk_size must be positive")

    def paths_at_once(self, differentiated: bool) -> int:
        """Pairs of subpaths in a chunk."""
        del differentiated
        return max(1, self.chunk_size // max(1, (self.max_depth - 1) * (self.max_depth + 2) // 2))

    @property
    def settings(self) -> BidirectionalSettings:
        """What the tracer itself needs."""
        return BidirectionalSettings(self.max_depth, HEURISTICS[self.heuristic], self.rays)

    def check(self, scene: Scene) -> None:
        """All scenes can be rendered."""

    def prepare(self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray) -> Prepared | None:
        """Edges in the image, and what the estimator needs; None where only the interior term is wanted."""
        _check_motion(packed, moving)
        if not isinstance(self.boundary, ConnectedEstimator):
            return None  # there is none
        _check_connected(scene, packed, moving)
        if not any(moving.seen):
            return None
        settings = PathSettings(self.max_depth, True, self.rays)
        boundary = self.boundary.prepare(packed, moving.seen, settings)
        return Prepared(edge_distribution(packed, moving.seen, key), self.boundary, boundary)

    def terms(
        self,
        packed: PackedScene,
        prepared: Prepared | None,
        samples: Int[Array, " n"],
        key_film: PRNGKeyArray,
        key: PRNGKeyArray,
        spp: int,
        moving: Moving | None,
    ) -> dict[str, Float[Array, "H W 3"]]:
        """Share of the image, by term."""
        material = moving is not None and any(moving.seen)
        film, rays = packed.camera.film, self.rays
        primary, found = bidirectional_paths(packed, samples, key_film, key, self.settings, material)
        share = sample_weights(samples, spp, found.value.dtype)
        terms = {"interior": found.image(film, found.value * found.weight[..., None], share, material)}
        if prepared is None:
            return terms
        _, _, width, height = film.window
        key_boundary, key_edges = jax.random.split(jax.random.fold_in(key, 1))
        points = max(1, round(primary.u.shape[0] * edge_points_per_sample(self)))
        settings = PathSettings(self.max_depth, True, rays)
        edges = film_edge_terms(packed, prepared.edges, points, key_edges, settings, "material")
        terms["silhouettes"] = share.sum() * edges.silhouettes
        if found.drawn is not None and has_emitters(packed):
            index = jnp.tile(samples, width * height)
            weight = jnp.where((found.value != 0).any(-1), found.weight, 0.0)
            options = weight, index, key_boundary, rays
            values = prepared.estimator.estimate_connected(packed, prepared.boundary, primary, found.drawn, *options)
            terms["boundary"] = found.image(film, values, share, False)
        return terms


def _check_motion(packed: PackedScene, moving: Moving) -> None:
    """Raises ValueError for what a `BidirectionalPathTracer` does not move."""
    name, remedy = "BidirectionalPathTracer", "take PathTracer(boundary=None) for the interior term of what moves"
    if packed.has_delta_lobes and (any(moving.seen) or any(moving.lights)):
        raise ValueError(
            f"render: paths of a {name} over delta lobes do not move with mirrors and smooth glass; {remedy}"
        )
    pixel_filter = packed.camera.film.filter
    if any(moving.seen) and not pixel_filter.smooth:
        raise ValueError(
            f"render: a {name} differentiates the pixel filter where surfaces move, and a "
            f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian, or {remedy}"
        )


def _check_connected(scene: Scene, packed: PackedScene, moving: Moving) -> None:
    """Raises ValueError for what a `BidirectionalPathTracer` has no boundary terms of."""
    check_rough_glass(scene)
    if packed.light_count and (any(moving.seen) or any(moving.lights)):
        raise ValueError(
            "render: shadows of lights without area have no derivative with a BidirectionalPathTracer; take lights "
            "with an area, PathTracer, or boundary=None for the interior term alone"
        )
