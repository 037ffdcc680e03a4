"""Seconds of images and gradients on a device, with copies of tables and sizes of chunks side by side.

    python -m experiments.gpu.speed --device cuda --device cpu

Every row has a process of its own. All processes compile at the same time, and then measure one after another, so the
rows are of one run. A CPU row is only right if no process compiles beside it: ask for it alone.
"""

import dataclasses
import fcntl
import itertools
import os
import statistics
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from experiments import common
from experiments.compilation import scenes

CALLS = 12


def measure(device: str, case: str, copies: int, chunk: int, size: int, spp: int, lock: str) -> dict:
    """One row, in a fresh process. `copies`: of tables that are gathered from; `chunk` 0: the default size."""
    os.environ["JAX_PLATFORMS"] = device if device == "cpu" else f"{device},cpu"
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # the processes share one GPU
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from jaxdr.geometry import gather

    gather.COPIES = copies
    scene, integrator = scenes.built(case, size)
    if chunk:
        integrator = dataclasses.replace(integrator, chunk_size=chunk)
    vertices = scene.parameters()[scenes.MOVING]

    def picture(offset, key):
        return jd.render(scene.replace({scenes.MOVING: vertices + offset}), key, spp, integrator)

    loss = scenes.loss_of(scene, integrator, spp, jnp.zeros((size, size, 3)))
    row = {"case": case, "device": str(jax.devices()[0].device_kind), "copies": copies, "chunk": chunk}
    for what, call in {"image": jd.jit(picture), "gradient": jd.jit(jax.grad(loss))}.items():
        _, row[f"{what}, first"] = common.seconds_of(call, jnp.zeros(3), jax.random.key(0))
        with open(lock, "w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            times = [common.seconds_of(call, jnp.zeros(3), jax.random.key(i % 4))[1] for i in range(CALLS)]
        row[what] = statistics.median(times)
    memory = jax.devices()[0].memory_stats() or {}
    return row | {"memory": memory.get("peak_bytes_in_use", 0) / 1e9}


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--device", action="append", help="a JAX platform: cpu, cuda; may be repeated")
    parser.add_argument("--case", action="append", choices=scenes.CASES, help="may be repeated")
    parser.add_argument("--copies", type=int, nargs="+", default=[32, 1])
    parser.add_argument("--chunk", type=int, nargs="+", default=[0], help="paths traced at once; 0: the default")
    parser.add_argument("--out", type=Path, help="folder of the results; default: results/ of this study")
    options = parser.parse_args()
    size, spp = (16, 2) if options.quick else (256, 16)
    cases = options.case or ["README, depth 2", "README", "README, LineSampling"]
    grid = list(itertools.product(options.device or ["cuda"], cases, options.copies, options.chunk))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(len(grid)) as pool:
        arguments = [(common.in_fresh_process, measure, *row, size, spp, f"{folder}/lock") for row in grid]
        rows = [job.result() for job in [pool.submit(*each) for each in arguments]]
    common.write_json(common.results("gpu", options.quick, options.out) / "speed.json", {"rows": rows})
    columns = {"case": ("case", ""), "device": ("device", ""), "copies": ("copies", "d"), "chunk": ("chunk", "d")}
    for what in ("image", "gradient"):
        columns |= {f"{what}: first, s": (f"{what}, first", ".1f"), f"{what}, s": (what, ".4f")}
    print(common.table(rows, columns | {"memory, GB": ("memory", ".2f")}))


if __name__ == "__main__":
    main()
