"""GPUs, drivers and memory of the machine, as JAX and Warp see them.

python -m experiments.gpu.machine
"""

import json

import jax
import warp as wp

from experiments import common


def main():
    print(json.dumps(common.machine(), indent=1))
    for device in jax.devices():
        memory = device.memory_stats() or {}
        print(f"JAX {device.id}: {device.device_kind}, limit of memory {memory.get('bytes_limit', 0) / 1e9:.1f} GB")
    wp.init()
    for device in wp.get_cuda_devices():
        free, total = device.free_memory / 1e9, device.total_memory / 1e9
        pool = "with" if device.is_mempool_supported else "without"
        print(f"Warp {device}: {device.name}, sm_{device.arch}, {free:.1f} of {total:.1f} GB free, {pool} memory pool")


if __name__ == "__main__":
    main()
