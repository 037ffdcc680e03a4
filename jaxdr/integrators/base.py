"""What integrators share: the interfaces of estimators, and sums over samples."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.shared.refusals import INTERIOR, Asked, Refusal
from jaxdr.boundary.shared.term import Chunk, Context, Term, detached, named_key
from jaxdr.kernels import computed
from jaxdr.moving import Moving
from jaxdr.scene.bsdf.base import spreads_through
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.scene import Scene, unwrap
from jaxdr.transport.radiance import joined, radiance, split


class Batch(NamedTuple):
    """Numbers of the samples of every pixel that are traced together; those from `spp` on have weight zero."""

    samples: Int[Array, " n"]
    spp: int
    key_film: PRNGKeyArray
    key: PRNGKeyArray

    def weights(self, dtype) -> Float[Array, " n"]:
        """Weights of the samples in their pixels."""
        return jnp.where(self.samples < self.spp, 1.0 / self.spp, 0.0).astype(dtype)


@runtime_checkable
class ConnectedEstimator(Protocol):
    """Boundary terms of N pairs of subpaths, for each of C strategies and with its weight."""

    def prepare(self, context: Context, key: PRNGKeyArray) -> Any: ...

    def estimate_connected(
        self, context: Context, state: Any, chunk: Chunk, weight: Float[Array, "C N"], key: PRNGKeyArray
    ) -> Float[Array, "C N 3"]: ...


def prepare_terms(context: Context, terms: Sequence[Term], key: PRNGKeyArray, compute: str = "xla") -> dict[str, Any]:
    """The states of terms by name, detached. Terms that are zero here are left out. `compute` is as in `computed`."""
    still = context._replace(packed=stop_gradient(context.packed))

    def prepare(key):
        states = {term.name: term.prepare(still, named_key(key, term.name)) for term in terms}
        return {name: state for name, state in states.items() if state is not None}

    # It is short: kernels save time to compile, whatever the number of rows.
    return stop_gradient(computed(prepare, compute, fewest=0)(key))


def term_images(
    context: Context, terms: Sequence[Term], states: dict[str, Any], chunk: Chunk, key: PRNGKeyArray
) -> dict[str, Float[Array, "H W 3"]]:
    """Images of the terms that have a state, by name. One wavefront answers the requests of all terms."""
    terms = [term for term in terms if term.name in states]
    still, still_chunk = detached(context, chunk)
    drawn = _drawn(still, terms, stop_gradient(states), still_chunk, key)
    return {
        term.name: term.image(context, states[term.name], chunk, held, answers)
        for term, held, answers in zip(terms, *drawn, strict=True)
    }


def _drawn(context: Context, terms: Sequence[Term], states: dict[str, Any], chunk: Chunk, key: PRNGKeyArray):
    """(what terms keep for `image`, the answers to their requests or None).

    It is a jitted function: nothing in it is differentiated, so no transformation has to trace through it.
    """

    @jax.jit
    def draw(packed, states, chunk, key):
        here = context._replace(packed=packed)
        drawn = [term.draw(here, states[term.name], chunk, named_key(key, term.name)) for term in terms]
        asked = [requests for requests, _ in drawn if requests is not None]
        answers = iter(())
        if asked:
            answers = iter(split(radiance(packed, joined(asked), chunk.key, context.settings), asked))
        return [held for _, held in drawn], [None if asked is None else next(answers) for asked, _ in drawn]

    return draw(context.packed, states, chunk, key)


@runtime_checkable
class Integrator(Protocol):
    """How `render` estimates images: `prepare` runs once for a derivative, `estimate` for every chunk of samples.

    `boundary` is None for the interior term only.
    """

    max_depth: int
    boundary: Any

    def check(self, scene: Scene) -> None:
        """Raises ValueError for scenes that can't be rendered."""

    def paths_at_once(self, differentiated: bool) -> int:
        """Number of paths in a chunk."""
        ...

    def prepare(self, scene: Scene, packed: PackedScene, moving: Moving, key: PRNGKeyArray, apart: bool = False) -> Any:
        """States for all chunks by term, or None without boundary terms; `apart`: silhouettes and creases by name.

        Raises ValueError for motions that are not covered.
        """
        ...

    def estimate(
        self, packed: PackedScene, prepared: Any, batch: Batch, moving: Moving | None, apart: bool = False
    ) -> dict[str, Float[Array, "H W 3"]]:
        """The part of the image from a batch of samples, by term as in `derivative_terms`.

        Without `moving` it has the interior term only, in value.
        """
        ...


def edge_points_per_sample(integrator) -> float:
    """`edge_samples`, or its default for this depth."""
    if integrator.edge_samples is None:
        return 0.125 if integrator.max_depth <= 2 else 1.0
    return integrator.edge_samples


def _rough_glass(asked: Asked) -> str | None:
    """A message if boundary terms of light that spreads through a surface are missing or not tested; None if not."""
    scene = asked.scene
    for name, shape in scene.shapes.items():
        bsdf = unwrap(shape.bsdf)
        if not spreads_through(bsdf):
            continue
        what = remedy = None
        if bsdf.inside:
            what, remedy = f"in a {type(bsdf).__name__}", "rough glass alone"
        elif shape.mesh.normal_faces is not None:
            what, remedy = "with interpolated normals", "flat faces"
        elif scene.lights:
            what, remedy = "beside lights without area", "lights with an area"
        if what is not None:
            return (
                f"render: visibility changes seen through rough glass {what} have no derivative yet ({name}); take "
                f"{remedy}, differentiate nothing that moves, {INTERIOR}"
            )
    return None


ROUGH_GLASS = Refusal(
    "rough glass in masks, blends and normal maps, with interpolated normals, or beside lights without area",
    "rough glass alone, flat faces, lights with an area",
    _rough_glass,
)
