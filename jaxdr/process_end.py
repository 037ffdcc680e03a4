"""The end of a process while programs still run that call Python.

XLA runs programs in the background. Queries of rays by Warp and Embree are Python. A program that asks for one when
Python is gone never ends, and XLA waits for it. JAX itself waits for programs with its own kinds of callbacks.
"""

import atexit
import contextlib
import functools

import jax


@functools.cache
def wait_at_exit() -> None:
    """Let this process end only when its programs have ended. Called while programs with queries are traced.

    `atexit` calls last what was registered first. JAX was, so its backends are still there.
    """
    atexit.register(_wait)


def _wait() -> None:
    """Wait for all results that somebody holds, and for the programs that this thread has started.

    What another thread has started and whose result nobody holds is not waited for: JAX does not know of it.
    """
    for array in jax.live_arrays():
        _finish(array)
    for device in jax.local_devices():
        # A device runs programs of one thread in their order. So this one is the last.
        _finish(jax.device_put(0.0, device) + 1.0)


def _finish(array: jax.Array) -> None:
    # Nobody reads the result any more. If its program failed, it has ended as well.
    with contextlib.suppress(Exception):
        array.block_until_ready()
