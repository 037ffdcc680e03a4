"""Keys inside a rendering: JAX keys whose generator is a hash of four words.

A program derives dozens of keys. JAX's default generator, Threefry, compiles each derivation to a loop on CPUs, which
makes up a large part of all kernels. So inside a rendering the keys use the hash pcg4d. `jax.random` accepts them like
all keys.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.random import define_prng_impl
from jaxtyping import Array, PRNGKeyArray, UInt32

WORDS = 4
NAME = "jaxdr_pcg4d"
# Purposes of derived words: each has a different constant.
_BITS, _SPLIT, _FOLD_IN = 0x00000000, 0x9E3779B9, 0x85EBCA6B


def inner_key(key: PRNGKeyArray) -> PRNGKeyArray:
    """The key of a rendering, from 128 random bits of any JAX key. Keys made here stay as they are."""
    if jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and jax.random.key_impl(key) == pcg4d:
        return key
    return jax.random.wrap_key_data(jax.random.bits(key, (WORDS,), jnp.uint32), impl=pcg4d)


def fixed_key(seed: int) -> PRNGKeyArray:
    """A key that is the same for every rendering."""
    return jax.random.key(seed, impl=pcg4d)


def hashed(words: list[UInt32[Array, "*#n"]]) -> list[UInt32[Array, "*n"]]:
    """Hash four words to four words: pcg4d of Jarzynski and Olano 2020, "Hash functions for GPU rendering"."""
    words = [word * jnp.uint32(1664525) + jnp.uint32(1013904223) for word in words]
    return _mixed([word ^ (word >> 16) for word in _mixed(words)])


def _mixed(words: list) -> list:
    x, y, z, w = words
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    return [x, y, z, w]


def _drawn(key: UInt32[Array, " 4"], number: UInt32[Array, "*n"], purpose: int) -> UInt32[Array, "*n 4"]:
    """Four words for each number."""
    a, b, c, d = (jnp.squeeze(word, 0) for word in jax.lax.split(key, (1,) * WORDS))
    words = hashed([number + a, b, c, d ^ jnp.uint32(purpose)])
    return jnp.stack([jnp.broadcast_to(word, number.shape) for word in words], -1)


def _derived(key: UInt32[Array, " 4"], number: UInt32[Array, "*n"], purpose: int) -> UInt32[Array, "*n 4"]:
    """A key for each number.

    The remainder changes one word in 65,536. It is there for XLA, which repeats chains of cheap operations in every
    kernel that uses their result: the chain of a key's ancestors would double with each ancestor. XLA takes a division
    by an unknown number for expensive, so it ends a kernel here and keeps the result.
    """
    words = _drawn(key, number, purpose)
    return jax.lax.rem(words, words | jnp.uint32(0xFFFF0000))


def _seed(seed: Any) -> UInt32[Array, " 4"]:
    return _fold_in(jnp.zeros(WORDS, jnp.uint32), seed)


def _split(key: UInt32[Array, " 4"], shape: tuple[int, ...]) -> UInt32[Array, "*shape 4"]:
    return _derived(key, _numbers(shape), _SPLIT)


def _fold_in(key: UInt32[Array, " 4"], number: Any) -> UInt32[Array, " 4"]:
    return _derived(key, jnp.asarray(number, jnp.uint32), _FOLD_IN)


def _random_bits(key: UInt32[Array, " 4"], width: int, shape: tuple[int, ...]) -> Array:
    if width == 64:
        high, low = jnp.unstack(_random_bits(key, 32, (2, *shape)))
        return high.astype(jnp.uint64) << 32 | low.astype(jnp.uint64)
    size = _size(shape)
    words = _drawn(key, _numbers((-(-size // WORDS),)), _BITS).reshape(-1)[:size].reshape(shape)
    return words if width == 32 else (words >> (32 - width)).astype(f"uint{width}")


def _numbers(shape: tuple[int, ...]) -> UInt32[Array, "*shape"]:
    return jnp.arange(_size(shape), dtype=jnp.uint32).reshape(shape)


def _size(shape: tuple[int, ...]) -> int:
    size = 1
    for length in shape:
        size *= length
    return size


pcg4d = define_prng_impl(
    key_shape=(WORDS,), seed=_seed, split=_split, random_bits=_random_bits, fold_in=_fold_in, name=NAME, tag="pcg4"
)
