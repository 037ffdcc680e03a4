"""Where chords go: a pilot finds the pixels where chords cross something, and every pixel keeps a floor.

For a given path the pilot chords are independent of the chords that are used. So every allocation leaves the estimate
unbiased if each vertex that carries light has a positive expected number of chords.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.safe_divide import safe_divide
from jaxdr.transport.sampler import uniform

POOLING = (1.0, 4.0, 6.0, 4.0, 1.0)  # binomial weights of neighbouring pixels in the pilot's map
SLACK = 6.0  # room for the mean number of chords and so many standard deviations


def capacity(count: int, pixels: int) -> int:
    """Room for `count` chords on average over `pixels`, each of which rounds its share at random."""
    return round(count + SLACK * (0.25 * pixels) ** 0.5 + 1)


def allocate(
    expected: Float[Array, "B P n"], room: int, key: PRNGKeyArray
) -> tuple[Int[Array, " M"], Float[Array, " M"]]:
    """(vertex of each chord or -1, 1 / expected number of chords at this vertex).

    `expected` are numbers of chords for B bounces of n paths in P pixels. Vertices are numbered in the order of this
    array. Within a pixel the numbers are rounded together, so its chords are spread evenly over its vertices. Chords
    beyond `room` are lost; with `capacity` that practically never happens.
    """
    bounces, pixels, samples = expected.shape
    per_pixel = jnp.moveaxis(expected, 0, 1).reshape(pixels, bounces * samples)
    upper = jnp.cumsum(per_pixel, axis=1) + uniform(key, (pixels, 1), expected.dtype)
    upper = jnp.floor(upper).astype(jnp.int32)
    number = jnp.diff(upper, axis=1, prepend=jnp.zeros((pixels, 1), jnp.int32))
    # A running sum may round differently from one entry to the next, also over entries that are zero.
    number = jnp.where(per_pixel > 0, jnp.maximum(number, 0), 0).reshape(-1)
    item = jnp.repeat(jnp.arange(number.shape[0]), number, total_repeat_length=room)
    used = jnp.arange(room) < number.sum()
    inverse = safe_divide(1.0, per_pixel.reshape(-1)[item], used)
    pixel, rest = jnp.divmod(item, bounces * samples)
    bounce, sample = jnp.divmod(rest, samples)
    vertex = (bounce * pixels + pixel) * samples + sample
    return jnp.where(used, vertex, -1), inverse


def shares(importance: Float[Array, "B P n"], total: float) -> Float[Array, "B P n"]:
    """Expected numbers in proportion to `importance`, with the sum `total`."""
    whole = importance.sum()
    return importance * (safe_divide(total, whole))


def pixel_importance(
    score: Float[Array, " M"], pixel: Int[Array, " M"], used, shape: tuple[int, int], floor: float
) -> Float[Array, " P"]:
    """Root mean square score of the pilot's chords in and around every pixel, plus `floor` times its mean."""
    height, width = shape
    slot = jnp.where(used, pixel, height * width)
    power = jnp.zeros(height * width, score.dtype).at[slot].add(score**2, mode="drop")
    count = jnp.zeros(height * width, score.dtype).at[slot].add(1.0, mode="drop")
    power, count = (_pooled(table.reshape(height, width)) for table in (power, count))
    deviation = jnp.sqrt(safe_divide(power, count)).reshape(-1)
    mean = deviation.mean()
    return jnp.where(mean > 0, deviation + floor * mean, 1.0)


def _pooled(table):
    weights = jnp.asarray(POOLING, table.dtype)
    weights = weights / weights.sum()
    half = len(POOLING) // 2
    for axis in (0, 1):
        padded = jnp.pad(table, [(half, half) if a == axis else (0, 0) for a in (0, 1)])
        size = table.shape[axis]
        table = jnp.zeros_like(table)
        for k, weight in enumerate(weights):
            table += weight * jax.lax.slice_in_dim(padded, k, k + size, axis=axis)
    return table
