"""Bidirectional path tracing with boundary terms."""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.argument_kinds import checked
from jaxdr.boundary.film.film_edges import FilmEdges
from jaxdr.boundary.shared.refusals import INTERIOR, Asked, Refusal, refuse
from jaxdr.boundary.shared.term import Chunk, Context, Term
from jaxdr.geometry.queries import CHOICES
from jaxdr.integrators.base import (
    ROUGH_GLASS,
    Batch,
    ConnectedEstimator,
    edge_points_per_sample,
    prepare_terms,
    term_images,
)
from jaxdr.integrators.choice import Automatic, automatic
from jaxdr.kernels import CHOICES as COMPUTE
from jaxdr.moving import Moving
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene
from jaxdr.sizes import at_once
from jaxdr.transport.bidirectional import BidirectionalSettings, Strategies, bidirectional_paths
from jaxdr.transport.emission import has_emitters
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form
from jaxdr.whole_numbers import check_depth

HEURISTICS = {"balance": 1, "power": 2}  # weights are shares of the densities to this power


class _Connected:
    """The term of a `ConnectedEstimator`, for the pairs of subpaths of a chunk."""

    name = "boundary"

    def __init__(self, estimator: ConnectedEstimator):
        self.estimator = estimator

    def prepare(self, context: Context, key: PRNGKeyArray) -> Any:
        return self.estimator.prepare(context, key)

    def draw(self, context: Context, state, chunk: Chunk, key: PRNGKeyArray):
        return None, key

    def image(self, context: Context, state, chunk: Chunk, held: PRNGKeyArray, answers) -> Float[Array, "H W 3"]:
        packed, film = context.packed, context.packed.camera.film
        found: Strategies = chunk.record
        _, _, width, height = film.window
        if found.drawn is None or not has_emitters(packed):
            return jnp.zeros((height, width, 3), found.value.dtype)
        weight = jnp.where((found.value != 0).any(-1), found.weight, 0.0)
        values = self.estimator.estimate_connected(context, state, chunk, weight, held)
        return found.image(film, values, chunk.weight, False)


_NAME, _REMEDY = "BidirectionalPathTracer", "take PathTracer(boundary=None) for the interior term of what moves"


def _moves(asked: Asked) -> bool:
    return any(asked.moving.seen) or any(asked.moving.lights)


def _moved_over_mirrors(asked: Asked) -> str | None:
    if not (asked.packed.has_delta_lobes and _moves(asked)):
        return None
    return f"render: a {_NAME} has no derivative by what moves in scenes with mirrors or smooth glass; {_REMEDY}"


def _steep_filter(asked: Asked) -> str | None:
    pixel_filter = asked.packed.camera.film.filter
    if not any(asked.moving.seen) or pixel_filter.smooth:
        return None
    return (
        f"render: a {_NAME} differentiates the pixel filter where surfaces move, and a "
        f"{type(pixel_filter).__name__} has no derivative of finite variance; use Gaussian, or {_REMEDY}"
    )


def _hard_shadows(asked: Asked) -> str | None:
    if not (asked.packed.light_count and _moves(asked)):
        return None
    return (
        f"render: shadows of lights without area have no derivative with a {_NAME}; take lights "
        f"with an area, PathTracer, {INTERIOR}"
    )


