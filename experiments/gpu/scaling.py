"""Seconds of a gradient of several views on one, two, four, ... devices of this process.

    python -m experiments.gpu.scaling --platform cuda

Strong scaling divides a fixed number of views, the largest number of devices. Weak scaling has one view on every
device. Each number of devices is measured in a process of its own. With `--platform cpu` there are one and two devices,
and a process has as many cores as devices. So the division is measured, not the threads of one device. Another row has
two processes with one device and one core each, at the same time: what the machine itself gives for two cores.
"""

import json
import multiprocessing
import os
import statistics
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from experiments import common
from experiments.gradient_scaling.run import scene_of

CALLS = 5


def measure(platform: str, devices: int, views: int, size: int, spp: int, core: int = 0, together=None) -> dict:
    """Seconds of the mean gradient of `views` pictures, by all vertices of a mesh; in a fresh process.

    On a CPU its cores are those from number `core` on. `together`: a barrier at which processes wait for one another
    when all is compiled.
    """
    os.environ["JAX_PLATFORMS"] = platform
    if platform == "cpu":
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[core : core + devices])
        os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + f" --xla_force_host_platform_device_count={devices}"
    import jax
    from jax.sharding import AxisType
    from jax.sharding import PartitionSpec as P

    import jaxdr as jd

    scene = scene_of(1_000 if size < 64 else 40_000, size)
    integrator = jd.PathTracer(max_depth=2)
    mesh = jax.make_mesh((devices,), ("view",), axis_types=(AxisType.Auto,), devices=jax.devices()[:devices])

    def own(vertices, keys):
        def loss(vertices):
            def view(total, key):
                image = jd.render(scene.replace({"sphere.vertices": vertices}), key, spp, integrator)
                return total + ((image - 0.25) ** 2).mean(), None

            zero = jax.lax.pcast(0.0, "view", to="varying")
            return jax.lax.scan(view, zero, keys)[0]

        return jax.grad(loss)(vertices) / views  # summed over devices: the vertices are the same on all

    step = jd.jit(jax.shard_map(own, mesh=mesh, in_specs=(P(), P("view")), out_specs=P()))
    vertices = scene.parameters()["sphere.vertices"]

    def call(k):
        return step(vertices, jax.random.split(jax.random.key(k), views))

    _, first = common.seconds_of(call, 0)
    if together is not None:
        together.wait()
    times = [common.seconds_of(call, k)[1] for k in range(1, CALLS + 1)]
    return {"devices": devices, "views": views, "first": first, "seconds": statistics.median(times)}


def apart(size: int, spp: int) -> dict:
    """Seconds of one view in each of two processes at the same time, with a core each; those of the slower one."""
    with multiprocessing.Manager() as manager:
        together = manager.Barrier(2)
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
            jobs = [pool.submit(measure, "cpu", 1, 1, size, spp, core, together) for core in range(2)]
            found = [job.result() for job in jobs]
    return max(found, key=lambda row: row["seconds"]) | {"devices": 2, "views": 2}


def device_count(platform: str) -> int:
    """How many devices there are; of a CPU two, for a trial."""
    os.environ["JAX_PLATFORMS"] = platform
    import jax

    return 2 if platform == "cpu" else jax.device_count()


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--platform", default="cuda")
    parser.add_argument("--size", type=int, help="pixels along a side; default: 256, or 16 with --quick")
    parser.add_argument("--out", type=Path, help="folder of the results; default: results/ of this study")
    options = parser.parse_args()
    size, spp = (16, 2) if options.quick else (256, 16)
    size = options.size or size
    most = common.in_fresh_process(device_count, options.platform)
    counts = [n for n in (1, 2, 4, 8, 16) if n <= most]
    rows = []
    for kind, views_of in (("strong", lambda n: counts[-1]), ("weak", lambda n: n)):
        alone = None
        for n in counts:
            row = common.in_fresh_process(measure, options.platform, n, views_of(n), size, spp)
            alone = alone or row
            gain = alone["seconds"] / row["seconds"] * row["views"] / alone["views"]
            rows.append({"scaling": kind, **row, "speed": gain})
            print(json.dumps(rows[-1]), flush=True)
    if options.platform == "cpu":
        row, alone = apart(size, spp), rows[-len(counts)]
        rows.append({"scaling": "two processes", **row, "speed": 2 * alone["seconds"] / row["seconds"]})
        print(json.dumps(rows[-1]), flush=True)
    folder = common.results("gpu", options.quick, options.out)
    common.write_json(folder / "scaling.json", {"rows": rows})
    columns = {"scaling": ("scaling", ""), "devices": ("devices", "d"), "views": ("views", "d")}
    columns |= {"seconds a step": ("seconds", ".3f"), "times the speed of one": ("speed", ".2f")}
    print(common.table(rows, columns))


if __name__ == "__main__":
    main()
