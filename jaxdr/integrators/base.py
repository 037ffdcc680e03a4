"""What integrators share: the interfaces of estimators, and sums over samples."""

from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.moving import Moving
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.base import spreads_through
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene, unwrap
from jaxdr.transport.bidirectional import Drawn
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


@runtime_checkable
class Integrator(Protocol):
    """What `render` estimates and how: `prepare` runs once for a derivative, `terms` for every chunk of samples.

    `boundary` is None where only the interior term is wanted.
    """

    max_depth: int
    boundary: Any

    def check(self, scene: Scene) -> None:
        """Raises ValueError for scenes that can't be rendered."""

    def paths_at_once(self, differentiated: bool) -> int:
        """Paths in a chunk."""
        ...

    def prepare(self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray) -> Any:
        """What all chunks share, or None where visibility has no terms. Raises ValueError for what can't move."""
        ...

    def terms(
        self,
        packed: PackedScene,
        prepared: Any,
        samples: Int[Array, " n"],
        key_film: PRNGKeyArray,
        key: PRNGKeyArray,
        spp: int,
        moving: Moving | None,
    ) -> dict[str, Float[Array, "H W 3"]]:
        """Share of the image from the samples numbered `samples` of every pixel; those from `spp` on count zero.

        By term, as in `derivative_terms`; without `moving` the interior's value alone.
        """
        ...


def edge_points_per_sample(integrator) -> float:
    """`edge_samples`, or its default for this depth."""
    if integrator.edge_samples is None:
        return 0.125 if integrator.max_depth <= 2 else 1.0
    return integrator.edge_samples


def sample_weights(samples, spp: int, dtype) -> Float[Array, " n"]:
    """What samples by their numbers count in their pixels."""
    return jnp.where(samples < spp, 1.0 / spp, 0.0).astype(dtype)


def pixel_sums(packed: PackedScene, values: Float[Array, "N 3"], weight: Float[Array, " n"]) -> Float[Array, "H W 3"]:
    """Image of values of all samples, those of a pixel in a row."""
    _, _, width, height = packed.camera.film.window
    return (values.reshape(width * height, -1, 3) * weight[:, None]).sum(1).reshape(height, width, 3)


def check_rough_glass(scene: Scene) -> None:
    """Raises ValueError where the boundary terms of light that spreads through a surface are missing or not tested."""
    for name, shape in scene.shapes.items():
        bsdf = unwrap(shape.bsdf)
        if not spreads_through(bsdf):
            continue
        what = remedy = None
        if isinstance(getattr(bsdf, "bsdf", None), BSDF):
            what, remedy = f"in a {type(bsdf).__name__}", "rough glass alone"
        elif shape.mesh.normal_faces is not None:
            what, remedy = "with interpolated normals", "flat faces"
        elif scene.lights:
            what, remedy = "beside lights without area", "lights with an area"
        if what is not None:
            raise ValueError(
                f"render: visibility changes seen through rough glass {what} have no derivative yet ({name}); take "
                f"{remedy}, differentiate nothing that moves, or boundary=None for the interior term alone"
            )