@checked
class BidirectionalPathTracer(eqx.Module):
    """Bidirectional path tracing (Veach 1997, chapter 10): the same image as `PathTracer`. All fields are static.

    Paths from the camera and from emitters are joined in all ways. Caustics and light from behind corners need a
    fraction of the samples; everything else takes more time. The image also has light of points, spots, projectors and
    parallel lights that mirrors and smooth glass throw onto surfaces. No path from the camera finds this light.

    Derivatives by parameters that move nothing (reflectance, roughness, radiance, intensity, textures, also the
    rotation of an environment) need no boundary terms. In derivatives by vertices or the camera all vertices of paths
    are material points, also the first hits. So the pixel filter is differentiated, and it must be Gaussian if surfaces
    move in the image.

    - `max_depth`: longest path in segments, as in `PathTracer`.
    - `heuristic`: "balance" or "power" (2) combination of all ways to find a path.
    - `boundary`: `KernelDensity` ("auto") or `WarpedArea`, for visibility changes behind the first hit, or None for the
      interior term only. Silhouettes in the image are explicit, as in `PathTracer`.
    - `edge_samples`, `rays`, `compute`: as in `PathTracer`.
    - `chunk_size`: connections made at once, (max_depth - 1) (max_depth + 2) / 2 for every sample. Memory is
      proportional to it, and independent of the samples per pixel. A chunk has at least one sample of every pixel.
      None: 262,144 on CPUs and 2,097,152 elsewhere.

    Raises ValueError for boundary terms of lights without area. In scenes with mirrors or smooth glass it raises
    ValueError for derivatives by anything that moves, by the index of smooth glass and by normals of mirrors.
    """

    max_depth: int = eqx.field(static=True, default=3)
    heuristic: Literal["balance", "power"] = eqx.field(static=True, default="power")
    boundary: ConnectedEstimator | Term | Automatic | None = eqx.field(static=True, default="auto", converter=automatic)
    edge_samples: float | None = eqx.field(static=True, default=None)
    chunk_size: int | None = eqx.field(static=True, default=None)
    rays: str = eqx.field(static=True, default="auto")
    compute: str = eqx.field(static=True, default="auto")

    motion_refusals = (
        Refusal("what moves, in scenes with mirrors or smooth glass", "`PathTracer`", _moved_over_mirrors),
        Refusal("surfaces that move, under a filter other than Gaussian", "`Gaussian`, `PathTracer`", _steep_filter),
    )
    boundary_refusals = (
        ROUGH_GLASS,
        Refusal("shadows of lights without area", "lights with an area, `PathTracer`", _hard_shadows),
    )
    refusals = motion_refusals + boundary_refusals

    def __check_init__(self):
        name = "BidirectionalPathTracer"
        check_depth(name, self.max_depth)
        for field, known in (("heuristic", tuple(HEURISTICS)), ("rays", CHOICES), ("compute", COMPUTE)):
            if getattr(self, field) not in known:
                raise ValueError(f"{name}: {field} must be one of {', '.join(known)}; got {getattr(self, field)!r}")
        connected = isinstance(self.boundary, ConnectedEstimator | Automatic | None)
        if isinstance(self.boundary, type) or not connected:
            estimator = type(self.boundary).__name__
            raise ValueError(
                f'{name}: boundary must be "auto", KernelDensity(...), WarpedArea(...) or None; {estimator} has no '
                f"form for connected subpaths: for it take PathTracer(boundary={estimator}(...))"
            )
        if self.edge_samples is not None and not self.edge_samples > 0:
            raise ValueError(f"{name}: edge_samples must be positive")
        if self.chunk_size is not None and self.chunk_size < 1:
            raise ValueError(f"{name}: chunk_size must be positive")

    def paths_at_once(self, differentiated: bool) -> int:
        """Pairs of subpaths in a chunk."""
        del differentiated
        size = self.chunk_size or at_once(cpu=1 << 18, gpu=1 << 21)
        return max(1, size // max(1, (self.max_depth - 1) * (self.max_depth + 2) // 2))

    @property
    def settings(self) -> BidirectionalSettings:
        """The settings of `transport.bidirectional`."""
        return BidirectionalSettings(self.max_depth, HEURISTICS[self.heuristic], self.rays)

    def check(self, scene: Scene) -> None:
        """Does nothing: all scenes can be rendered."""

    def prepare(
        self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray, apart: bool = False
    ) -> dict[str, Any] | None:
        """States of the edges in the image and of the estimator; None without boundary terms.

        Raises ValueError for motions that are not covered.
        """
        del apart
        asked = Asked(packed, self._context(packed, moving).settings, scene, moving)
        refuse(self.motion_refusals, asked)
        if not isinstance(self.boundary, ConnectedEstimator):
            return None  # `boundary` is None
        refuse(self.boundary_refusals, asked)
        if not any(moving.seen):
            return None
        return prepare_terms(self._context(packed, moving), self._terms(), key, self.compute)

    def _context(self, packed: PackedScene, moving: Moving) -> Context:
        settings = PathSettings(self.max_depth, True, self.rays)
        return Context(packed, moving, settings, Form.MATERIAL, edge_points_per_sample(self))

    def _terms(self) -> list[Term]:
        """The boundary terms. First hits are material points, so creases have no term."""
        assert isinstance(self.boundary, ConnectedEstimator)  # else nothing is prepared
        return [FilmEdges("silhouettes"), _Connected(self.boundary)]

    def estimate(
        self, packed: PackedScene, prepared: Any, batch: Batch, moving: Moving | None, apart: bool = False
    ) -> dict[str, Float[Array, "H W 3"]]:
        """The part of the image from a batch of samples, by term."""
        del apart
        material = moving is not None and any(moving.seen)
        key_path, key_radiance, key_terms = jax.random.split(batch.key, 3)
        primary, found = bidirectional_paths(packed, batch.samples, batch.key_film, key_path, self.settings, material)
        share = batch.weights(found.value.dtype)
        value = found.value * found.weight[..., None]
        images = {"interior": found.image(packed.camera.film, value, share, material)}
        if prepared is None:
            return images
        assert moving is not None  # `prepared` was made for it
        chunk = Chunk(batch.samples, share, primary, found, key_radiance)
        return images | term_images(self._context(packed, moving), self._terms(), prepared, chunk, key_terms)
