"""Path tracing with boundary terms: draw paths -> contributions -> interior + boundary -> film."""

import dataclasses
import warnings
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.edge_reservoir import EdgeTable
from jaxdr.boundary.film_chains import chain_edges, film_chain_term
from jaxdr.boundary.film_edges import EdgeDistribution, edge_distribution, film_edge_terms
from jaxdr.boundary.hard_shadows import (
    ShadowDistribution,
    film_shadow_term,
    scattered_shadow_term,
    shadow_distribution,
)
from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.pixel_borders import pixel_border_term
from jaxdr.boundary.silhouettes import PathSegments
from jaxdr.boundary.texture_jumps import check_still_jumps
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.boundary.warped_camera import warped_camera_term
from jaxdr.geometry.queries import CHOICES
from jaxdr.integrators.base import (
    BoundaryEstimator,
    FilmEstimator,
    check_rough_glass,
    edge_points_per_sample,
    pixel_sums,
    sample_weights,
)
from jaxdr.moving import Moving
from jaxdr.scene.bsdf.base import only_delta
from jaxdr.scene.camera import Perspective
from jaxdr.scene.camera.pinhole import PinholeCamera
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.transport.path import PathSettings, trace_paths
from jaxdr.transport.primary import primary_samples
from jaxdr.transport.radiance import arriving_radiance


class Prepared(NamedTuple):
    """What all chunks share: distributions over edges and shadows, edges seen in mirrors, the estimator's own.

    None where there are no such terms. `warp`: in place of the edges; `turns`: whether the environment does.
    """

    edges: EdgeDistribution | None
    boundary: Any
    shadows: ShadowDistribution | None
    chains: EdgeTable | None
    warp: WarpedArea | None
    turns: bool


