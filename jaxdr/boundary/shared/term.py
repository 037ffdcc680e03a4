"""The interface of every term of a derivative that comes from visibility.

A term is prepared once for an image. Then, for every chunk of samples, it draws points on boundaries and requests for
the radiance there; this part is detached. One wavefront answers the requests of all terms of the chunk
(`transport.radiance`). From the answers each term makes an image that is zero in value and right in derivative. Every
estimator of the boundary integral behind the first hit is such a term.
"""

import zlib
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from jaxdr.boundary.shared.kinds import KINDS
from jaxdr.geometry.vector import scale
from jaxdr.moving import Moving
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, PrimarySamples
from jaxdr.transport.radiance import Answers, Requests


class Context(NamedTuple):
    """What is the same for all chunks of an image. All but the scene is static.

    - `packed`: the scene as arrays.
    - `moving`: what moves in the derivative.
    - `settings`: depth, sampling and ray queries of the path tracer.
    - `form`: how first hits move; see `primary_samples`.
    - `edge_samples`: points on edges in the image, per path sample.
    - `kinds`: of boundary segments that a term is asked for (`kinds.KINDS`). Only terms with `takes_kinds = True` are
      asked for less than all.
    """

    packed: PackedScene
    moving: Moving
    settings: PathSettings
    form: Form
    edge_samples: float
    kinds: tuple[str, ...] = KINDS


class Chunk(NamedTuple):
    """n samples of every pixel, and their paths.

    - `samples` [n]: their numbers within the pixel.
    - `weight` [n]: their weights in the pixel.
    - `primary`: film points, camera rays and first hits, in N = pixels x n rows.
    - `record`: the paths behind the first hits.
    - `key`: the wavefront's key. It gives the random numbers of the requests' bounces.
    """

    samples: Int[Array, " n"]
    weight: Float[Array, " n"]
    primary: PrimarySamples
    record: Any  # a PathRecord, or the Strategies of a BidirectionalPathTracer
    key: PRNGKeyArray

    @property
    def paths(self) -> int:
        """Number of paths: pixels x samples."""
        return self.primary.direction.shape[0]

    @property
    def share(self) -> Float[Array, ""]:
        """The weight of an estimate of the whole film from this chunk."""
        return self.weight.sum()

    def image(self, packed: PackedScene, values: Float[Array, "N 3"]) -> Float[Array, "H W 3"]:
        """The image of values of all paths; the paths of a pixel are in a row."""
        return pixel_sums(packed, values, self.weight)


@runtime_checkable
class Term(Protocol):
    """One term of the derivative of an image. Any class with these members is a boundary estimator.

    `name` is its key in `derivative_terms`, and chooses its random numbers. `draw` gets everything detached, so nothing
    in it is differentiated. `image` gets the differentiable context and chunk, and what `draw` returned.
    """

    @property
    def name(self) -> str: ...

    def prepare(self, context: Context, key: PRNGKeyArray) -> Any:
        """State for all chunks, or None if the term is zero. Raises ValueError for what it does not cover."""
        ...

    def draw(self, context: Context, state: Any, chunk: Chunk, key: PRNGKeyArray) -> tuple[Requests | None, Any]:
        """(requests for radiance, or None; what `image` needs)."""
        ...

    def image(
        self, context: Context, state: Any, chunk: Chunk, held: Any, answers: Answers | None
    ) -> Float[Array, "H W 3"]:
        """The term's image: zero in value, right in derivative."""
        ...


def named_key(key: PRNGKeyArray, name: str) -> PRNGKeyArray:
    """A key for a name, different for each name."""
    return jax.random.fold_in(key, zlib.crc32(name.encode()) & 0x7FFFFFFF)


def streams(name: str, count: int) -> UInt32[Array, " n"]:
    """Numbers of random streams for the requests of a term, different from those of other terms."""
    return jnp.arange(count, dtype=jnp.uint32) + stream_of(name)


def stream_of(name: str) -> UInt32[Array, ""]:
    """The first stream of a term."""
    return jnp.uint32(zlib.crc32(name.encode()))


def detached(context: Context, chunk: Chunk) -> tuple[Context, Chunk]:
    """The same context and chunk, detached."""
    primary, record = stop_gradient((chunk.primary, chunk.record))
    return context._replace(packed=stop_gradient(context.packed)), chunk._replace(primary=primary, record=record)


def pixel_sums(packed: PackedScene, values: Float[Array, "N 3"], weight: Float[Array, " n"]) -> Float[Array, "H W 3"]:
    """The image of values of all samples; the samples of a pixel are in a row. `weight`: of each sample of a pixel."""
    _, _, width, height = packed.camera.film.window
    return scale(values.reshape(width * height, -1, 3), weight).sum(1).reshape(height, width, 3)
