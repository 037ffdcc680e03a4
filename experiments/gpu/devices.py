"""The same programs on a GPU and on the CPU beside it: do they agree, and how long do they take?

    python -m experiments.gpu.devices --device cuda --device cpu

Every case runs in a process of its own on each device, with the same keys. Rounding makes a few rays hit another face,
so pictures agree up to a small share of their noise, but not bit for bit. Chunks of paths have the same size on all
devices, since each chunk has random numbers of its own. `--chunk-size` sets that size. (By default a CPU takes chunks
of 65,536 paths, and a GPU eight times as many.)
"""

import dataclasses
import json
import os
import statistics
from pathlib import Path

import numpy as np

from experiments import common
from experiments.compilation import scenes

CASES = {**scenes.CASES, "README, WarpedArea": ("plain", {"boundary": "WarpedArea"})}
KEYS = 5


def measure(case: str, size: int, spp: int, chunk_size: int) -> dict:
    """Seconds and pictures of a case; in a fresh process whose environment says which device."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    scenes.CASES.update(CASES)
    scene, integrator = scenes.built(case, size)
    integrator = dataclasses.replace(integrator, chunk_size=chunk_size)
    vertices = scene.parameters()[scenes.MOVING]

    def picture(offset, key):
        return jd.render(scene.replace({scenes.MOVING: vertices + offset}), key, spp, integrator)

    loss = scenes.loss_of(scene, integrator, spp, jnp.zeros((size, size, 3)))
    image, gradient = jd.jit(picture), jd.jit(jax.grad(loss))
    by_x = jd.jit(lambda key: jax.jvp(lambda x: picture(x, key), (jnp.zeros(3),), (jnp.asarray([1.0, 0.0, 0.0]),))[1])
    found = {"device": str(jax.devices()[0].device_kind), "paths": size * size * spp}
    arrays = {}
    calls = {"image": lambda key: image(jnp.zeros(3), key), "gradient": lambda key: gradient(jnp.zeros(3), key)}
    for what, call in (calls | {"derivative image": by_x}).items():
        _, first = common.seconds_of(call, jax.random.key(1000))
        turns = [common.seconds_of(call, jax.random.key(i)) for i in range(KEYS)]
        found[what] = {"first": first, "then": statistics.median(seconds for _, seconds in turns)}
        arrays[what] = np.stack([np.asarray(answer, float) for answer, _ in turns])
    return found | {"arrays": arrays}


def agreement(a, b) -> dict:
    """How well two stacks of pictures agree that have the same keys.

    `difference` is the root mean square of their difference over pixels, divided by the standard deviation of a pixel
    over keys. Independent pictures have 1.4. `projection` is that of the mean of b on the mean of a.
    """
    noise = np.sqrt(a.var(0, ddof=1).mean())
    means = a.mean(0), b.mean(0)
    return {
        "difference": float(np.sqrt(((a - b) ** 2).mean()) / max(noise, 1e-30)),
        "projection": float((means[0] * means[1]).sum() / (means[0] ** 2).sum()),
    }


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--device", action="append", help="a JAX platform: cpu, cuda; may be repeated")
    parser.add_argument("--case", action="append", choices=CASES, help="may be repeated; default: all")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--chunk-size", type=int, default=1 << 16, help="paths traced at once")
    parser.add_argument("--out", type=Path, help="folder of the results; default: results/ of this study")
    options = parser.parse_args()
    devices = options.device or ["cuda", "cpu"]
    rows, folder = [], common.results("gpu", options.quick, options.out)
    for case in options.case or CASES:
        made = {}
        for device in devices:
            os.environ["JAX_PLATFORMS"] = device
            try:
                made[device] = common.in_fresh_process(measure, case, options.size, options.spp, options.chunk_size)
            except Exception as error:  # a report of a device tells what fails there
                print(f"{case}, {device}: {type(error).__name__}: {str(error)[:2000]}", flush=True)
                rows.append({"case": case, "platform": device, "error": str(error)[:2000]})
                continue
            arrays = made[device].pop("arrays")
            row = {"case": case, "platform": device, **made[device]}
            made[device]["arrays"] = arrays
            other = made.get(devices[0])
            if other and device != devices[0]:
                for what in arrays:
                    row[what] |= agreement(other["arrays"][what], arrays[what])
            rows.append(row)
            print(json.dumps(row), flush=True)
            (folder / f"devices_{options.size}_{options.chunk_size}.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(table(rows))


def table(rows) -> str:
    """Markdown."""
    whats = ["image", "gradient", "derivative image"]
    lines = ["| case | device | " + " | ".join(f"{w}: first, then (s)" for w in whats) + " | difference | projection |"]
    lines.append("|" + "---|" * (4 + len(whats)))
    for row in rows:
        if "error" in row:
            lines.append(f"| {row['case']} | {row['platform']} | failed | | | | |")
            continue
        cells = [f"{row[w]['first']:.1f}, {row[w]['then']:.4f}" for w in whats]
        last = row["derivative image"]
        ends = [f"{last[k]:.3f}" if k in last else "" for k in ("difference", "projection")]
        lines.append(f"| {row['case']} | {row['device']} | " + " | ".join([*cells, *ends]) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
