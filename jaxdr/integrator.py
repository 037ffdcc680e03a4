"""Integrators: what `render` estimates and how, as static settings."""

from typing import Any, Literal, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.kernel_density import KernelDensity
from jaxdr.boundary.warped_area import WarpedArea
from jaxdr.geometry.queries import CHOICES
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.bidirectional import BidirectionalSettings, Drawn
from jaxdr.transport.path import PathRecord, PathSettings
from jaxdr.transport.primary import PrimarySamples


@runtime_checkable
class BoundaryEstimator(Protocol):
    """Boundary term of the segments behind the first hit; see `KernelDensity`, `LineSampling`.

    `prepare` runs once an image and is told which shapes move, or are seen by a camera that does; `estimate` for every
    chunk of its samples.
    """

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Any: ...

    def estimate(
        self,
        packed: PackedScene,
        prepared: Any,
        primary: PrimarySamples,
        record: PathRecord,
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        settings: PathSettings,
    ) -> Float[Array, "N 3"]: ...


@runtime_checkable
class FilmEstimator(Protocol):
    """The same term as an image, from samples that are no path's: see `GuidedEdges`.

    It is zero in value and right in derivative, and an estimate by itself whatever the `count` of path samples that it
    comes with. `form` of the first hits as in `primary_samples`.
    """

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Any: ...

    def film_term(
        self, packed: PackedScene, prepared: Any, count: int, key: PRNGKeyArray, settings: PathSettings, form: str
    ) -> Float[Array, "H W 3"]: ...


@runtime_checkable
class ConnectedEstimator(Protocol):
    """The same for pairs of subpaths: boundary terms of what every strategy contributes, [C, N, 3], with its weight."""

    def prepare(self, packed: PackedScene, moving: tuple[bool, ...], settings: PathSettings) -> Any: ...

    def estimate_connected(
        self,
        packed: PackedScene,
        prepared: Any,
        primary: PrimarySamples,
        drawn: Drawn,
        weight: Float[Array, "C N"],
        sample_index: Int[Array, " N"],
        key: PRNGKeyArray,
        rays: str,
    ) -> Float[Array, "C N 3"]: ...


class PathTracer(eqx.Module):
    """Unidirectional path tracing with next-event estimation; every field is static.

    - `max_depth`: longest path in segments, as Mitsuba counts: 1 = emitters seen directly, 2 = direct light, ...
    - `boundary`: estimator of visibility changes behind the first hit, or None: then the derivative lacks them *and*
      the moving silhouettes and creases in the image (interior term only).
    - `primary`: "fixed_ray" (camera rays stay, moving edges in the image are explicit) or "material" (first hits move
      with their surfaces and the Gaussian pixel filter is differentiated; for discontinuous textures). "warp" is
      "material" with warped areas in place of the silhouettes in the image, for a boundary of `WarpedArea`.
    - `sampling`: "mis" combines emitter and BSDF sampling; "emitter" leaves the BSDF-sampled emission out, which is
      faster where emitters are small and always noisier where they are large or near.
    - `antithetic`: pairs of BSDF samples on opposite sides of the lobe's axis at the first hit (Zhang et al. 2021,
      "Antithetic sampling for Monte Carlo differentiable rendering"): most of the noise of a lobe that is narrow and
      not attached cancels. Give `spp` as an even number.
    - `edge_samples`: points on silhouettes, and as many on creases, in the image per path sample. None: 1/8 for direct
      light, 1 with indirect light, whose noise does not cancel between the two sides of a silhouette.
    - `chunk_size`: paths traced at once, four times as many in images that nobody differentiates; memory is
      proportional to it and independent of the samples per pixel.
    - `rays`: implementation of the ray queries, "embree" (CPU; Warp elsewhere), "warp" (CPU, CUDA), "jax", or "auto"
      for the first of them that is installed.
    """

    max_depth: int = eqx.field(static=True, default=3)
    boundary: BoundaryEstimator | FilmEstimator | None = eqx.field(static=True, default=KernelDensity())
    primary: Literal["fixed_ray", "material", "warp"] = eqx.field(static=True, default="fixed_ray")
    sampling: Literal["mis", "emitter"] = eqx.field(static=True, default="mis")
    antithetic: bool = eqx.field(static=True, default=False)
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
        if self.antithetic and self.primary != "fixed_ray":
            raise ValueError(
                f'PathTracer: antithetic pairs need primary="fixed_ray": "{self.primary}" pairs film offsets'
            )
        if self.primary == "warp" and not isinstance(self.boundary, WarpedArea | None):
            raise ValueError(
                'PathTracer: primary="warp" needs boundary=WarpedArea(...) (or None), got '
                f'{type(self.boundary).__name__}; or take primary="fixed_ray"'
            )
        if (self.edge_samples is not None and not self.edge_samples > 0) or self.chunk_size < 1:
            raise ValueError("PathTracer: edge_samples and chunk_size must be positive")
        if self.settings.attached > 0 and self.sampling == "emitter":
            raise ValueError(
                'PathTracer: attached lobes need sampling="mis": emitters seen in a narrow lobe are found by '
                "its own samples; or set attached=0"
            )

    @property
    def edge_points_per_sample(self) -> float:
        """`edge_samples`, or its default for this depth."""
        return _edge_points_per_sample(self)

    def paths_at_once(self, differentiated: bool) -> int:
        """Paths in a chunk: more in an image that nobody differentiates, which keeps nothing of them.

        So those that go on fill blocks for longer.
        """
        return self.chunk_size if differentiated else 4 * self.chunk_size

    @property
    def settings(self) -> PathSettings:
        """What the path tracer itself needs."""
        attached = getattr(self.boundary, "attached", 0.0)
        return PathSettings(self.max_depth, self.sampling == "mis", self.rays, attached)


def _edge_points_per_sample(integrator) -> float:
    if integrator.edge_samples is None:
        return 0.125 if integrator.max_depth <= 2 else 1.0
    return integrator.edge_samples


HEURISTICS = {"balance": 1, "power": 2}  # the powers of densities that weights are shares of


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

    @property
    def edge_points_per_sample(self) -> float:
        """`edge_samples`, or its default for this depth."""
        return _edge_points_per_sample(self)

    def paths_at_once(self, differentiated: bool) -> int:
        """Pairs of subpaths in a chunk."""
        del differentiated
        return max(1, self.chunk_size // max(1, (self.max_depth - 1) * (self.max_depth + 2) // 2))

    @property
    def settings(self) -> BidirectionalSettings:
        """What the tracer itself needs."""
        return BidirectionalSettings(self.max_depth, HEURISTICS[self.heuristic], self.rays)
