"""Error of derivative images in equal time, by boundary estimator, on the reference scenes.

    python -m experiments.estimators.run

Every estimator gets as many samples per pixel as fit into the budget; all take turns, call by call, in one process.
"""

import json

import numpy as np
from tqdm import tqdm

from experiments import common
from experiments.equal_time.errors import statistics
from experiments.reference_scenes import SCENES, load

STUDY = "estimators"
ESTIMATORS = ("interior only", "KernelDensity", "WarpedArea", "LineSampling")
PILOT = 4  # samples per pixel of the calls that tell how many fit
COLUMNS = {
    "scene": ("scene", ""),
    "estimator": ("estimator", ""),
    "spp": ("spp", "d"),
    "seconds": ("seconds", ".2f"),
    "error": ("error", ".3f"),
    "standard deviation": ("deviation", ".3f"),
    "bias": ("bias", ".3f"),
    "projection": ("projection", ".3f"),
    "first call, seconds": ("first_call", ".0f"),
}


def measure(folder, budget, keys):
    """A row for every estimator: errors of one call, relative to the reference's size, and median seconds."""
    import jax

    import jaxdr as jd

    reference = load(folder)

    def derivative_of(estimator, spp):
        boundary = None if estimator == "interior only" else getattr(jd, estimator)()
        return reference.derivative(jd.PathTracer(max_depth=reference.max_depth, boundary=boundary), spp)

    calls = []
    for estimator in ESTIMATORS:
        pilot = derivative_of(estimator, PILOT)
        _, first = common.seconds_of(pilot, jax.random.key(12345))
        taken = min(common.seconds_of(pilot, jax.random.key(12346 + k))[1] for k in range(3))
        spp = max(1, round(PILOT * budget / taken))
        function = derivative_of(estimator, spp)
        _, again = common.seconds_of(function, jax.random.key(12345))
        calls.append((estimator, spp, function, max(first, again), [], []))
    for k in tqdm(range(keys), desc=folder.name, leave=False):
        for _, _, function, _, images, seconds in calls:
            image, took = common.seconds_of(function, jax.random.key(k))
            images.append(np.asarray(image, float))
            seconds.append(took)
    rows = []
    for estimator, spp, _, first, images, seconds in calls:
        row = {"scene": folder.name, "parameter": reference.parameter, "estimator": estimator, "spp": spp}
        row |= {"seconds": float(np.median(seconds)), "first_call": first}
        rows.append(row | statistics(np.stack(images)[None], reference.image, reference.noise**2))
    return rows


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--scene", choices=SCENES, action="append", help="may be repeated; default: all")
    parser.add_argument("--seconds", type=float, default=1.0, help="budget of a derivative image")
    parser.add_argument("--keys", type=int, default=8)
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    file = folder / "estimators.json"
    rows = json.loads(file.read_text())["rows"] if file.exists() else []
    for name in options.scene or SCENES[: 1 if options.quick else None]:
        keys = 2 if options.quick else options.keys
        fresh = common.in_fresh_process(measure, options.oracle / name, options.seconds, keys)
        rows = [row for row in rows if row["scene"] != name] + fresh
        rows.sort(key=lambda row: (SCENES.index(row["scene"]), ESTIMATORS.index(row["estimator"])))
        common.write_json(file, {"rows": rows})
        print(common.table(fresh, COLUMNS), flush=True)
    (folder / "table.md").write_text(common.table(rows, COLUMNS) + "\n")


if __name__ == "__main__":
    main()
