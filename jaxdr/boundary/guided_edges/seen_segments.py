"""Boundary segments in slots, as the camera sees them: requests for what their sources scatter, and their image."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.boundary.guided_edges.beam import Detected, image
from jaxdr.boundary.guided_edges.boundary_segments import BoundaryEnds, BoundarySegments
from jaxdr.boundary.guided_edges.edge_lunes import EdgeLunes
from jaxdr.boundary.shared.blocks import sum_over_blocks
from jaxdr.boundary.shared.term import stream_of
from jaxdr.scene.packed import PackedScene
from jaxdr.transport.primary import Form
from jaxdr.transport.radiance import Requests, request
from jaxdr.transport.sampler import path_numbers


class SeenSegments(NamedTuple):
    """Segments in slots, and how the camera sees them (as in `Detected`, but with the slots first); detached.

    `sent`: emission of the source. `emitted`, `scattered`: one over the density of the segment, for light that the
    source emits and scatters; zero where it does not count.
    """

    segments: BoundarySegments
    ends: BoundaryEnds
    value: Float[Array, "n B 3"]
    film_point: Float[Array, "n B 2"]
    lens: Float[Array, "n 2"] | None
    sent: Float[Array, "n 3"]
    emitted: Float[Array, "n B"]
    scattered: Float[Array, "n B"]


class DrawnSegments(NamedTuple):
    """Segments in slots, of which the first `used` are filled."""

    rows: SeenSegments
    used: Int[Array, ""]


def seen_segments(
    segments: BoundarySegments,
    ends: BoundaryEnds,
    seen: Detected,
    sent: Float[Array, "n 3"],
    emitted: Float[Array, "B n"],
    scattered: Float[Array, "B n"],
) -> SeenSegments:
    """Segments with what the camera sees of them."""
    value, film_point = seen.value.swapaxes(0, 1), seen.film_point.swapaxes(0, 1)
    return SeenSegments(segments, ends, value, film_point, seen.lens, sent, emitted.T, scattered.T)


def ask_sources(
    rows: SeenSegments, slot: Int[Array, " n"], name: str, key: PRNGKeyArray, max_depth: int
) -> list[Requests]:
    """Requests for what sources scatter, for every number of bounces on the detector's side; the source has the rest.

    `slot` and the term's `name` choose random numbers.
    """
    lit = (rows.value != 0).any(-1) & (rows.scattered != 0)
    # Not from the lattice of the segments: these numbers would differ from theirs by a constant shift.
    numbers = path_numbers(key, slot, 0, rows.value.dtype)
    stream, asked = stream_of(name) + slot.astype(jnp.uint32), []
    for b in range(max_depth - 2):
        bounces = jnp.where(lit[:, b], max_depth - 2 - b, 0)
        asked.append(request(rows.ends.source, -rows.segments.towards, numbers, bounces, stream, 0.0))
    return asked


def segments_image(
    packed: PackedScene,
    lunes: EdgeLunes,
    drawn: DrawnSegments,
    scattered: Float[Array, "A 3"] | None,
    form: Form,
) -> Float[Array, "H W 3"]:
    """The image of segments: zero in value, right in derivative.

    `scattered`: the answers to all requests of `ask_sources`, one number of bounces after the other.
    """
    gathered = None
    if scattered is not None:
        gathered = scattered.reshape(-1, drawn.rows.sent.shape[0], 3).swapaxes(0, 1)

    def values(block, number):
        block, gathered = block
        radiance = block.sent[:, None] * block.emitted[:, :, None]
        if gathered is not None:
            radiance = radiance.at[:, :-1].add(gathered * block.scattered[:, :-1, None])
        radiance = jnp.where((number < drawn.used)[:, None, None], radiance, 0.0)
        seen = Detected(block.value.swapaxes(0, 1), block.film_point.swapaxes(0, 1), block.lens)
        return image(packed, lunes, block.segments, block.ends, seen, radiance.swapaxes(0, 1), form)

    return sum_over_blocks(values, (drawn.rows, gathered), drawn.used)
