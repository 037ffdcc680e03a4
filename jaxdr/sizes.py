"""How many rows programs work on at once, by the kind of machine.

A CPU works fastest on data that fits into its caches, and a few thousand rows keep its threads busy. A GPU is fast only
if all its threads have work. An H100 has 132 multiprocessors x 2,048 threads, about 270,000. It needs about twice as
many rows, so that some threads compute while others wait. Each kernel and each iteration of a loop also costs a fixed
time.

The size of chunks was measured on an H200 (experiments/gpu). The other sizes for GPUs follow from these numbers.
"""

import jax


def at_once(cpu: int, gpu: int) -> int:
    """The number for JAX's default device (`jax.default_device`, or the default backend)."""
    return cpu if platform() == "cpu" else gpu


def platform() -> str:
    """The platform of JAX's default device: "cpu", "gpu", "tpu" and the like."""
    device = getattr(jax.config, "jax_default_device", None)
    if device is None:
        return jax.default_backend()
    return getattr(device, "platform", device)