class PathTracer(eqx.Module):
    """Unidirectional path tracing with next-event estimation; every field is static but what `ReusedGuides` hold.

    - `max_depth`: longest path in segments, as Mitsuba counts: 1 = emitters seen directly, 2 = direct light, ...
    - `boundary`: estimator of visibility changes behind the first hit, or None: then the derivative lacks them *and*
      the moving silhouettes and creases in the image (interior term only).
    - `primary`: "fixed_ray" (camera rays stay, moving edges in the image are explicit) or "material" (first hits move
      with their surfaces and the Gaussian pixel filter is differentiated; for discontinuous textures). "warp" is
      "material" with warped areas in place of the silhouettes in the image, for a boundary of `WarpedArea`.
    - `sampling`: "mis" combines emitter and BSDF sampling; "emitter" leaves the BSDF-sampled emission out, which is
      faster where emitters are small and always noisier where they are large or near.
    - `edge_samples`: points on silhouettes, and as many on creases, in the image per path sample. None: 1/8 for direct
      light, 1 with indirect light, whose noise does not cancel between the two sides of a silhouette.
    - `chunk_size`: paths traced at once, four times as many in images that nobody differentiates; memory is
      proportional to it and independent of the samples per pixel.
    - `rays`: implementation of the ray queries, "embree" (CPU; Warp elsewhere), "warp" (CPU, CUDA), "jax", or "auto"
      for the first of them that is installed.
    """

    max_depth: int = eqx.field(static=True, default=3)
    boundary: BoundaryEstimator | FilmEstimator | None = KernelDensity()
    primary: Literal["fixed_ray", "material", "warp"] = eqx.field(static=True, default="fixed_ray")
    sampling: Literal["mis", "emitter"] = eqx.field(static=True, default="mis")
    edge_samples: float | None = eqx.field(static=True, default=None)
    chunk_size: int = eqx.field(static=True, default=1 << 16)
    rays: str = eqx.field(static=True, default="auto")

    def __check_init__(self):
        if self.max_depth < 1:
            raise ValueError(f"PathTracer: max_depth must be at least 1 (emitters seen directly), got {self.max_depth}")
        for name, known in (
            ("primary", ("fixed_ray", "material", "warp")),
            ("sampling", ("mis", "emitter")),
            ("rays", CHOICES),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"PathTracer: {name} must be one of {', '.join(known)}; got {getattr(self, name)!r}")
        if self.primary == "warp" and not isinstance(self.boundary, WarpedArea | None):
            raise ValueError(
                'PathTracer: primary="warp" needs boundary=WarpedArea(...) (or None), got '
                f'{type(self.boundary).__name__}; or take primary="fixed_ray"'
            )
        if (self.edge_samples is not None and not self.edge_samples > 0) or self.chunk_size < 1:
            raise ValueError("PathTracer: edge_samples and chunk_size must be positive")

    def paths_at_once(self, differentiated: bool) -> int:
        """Paths in a chunk: more in an image that nobody differentiates, which keeps nothing of them.

        So those that go on fill blocks for longer.
        """
        return self.chunk_size if differentiated else 4 * self.chunk_size

    @property
    def settings(self) -> PathSettings:
        """What the path tracer itself needs."""
        return PathSettings(self.max_depth, self.sampling == "mis", self.rays)

    def check(self, scene: Scene) -> None:
        """Raises ValueError for a pixel filter that can't be differentiated."""
        pixel_filter = scene.camera.film.filter
        if self.primary != "fixed_ray" and not pixel_filter.smooth:
            raise ValueError(
                f'render: primary="{self.primary}" differentiates the pixel filter, and a '
                f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian"
            )

    def prepare(self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray) -> Prepared | None:
        """Only what can move: where nothing but lights does, there are no terms but for their shadows."""
        if self.boundary is None:
            return None
        check_rough_glass(scene)
        _check_transmission(packed, self)
        check_still_jumps(scene, moving.seen, self.primary == "fixed_ray")
        packed = dataclasses.replace(packed, environment_turns=moving.environment)
        edges = boundary = shadows = chains = warp = None
        if any(moving.seen):
            if packed.has_delta_lobes and self.max_depth > 1:
                chains = chain_edges(packed, moving.seen, self.rays)
            if self.primary == "warp" and isinstance(self.boundary, WarpedArea):
                _check_warp(packed)
                warp = self.boundary
            else:
                edges = edge_distribution(packed, moving.seen, key)
        if any(moving.seen) or moving.environment:
            boundary = self.boundary.prepare(packed, moving.seen, self.settings)
        if packed.light_count and self.max_depth > 1:
            if not isinstance(packed.camera, Perspective):
                raise ValueError(
                    f"render: hard shadows seen by a {type(packed.camera).__name__} camera have no derivative yet; "
                    "take a Perspective, or boundary=None for the interior term alone"
                )
            lights = moving.lights or (False,) * packed.light_count
            shadows = shadow_distribution(packed, moving.seen, lights, self.settings)
        return Prepared(edges, boundary, shadows, chains, warp, moving.environment)

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
        if moving is None:
            return self._image(packed, samples, key_film, key, spp)
        if prepared is not None:
            packed = dataclasses.replace(packed, environment_turns=prepared.turns)
        _, _, width, height = packed.camera.film.window
        pixels, count = width * height, samples.shape[0]
        key_path, key_boundary, key_edges = jax.random.split(key, 3)
        moves = prepared is not None and (prepared.edges is not None or prepared.warp is not None)
        settings, form = self.settings, self._form(packed, moves)
        primary = primary_samples(packed, samples, key_film, settings.rays, form)
        record = trace_paths(packed, primary.first, primary.direction, primary.u, key_path, settings, primary.near)
        radiance = record.radiance * primary.weight[:, None]
        weight = sample_weights(samples, spp, radiance.dtype)

        def gather(values):
            return pixel_sums(packed, values, weight)

        terms = {"interior": gather(radiance)}
        if prepared is None:
            return terms
        points = max(1, round(pixels * count * edge_points_per_sample(self)))
        if prepared.edges is not None:
            edges = film_edge_terms(packed, prepared.edges, points, key_edges, settings, form)
            share = weight.sum()
            terms |= {"silhouettes": share * edges.silhouettes, "creases": share * edges.creases}
            if form == "near" and packed.camera.film.filter.tiles:
                sides = max(1, round(count * edge_points_per_sample(self) / 4))
                key_borders = jax.random.fold_in(key_edges, 2)
                terms["pixel_borders"] = share * pixel_border_term(packed, sides, key_borders, settings)
        if prepared.warp is not None:
            key_camera = jax.random.fold_in(key_edges, 4)
            options = prepared.boundary, prepared.warp, primary, record, key_camera, settings
            terms["warp"] = gather(warped_camera_term(packed, *options))
        if prepared.boundary is not None and isinstance(self.boundary, FilmEstimator):
            image = self.boundary.film_term(packed, prepared.boundary, pixels * count, key_boundary, settings, form)
            terms["boundary"] = weight.sum() * image
        elif prepared.boundary is not None:
            assert isinstance(self.boundary, BoundaryEstimator)
            index = jnp.tile(samples, pixels)
            options = primary, record, index, key_boundary, settings
            terms["boundary"] = gather(self.boundary.estimate(packed, prepared.boundary, *options))
        if prepared.chains is not None:
            key_chains = jax.random.fold_in(key_edges, 3)
            terms["chains"] = weight.sum() * film_chain_term(
                packed, prepared.chains, pixels * count, key_chains, settings
            )
        if prepared.shadows is not None:
            key_seen, key_scattered = jax.random.split(jax.random.fold_in(key_edges, 1))
            shadows = weight.sum() * film_shadow_term(packed, prepared.shadows, points, key_seen, settings, form)
            if settings.max_depth > 2 and record.direct is not None:
                paths = PathSegments(packed, primary, record.direct)
                shadows += gather(scattered_shadow_term(packed, prepared.shadows, paths, key_scattered, settings))
            terms["shadows"] = shadows
        return terms

    def _image(self, packed: PackedScene, samples, key_film, key, spp: int) -> dict:
        """The same in value, for images that nobody differentiates."""
        settings = self.settings
        primary = primary_samples(packed, samples, key_film, settings.rays, "fixed")
        radiance = arriving_radiance(packed, primary.first, primary.direction, primary.u, key, settings)
        return {"interior": pixel_sums(packed, radiance, sample_weights(samples, spp, radiance.dtype))}

    def _form(self, packed: PackedScene, moves: bool) -> str:
        """How first hits move, see `primary_samples`; without boundary terms of moving edges as they always did."""
        if not moves:
            return "fixed"
        if self.primary != "fixed_ray":
            return "material"
        # Of direct light only what emitters that touch a surface send comes from close by: not worth a second form.
        pixel_filter = packed.camera.film.filter
        return "near" if (pixel_filter.smooth or pixel_filter.tiles) and self.max_depth > 2 else "fixed"


