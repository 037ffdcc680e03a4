"""Random numbers of a path: reproducible, independent for every pixel and bounce, spread evenly in a pixel."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Integer, PRNGKeyArray

from jaxdr.safe_divide import safe_divide
from jaxdr.transport.keys import hashed

FIRST_DIMENSIONS = 6  # film point, then emitter and BSDF at the first hit
LENS_DIMENSIONS = 2  # after those, with an aperture


def _generators(dimensions: int) -> list[int]:
    """Generalised golden ratio sequence (Roberts 2018) as 32-bit fixed-point steps."""
    root = 1.0
    for _ in range(64):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return [int(2.0**32 * root ** -(k + 1)) for k in range(dimensions)]


def to_unit(bits, dtype) -> Float[Array, "..."]:
    """Uniform numbers in [0, 1) from 32 random bits: 24 of them, so that float32 never rounds up to 1."""
    return (bits >> 8).astype(dtype) * dtype(2.0**-24)


def uniform(key: PRNGKeyArray, shape: tuple[int, ...], dtype=jnp.float32) -> Float[Array, "..."]:
    """Independent uniform numbers in [0, 1), the same in every precision."""
    return to_unit(jax.random.bits(key, shape, jnp.uint32), jnp.dtype(dtype).type)


def lattice(
    key: PRNGKeyArray, pixels: int, index: Int[Array, " n"], dimensions: int, dtype=jnp.float32
) -> Float[Array, "N d"]:
    """Points of a rank-1 lattice, shifted at random for every pixel (Cranley-Patterson rotation), N = pixels * n rows.

    Each point is uniform on the unit cube, so estimates are unbiased. The points of a pixel fill the cube evenly, so
    estimates have less noise than with independent points. `index` numbers a pixel's samples across chunks.
    """
    shift = jax.random.bits(key, (pixels, dimensions), jnp.uint32)
    steps = jnp.asarray(_generators(dimensions), jnp.uint32)
    index = index.astype(jnp.uint32)
    if pixels > 1:  # one row for every sample: broadcasts of [pixels, n, d] have other rows
        row, count = jnp.arange(pixels * index.shape[0], dtype=jnp.uint32), jnp.uint32(index.shape[0])
        shift, index = shift[jax.lax.div(row, count)], index[jax.lax.rem(row, count)]
    return to_unit(shift + index[:, None] * steps, jnp.dtype(dtype).type)


def path_numbers(key: PRNGKeyArray, number: Integer[Array, " n"], bounce: Int[Array, "*#n"] | int, dtype=jnp.float32):
    """Four uniform numbers for every path at a bounce, or at a bounce of its own, [n, 4]; they do not depend on the
    path's row.

    They are a hash of the path's number, the bounce and two words from the key.
    """
    words = jax.random.bits(key, (2,), jnp.uint32)
    bounce = jnp.asarray(bounce).astype(jnp.uint32) ^ jnp.zeros_like(number, jnp.uint32)
    found = hashed([number.astype(jnp.uint32), bounce, words[0], words[1]])
    return to_unit(jnp.stack(found, -1), jnp.dtype(dtype).type)


def seed_of(key: PRNGKeyArray) -> Int[Array, ""]:
    """A seed below 2^30 for the queries, which have their own random generators."""
    return (jax.random.bits(key, (), jnp.uint32) >> 2).astype(jnp.int32)


def sample_cdf(
    cdf: Float[Array, " K"], target: Float[Array, " n"]
) -> tuple[Int[Array, " n"], Float[Array, " n"], Float[Array, " n"]]:
    """(entries of cumulative sums into which numbers in [0, total) fall, fractions of these entries, their masses)."""
    entry = jnp.clip(jnp.searchsorted(cdf, target, side="right"), 0, cdf.shape[0] - 1)
    before = jnp.where(entry > 0, cdf[entry - 1], 0.0)
    mass = cdf[entry] - before
    return entry, jnp.clip(safe_divide(target - before, mass, mass > 0), 0.0, 1.0), mass
