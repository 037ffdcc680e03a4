"""Arrays of what users and files give, without compiling: `jnp.asarray` compiles a conversion for every shape."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array

HOST = (np.ndarray, np.generic, bool, int, float)


def as_array(value, dtype: DTypeLike | None = float) -> Array:
    """`jnp.asarray(value, dtype)`; what is on the host is converted there, copied, and put on the device as it is."""
    if not all(isinstance(leaf, HOST) and np.asarray(leaf).dtype.kind in "biuf" for leaf in jax.tree.leaves(value)):
        return jnp.asarray(value, dtype)
    with np.errstate(over="ignore"):  # inf, as in JAX
        return jax.device_put(np.array(value, dtype and jnp.result_type(dtype)))


def on_host(array: Array) -> Array | np.ndarray:
    """The array, in NumPy unless it is traced: for steps whose result `as_array` takes."""
    return array if isinstance(array, Tracer) else np.asarray(array)


def broadcast(array: Array, shape: tuple[int, ...]) -> Array:
    """`jnp.broadcast_to`."""
    known = on_host(array)
    if isinstance(known, np.ndarray):
        return as_array(np.broadcast_to(known, shape), known.dtype)
    return jnp.broadcast_to(array, shape)
