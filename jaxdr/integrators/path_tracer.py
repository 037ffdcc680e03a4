"""Path tracing with boundary terms. Paths give contributions; interior and boundary terms add up on the film."""

import dataclasses
import warnings
from typing import Any, Literal

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked, shown
from jaxdr.boundary.film.cut_segments import cutting_planes
from jaxdr.boundary.film.film_chains import FilmChains
from jaxdr.boundary.film.film_edges import FilmEdges
from jaxdr.boundary.film.hard_shadows import HardShadows
from jaxdr.boundary.film.pixel_borders import PixelBorders
from jaxdr.boundary.shared.refusals import INTERIOR, Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context, Term, pixel_sums
from jaxdr.boundary.shared.texture_jumps import MOVED_JUMPS
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.boundary.warped_area.warped_camera import WarpedCamera
from jaxdr.geometry.queries import CHOICES
from jaxdr.integrators.base import (
    ROUGH_GLASS,
    Batch,
    edge_points_per_sample,
    prepare_terms,
    term_images,
)
from jaxdr.integrators.choice import Automatic, automatic
from jaxdr.integrators.known_failures import warn_of_cuts
from jaxdr.kernels import CHOICES as COMPUTE
from jaxdr.moving import Moving
from jaxdr.scene.bsdf.base import only_delta
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.sizes import at_once
from jaxdr.transport.near_paths import near_field_term
from jaxdr.transport.path import trace_paths
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.radiance import arriving_radiance
from jaxdr.whole_numbers import check_depth


def _steep_filter(asked: Asked) -> str | None:
    pixel_filter = asked.scene.camera.film.filter
    if asked.primary == "fixed_ray" or pixel_filter.smooth:
        return None
    return (
        f'render: primary="{asked.primary}" differentiates the pixel filter, and a '
        f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian"
    )


def _moved_over_mirrors(asked: Asked) -> str | None:
    if not asked.packed.has_delta_lobes or asked.primary == "fixed_ray":
        return None
    return (
        f'render: visibility changes seen over delta lobes have no derivative with primary="{asked.primary}"; '
        f'use primary="fixed_ray", {INTERIOR}'
    )


def _hard_shadows_over_mirrors(asked: Asked) -> str | None:
    if not (asked.packed.has_delta_lobes and asked.packed.light_count and asked.settings.max_depth > 2):
        return None
    return (
        "render: hard shadows seen over delta lobes have no derivative yet; take lights with an area, max_depth=2, "
        f"{INTERIOR}"
    )


STEEP_FILTER = Refusal(
    'a filter other than Gaussian, with `primary="material"` or `"warp"`', "`Gaussian`", _steep_filter
)


