"""How many rows programs work on at once, by the kind of machine that they are for.

A CPU works fastest on what fits into its caches, and a few thousand rows keep its threads busy. A GPU is fast only
while all its threads have work: an H100 holds 132 multiprocessors x 2,048 threads, some 270,000, and wants about twice
as many rows, so that some wait while others compute. Each kernel and each turn of a loop costs a fixed time there, too.

The sizes for GPUs follow from these numbers. They were not measured on one.
"""

import jax


def at_once(cpu: int, gpu: int) -> int:
    """The number for the device that JAX takes by default (`jax.default_device`, or the default backend)."""
    return cpu if platform() == "cpu" else gpu


def platform() -> str:
    """The platform of the device that JAX takes by default: "cpu", "gpu", "tpu" and the like."""
    device = getattr(jax.config, "jax_default_device", None)
    if device is None:
        return jax.default_backend()
    return getattr(device, "platform", device)
