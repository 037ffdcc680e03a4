"""Arrays from values of users and files, without compiling: `jnp.asarray` compiles a conversion for every shape.

Under `jit` it makes a traced array of any value. Here values stay concrete unless they are traced themselves. So
whatever is made of concrete values is the same inside `jit`.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array

from jaxdr.argument_kinds import made_of_numbers, shown

HOST = (np.ndarray, np.generic, bool, int, float)


def traced(*values: Any) -> bool:
    """Whether a value, or a part of one, is traced."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def as_array(value, dtype: DTypeLike | None = float) -> Array:
    """`jnp.asarray(value, dtype)`. Values on the host are converted and copied there, and then put on the device."""
    if traced(value):
        return jnp.asarray(value, dtype)
    with jax.ensure_compile_time_eval():
        if not all(isinstance(leaf, HOST) and np.asarray(leaf).dtype.kind in "biuf" for leaf in jax.tree.leaves(value)):
            return jnp.asarray(value, dtype)
        with np.errstate(over="ignore"):  # an overflow becomes inf, as in JAX
            return jax.device_put(np.array(value, dtype and jnp.result_type(dtype)))


def as_numbers(value, name: str) -> Array:
    """`as_array` of what a user gives for `name`. Raises ValueError, with the name, for what is not made of numbers."""
    if not made_of_numbers(value):
        raise ValueError(f"{name} must be made of numbers, got {shown(value)}")
    return as_array(value)


def on_host(array: Array) -> Array | np.ndarray:
    """The array as a NumPy array, unless it is traced. For computations whose result goes into `as_array`."""
    return array if isinstance(array, Tracer) else np.asarray(array)


def numpy_for(*values: Any) -> Any:
    """`jax.numpy` if a value is traced, else NumPy. For computations whose result goes into `as_array`."""
    return jnp if traced(*values) else np


def broadcast(array: Array, shape: tuple[int, ...]) -> Array:
    """`jnp.broadcast_to`, on the host unless the array is traced."""
    known = on_host(array)
    if isinstance(known, np.ndarray):
        return as_array(np.broadcast_to(known, shape), known.dtype)
    return jnp.broadcast_to(array, shape)