@checked
class PathTracer(eqx.Module):
    """Path tracing from the camera, with next-event estimation. All fields are static, except a `ReusedGuides`.

    - `max_depth`: longest path in segments, as Mitsuba counts: 1 is emitters seen directly, 2 is direct light.
    - `boundary`: estimator of visibility changes behind the first hit. "auto" chooses it for the scene, when a
      derivative is traced ([rules](choosing.md)). None gives the interior term only: the derivative lacks these
      changes, *and* silhouettes and creases in the image.
    - `primary`: how first hits move. "fixed_ray": camera rays stay fixed, and edges that move in the image have a term.
      "material": first hits move with their surfaces, and the Gaussian pixel filter is differentiated; for textures
      that jump. "warp": like "material", but with warped areas for silhouettes; needs `boundary=WarpedArea(...)`.
    - `sampling`: "mis" combines emitter and BSDF sampling. "emitter" leaves out emission found by BSDF sampling. It is
      faster if emitters are small, and always noisier if they are large or near.
    - `edge_samples`: points on silhouettes, and as many on creases, per path sample. None: 1/8 for direct light, and 1
      with indirect light, whose noise does not cancel between the two sides of a silhouette.
    - `chunk_size`: paths traced at once; four times as many in images without derivatives. Memory is proportional to
      it, and independent of the samples per pixel. None: 65,536 on CPUs and 1,048,576 elsewhere. Each chunk has its own
      random numbers. So give this number if images of one key must agree between machines.
    - `rays`: implementation of the ray queries: "embree" (CPU; Warp elsewhere), "warp" (CPU, CUDA), "jax", or "auto"
      for the first of them that is installed.
    - `compute`: "kernels" for vector kernels on CPUs ([how programs run](how_programs_run.md)), "xla", or "auto" for
      kernels where they can be compiled and JAX has one device. Results agree up to rounding.

    Raises ValueError for options out of range.
    """

    max_depth: int = eqx.field(static=True, default=3)
    boundary: Term | Automatic | None = eqx.field(default="auto", converter=automatic)
    primary: Literal["fixed_ray", "material", "warp"] = eqx.field(static=True, default="fixed_ray")
    sampling: Literal["mis", "emitter"] = eqx.field(static=True, default="mis")
    edge_samples: float | None = eqx.field(static=True, default=None)
    chunk_size: int | None = eqx.field(static=True, default=None)
    rays: str = eqx.field(static=True, default="auto")
    compute: str = eqx.field(static=True, default="auto")

    refusals = (
        STEEP_FILTER,
        ROUGH_GLASS,
        Refusal(
            'mirrors and smooth glass, with `primary="material"` or `"warp"`',
            '`primary="fixed_ray"`',
            _moved_over_mirrors,
        ),
        Refusal(
            "mirrors and smooth glass beside lights without area, from `max_depth=3` on",
            "lights with an area, `max_depth=2`",
            _hard_shadows_over_mirrors,
        ),
        MOVED_JUMPS,
    )

    def __check_init__(self):
        check_depth("PathTracer", self.max_depth)
        for name, known in (
            ("primary", ("fixed_ray", "material", "warp")),
            ("sampling", ("mis", "emitter")),
            ("rays", CHOICES),
            ("compute", COMPUTE),
        ):
            if getattr(self, name) not in known:
                raise ValueError(f"PathTracer: {name} must be one of {', '.join(known)}; got {getattr(self, name)!r}")
        if self.primary == "warp" and not isinstance(self.boundary, WarpedArea | Automatic | None):
            raise ValueError(
                'PathTracer: primary="warp" needs boundary=WarpedArea(...) (or None), got '
                f'{type(self.boundary).__name__}; or take primary="fixed_ray"'
            )
        if isinstance(self.boundary, type) or not isinstance(self.boundary, Term | Automatic | None):
            raise ValueError(
                f'PathTracer: boundary must be "auto", an estimator such as jaxdr.LineSampling(), or None, got '
                f"{shown(self.boundary)}; estimators have name, prepare, draw and image (jaxdr.Term)"
            )
        if any(size is not None and not size > 0 for size in (self.edge_samples, self.chunk_size)):
            raise ValueError("PathTracer: edge_samples and chunk_size must be positive")

    def paths_at_once(self, differentiated: bool) -> int:
        """Number of paths in a chunk. Images without derivatives keep no paths, so their chunks are larger.

        Then the paths that go on fill blocks for more bounces.
        """
        size = self.chunk_size or at_once(cpu=1 << 16, gpu=1 << 20)
        return size if differentiated else 4 * size

    @property
    def settings(self) -> PathSettings:
        """The settings of `transport.path`."""
        return PathSettings(self.max_depth, self.sampling == "mis", self.rays)

    def check(self, scene: Scene) -> None:
        """Raises ValueError for a pixel filter that can't be differentiated."""
        refuse((STEEP_FILTER,), Asked(None, self.settings, scene, primary=self.primary))

    def prepare(
        self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray, apart: bool = False
    ) -> dict[str, Any] | None:
        """States of the terms that this motion needs: if only lights move, only their shadows have a term.

        Raises ValueError for motions that are not covered.
        """
        if self.boundary is None:
            return None
        refuse(self.refusals, Asked(packed, self.settings, scene, moving, self.primary))
        _warn_of_caustics(packed, self.max_depth)
        if self.primary == "warp" and cutting_planes(packed.camera):
            warn_of_cuts()
        return prepare_terms(self._context(packed, moving), self._terms(moving, apart), key, self.compute)

    def _context(self, packed: PackedScene, moving: Moving) -> Context:
        packed = dataclasses.replace(packed, environment_turns=moving.environment)
        form = self._form(packed, any(moving.seen) and self.boundary is not None)
        return Context(packed, moving, self.settings, form, edge_points_per_sample(self))

    def _terms(self, moving: Moving, apart: bool) -> list[Term]:
        """The boundary terms; `apart`: silhouettes and creases as two terms."""
        assert isinstance(self.boundary, Term)  # else nothing is prepared; `render` settles "auto"
        edges: list[Term] = [FilmEdges("silhouettes"), FilmEdges("creases")] if apart else [FilmEdges()]
        if self.primary == "warp":
            assert isinstance(self.boundary, WarpedArea)  # `__check_init__` has checked it
            edges = [WarpedCamera(self.boundary)]
        terms: list[Term] = [*edges, PixelBorders(), FilmChains(), HardShadows()]
        return [*terms, self.boundary] if any(moving.seen) or moving.environment else terms

    def estimate(
        self, packed: PackedScene, prepared: Any, batch: Batch, moving: Moving | None, apart: bool = False
    ) -> dict[str, Float[Array, "H W 3"]]:
        """The part of the image from a batch of samples, by term."""
        if moving is None:
            return self._image(packed, batch)
        context = None if prepared is None else self._context(packed, moving)
        settings, form = self.settings, Form.FIXED
        if context is not None:
            packed, form = context.packed, context.form
        key_path, key_radiance, key_terms = jax.random.split(batch.key, 3)
        primary = primary_samples(packed, batch.samples, batch.key_film, settings.rays, form)
        start = primary.first, primary.direction, primary.u
        settings = settings._replace(pairs=moving.any, black=moving.scattering)
        record = trace_paths(packed, *start, key_path, settings, primary.near)
        radiance = record.radiance * primary.weight[:, None]
        if record.near is not None:
            radiance += near_field_term(packed, primary, record)
        weight = batch.weights(radiance.dtype)
        images = {"interior": pixel_sums(packed, radiance, weight)}
        if context is None or prepared is None:
            return images
        chunk = Chunk(batch.samples, weight, primary, record, key_radiance)
        return images | term_images(context, self._terms(moving, apart), prepared, chunk, key_terms)

    def _image(self, packed: PackedScene, batch: Batch) -> dict:
        """The same in value, for images without derivatives."""
        settings = self.settings
        primary = primary_samples(packed, batch.samples, batch.key_film, settings.rays, Form.FIXED)
        radiance = arriving_radiance(packed, primary.first, primary.direction, primary.u, batch.key, settings)
        return {"interior": pixel_sums(packed, radiance, batch.weights(radiance.dtype))}

    def _form(self, packed: PackedScene, moves: bool) -> Form:
        """How first hits move; see `primary_samples`. If nothing moves, rays are fixed."""
        if not moves:
            return Form.FIXED
        if self.primary != "fixed_ray":
            return Form.MATERIAL
        # Direct light comes from close by only if an emitter touches a surface. It is not worth a second form.
        pixel_filter = packed.camera.film.filter
        return Form.NEAR if (pixel_filter.smooth or pixel_filter.tiles) and self.max_depth > 2 else Form.FIXED


def _warn_of_caustics(packed: PackedScene, max_depth: int) -> None:
    """Warn that the derivative lacks moving caustics of mirrors and smooth glass."""
    if packed.has_delta_lobes and max_depth > 2 and not all(only_delta(group.bsdf) for group in packed.bsdfs):
        warnings.warn(
            "jaxdr: the derivative lacks visibility changes of reflected/refracted light from diffuse surfaces via "
            "delta surfaces. Such a path leaves a surface that spreads light, meets a mirror or smooth glass, and goes "
            "on. What the camera itself sees in mirrors and through smooth glass is complete",
            stacklevel=2,
        )
