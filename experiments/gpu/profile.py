"""Where a gradient's time goes on a GPU: seconds by kernel, and the gaps in which the GPU waits.

    python -m experiments.gpu.profile --case README

JAX's profiler also slows Python down, so gaps are longer here than without it.
"""

import collections
import gzip
import json
import sys
import tempfile
from pathlib import Path

from experiments import common
from experiments.compilation import scenes

ROWS = 20  # of each table


def kernels(folder: Path) -> list[dict]:
    """What ran on the GPU, by time of its start: events of the trace that the profiler wrote below a folder."""
    (path,) = folder.rglob("*.trace.json.gz")
    with gzip.open(path) as file:
        events = json.load(file)["traceEvents"]
    names = {("process", e["pid"]): e["args"]["name"] for e in events if e.get("name") == "process_name"}
    names |= {(e["pid"], e["tid"]): e["args"]["name"] for e in events if e.get("name") == "thread_name"}

    def on_gpu(event):
        if event.get("ph") != "X" or "GPU" not in names.get(("process", event["pid"]), ""):
            return False
        return "Stream" in names.get((event["pid"], event["tid"]), "")

    return sorted(filter(on_gpu, events), key=lambda event: event["ts"])


def sums(events: list[dict]) -> tuple[collections.Counter, collections.Counter, collections.Counter, float, float]:
    """(time and gaps by kernel, launches by kernel, busy time, whole time); microseconds. A gap: (before, after)."""
    time, gaps, count = (collections.Counter() for _ in range(3))
    end, before, busy = events[0]["ts"], "start", 0.0
    for event in events:
        name, start, stop = event["name"][:60], event["ts"], event["ts"] + event["dur"]
        time[name] += event["dur"]
        count[name] += 1
        if start > end:
            gaps[before, name] += start - end
        if stop > end:
            busy += stop - max(end, start)
            end, before = stop, name
    return time, gaps, count, busy, end - events[0]["ts"]


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--case", choices=scenes.CASES, default="README")
    options = parser.parse_args()
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    if jax.default_backend() != "gpu":
        sys.exit("profile: JAX finds no GPU, and the profile is of one")
    size, spp = (16, 2) if options.quick else (256, 16)
    scene, integrator = scenes.built(options.case, size)
    gradient = jd.jit(jax.grad(scenes.loss_of(scene, integrator, spp, jnp.zeros((size, size, 3)))))
    for i in range(3):
        _, seconds = common.seconds_of(gradient, jnp.zeros(3), jax.random.key(i))
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder, create_perfetto_trace=True):
            common.seconds_of(gradient, jnp.zeros(3), jax.random.key(3))
        time, gaps, count, busy, whole = sums(kernels(Path(folder)))
    print(
        f"{seconds * 1e3:.1f} ms without the profiler; with it {whole / 1e3:.1f} ms, {busy / 1e3:.1f} ms of them busy"
    )
    rows = [{"kernel": name, "ms": us / 1e3, "launches": count[name]} for name, us in time.most_common(ROWS)]
    print(common.table(rows, {"kernel": ("kernel", ""), "ms": ("ms", ".3f"), "launches": ("launches", "d")}))
    rows = [{"before": a[:40], "after": b[:40], "ms": us / 1e3} for (a, b), us in gaps.most_common(ROWS)]
    print(common.table(rows, {"gap after": ("before", ""), "and before": ("after", ""), "ms": ("ms", ".3f")}))


if __name__ == "__main__":
    main()
