"""Error of derivative images in equal time, by boundary estimator, on the reference scenes.

    python -m experiments.estimators.run

Every estimator gets as many samples per pixel as fit into the budget; all take turns, call by call, in one process.
"""

import json

import numpy as np
from tqdm import tqdm

from experiments import common
from experiments.equal_time.errors import statistics
from experiments.terms.run import direction_of

STUDY = "estimators"
SCENES = (
    "direct_spot",
    "shadow_goathead",
    "cube_constant",
    "cornell_indirect",
    "mirror_spot",
    "environment_penguin",
)
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
    import jax.numpy as jnp

    import jaxdr as jd

    scene = jd.load_mitsuba(str(folder / "scene.xml"))
    oracle = json.loads((folder / "oracle.json").read_text())
    parameter = next(p for p in oracle["parameters"] if p["kind"] in ("translate", "rotate"))
    reference = np.load(folder / parameter["file"]).astype(float)
    name = f"{parameter['shape']}.vertices"
    vertices = scene.parameters()[name]
    direction = jnp.asarray(direction_of(parameter, np.asarray(vertices, float)), vertices.dtype)

    def derivative_of(estimator, spp):
        boundary = None if estimator == "interior only" else getattr(jd, estimator)()
        integrator = jd.PathTracer(max_depth=oracle["max_depth"], boundary=boundary)

        @jax.jit
        def derivative(key):
            def image(v):
                return jd.render(scene.replace({name: v}), key, spp=spp, integrator=integrator)

            return jax.jvp(image, (vertices,), (direction,))[1]

        return derivative

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
        row = {"scene": folder.name, "parameter": parameter["name"], "estimator": estimator, "spp": spp}
        row |= {"seconds": float(np.median(seconds)), "first_call": first}
        rows.append(row | statistics(np.stack(images)[None], reference, parameter["noise_rms"] ** 2))
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