def _check_transmission(packed: PackedScene, tracer: PathTracer) -> None:
    """Raises ValueError where boundary terms are missing; warns of what is left out with mirrors and smooth glass."""
    if not packed.has_delta_lobes:
        return
    if tracer.primary != "fixed_ray":
        raise ValueError(
            f'render: visibility changes seen over delta lobes have no derivative with primary="{tracer.primary}"; '
            'use primary="fixed_ray", or boundary=None for the interior term alone'
        )
    if packed.light_count and tracer.max_depth > 2:
        raise ValueError(
            "render: hard shadows seen over delta lobes have no derivative yet; take lights with an area, max_depth=2, "
            "or boundary=None for the interior term alone"
        )
    if tracer.max_depth > 2 and not all(only_delta(group.bsdf) for group in packed.bsdfs):
        warnings.warn(
            "jaxdr: the derivative lacks visibility changes of reflected/refracted light from diffuse surfaces via "
            "delta surfaces (a path that leaves a surface that spreads light, meets a mirror or smooth glass and goes "
            "on); what the camera sees over delta surfaces is there",
            stacklevel=2,
        )


def _check_warp(packed: PackedScene) -> None:
    """Raises ValueError for what a `warped_camera_term` does not know."""
    if not isinstance(packed.camera, PinholeCamera):
        raise ValueError(
            f'render: primary="warp" needs a camera with a position, not {type(packed.camera).__name__}; take a '
            'Perspective or a ThinLens, or primary="fixed_ray"'
        )
    if packed.light_count:
        raise ValueError(
            'render: silhouettes of what lights without area light up have no derivative with primary="warp"; take '
            'lights with an area, or primary="fixed_ray"'
        )
