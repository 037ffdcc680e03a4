"""The interface of every term of a derivative that visibility brings.

A term is prepared once for an image. For every chunk of samples it then draws, in value alone, what it needs: points on
boundaries, and requests for the radiance that meets there. One wavefront answers the requests of all terms of the chunk
(`transport.radiance`), and each term says what the answers are worth on the film: an image that is zero in value and
right in derivative. Every estimator of the boundary integral behind the first hit is such a term.
"""

import zlib
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt32

from jaxdr.geometry.vector import scale
from jaxdr.moving import Moving
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.path import PathSettings
from jaxdr.transport.primary import PrimarySamples
from jaxdr.transport.radiance import Answers, Requests


class Context(NamedTuple):
    """What all chunks of an image share. All but the scene is static.

    - `packed`: the scene as arrays.
    - `moving`: what moves in the derivative.
    - `settings`: depth, sampling and ray queries of the path tracer.
    - `form`: how first hits move, see `primary_samples`.
    - `edge_samples`: points on edges in the image, per path sample.
    """

    packed: PackedScene
    moving: Moving
    settings: PathSettings
    form: str
    edge_samples: float


class Chunk(NamedTuple):
    """n samples of every pixel, and their paths.

    - `samples` [n]: their numbers within the pixel.
    - `weight` [n]: what each counts in its pixel.
    - `primary`: film points, camera rays and first hits, N = pixels x n rows.
    - `record`: the paths behind the first hits.
    - `key`: that of the wavefront; the numbers of requests' bounces are drawn from it.
    """

    samples: Int[Array, " n"]
    weight: Float[Array, " n"]
    primary: PrimarySamples
    record: Any  # a PathRecord; of a BidirectionalPathTracer its Strategies
    key: PRNGKeyArray

    @property
    def paths(self) -> int:
        """Number of paths: pixels x samples."""
        return self.primary.direction.shape[0]

    @property
    def share(self) -> Float[Array, ""]:
        """What an estimate of the whole film counts."""
        return self.weight.sum()

    def image(self, packed: PackedScene, values: Float[Array, "N 3"]) -> Float[Array, "H W 3"]:
        """Image of values of all paths, those of a pixel in a row."""
        return pixel_sums(packed, values, self.weight)


@runtime_checkable
class Term(Protocol):
    """One term of the derivative of an image. Any class with these members is a boundary estimator.

    `name` is its key in `derivative_terms`, and chooses its random numbers. `draw` gets everything detached, so nothing
    in it is differentiated. `image` gets the same context and chunk as they move, and what `draw` held.
    """

    @property
    def name(self) -> str: ...

    def prepare(self, context: Context, key: PRNGKeyArray) -> Any:
        """What all chunks share, or None where the term is nothing. Raises ValueError for what it does not cover."""
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
    """A key of its own for everything that has a name."""
    return jax.random.fold_in(key, zlib.crc32(name.encode()) & 0x7FFFFFFF)


def streams(name: str, count: int) -> UInt32[Array, " n"]:
    """Streams of random numbers for the requests of a term, apart from those of others."""
    return jnp.arange(count, dtype=jnp.uint32) + stream_of(name)


def stream_of(name: str) -> UInt32[Array, ""]:
    """The first of them."""
    return jnp.uint32(zlib.crc32(name.encode()))


def detached(context: Context, chunk: Chunk) -> tuple[Context, Chunk]:
    """The same in value alone."""
    primary, record = stop_gradient((chunk.primary, chunk.record))
    return context._replace(packed=stop_gradient(context.packed)), chunk._replace(primary=primary, record=record)


def pixel_sums(packed: PackedScene, values: Float[Array, "N 3"], weight: Float[Array, " n"]) -> Float[Array, "H W 3"]:
    """Image of values of all samples, those of a pixel in a row; `weight` of the samples by their numbers."""
    _, _, width, height = packed.camera.film.window
    return scale(values.reshape(width * height, -1, 3), weight).sum(1).reshape(height, width, 3)
