"""Whether a program is computed by kernels or by XLA."""

from collections.abc import Callable

import jax

from jaxdr.kernels import machine
from jaxdr.kernels.fused import fused

CHOICES = ("auto", "kernels", "xla")
ENOUGH = 1 << 14  # products; a kernel compiles as long for a few rows, which XLA computes as fast


def computed(function: Callable, compute: str, fewest: int = ENOUGH) -> Callable:
    """The function by kernels or by XLA; `compute` is one of `CHOICES`.

    "auto" takes kernels on a CPU with Warp's compiler, for programs with a multiplication of `fewest` numbers. XLA
    divides its own operations between several devices, and repeats others on each. So with several devices, and inside
    `jax.shard_map`, XLA computes all.
    """
    alone = jax.device_count() == 1 and not jax.sharding.get_abstract_mesh().manual_axes
    if alone and (compute == "kernels" or (compute == "auto" and machine.available())):
        return fused(function, 0 if compute == "kernels" else fewest)
    return function
