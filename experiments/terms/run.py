"""Size and standard deviation of each term of the derivative of a reference scene, and seconds.

python -m experiments.terms.run
"""

import json
import statistics

import numpy as np

from experiments import common
from experiments.reference_scenes import load

STUDY = "terms"
SCENE = "direct_spot"
COLUMNS = {
    "parameter": ("parameter", ""),
    "term": ("term", ""),
    "root mean square": ("size", ".4f"),
    "standard deviation": ("deviation", ".4f"),
    "share of the variance": ("share", ".1%"),
}


def measure(folder, parameter, spp, keys):
    """(rows, seconds): every term's size and standard deviation over `keys` independent calls, and the whole's."""
    import jax

    import jaxdr as jd
    from jaxdr.moving import Moving

    reference = load(folder, parameter)
    moving = Moving(tuple(shape == reference.shape for shape in reference.scene.shapes), camera=False)
    integrator = jd.PathTracer(max_depth=reference.max_depth, boundary=jd.KernelDensity())

    @jd.jit
    def derivative(key):
        def terms(v):
            moved = reference.scene.replace({f"{reference.shape}.vertices": v})
            return jd.derivative_terms(moved, key, spp, integrator, moving)

        return jax.jvp(terms, (reference.vertices,), (reference.direction,))[1]

    derivative(jax.random.key(12345))
    calls = [common.seconds_of(derivative, jax.random.key(k)) for k in range(keys)]
    seconds = statistics.median(t for _, t in calls)
    images = {term: np.stack([np.asarray(answer[term], float) for answer, _ in calls]) for term in calls[0][0]}
    total = sum(images.values())
    variance = total.var(0, ddof=1).mean()
    rows = []
    for term, stack in (images | {"whole derivative": total}).items():
        own = stack.var(0, ddof=1).mean()
        size = np.sqrt(max(np.mean(stack.mean(0) ** 2) - own / keys, 0.0))  # noise of the mean taken off
        row = {"parameter": parameter, "term": term, "size": size, "deviation": np.sqrt(own)}
        rows.append(row | {"share": own / variance})
    return rows, seconds


def chart(rows, path):
    """Bars: standard deviation of each term, one group a parameter."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    parameters = sorted({row["parameter"] for row in rows})
    figure, axes = plt.subplots(figsize=(6.4, 3.6))
    for i, parameter in enumerate(parameters):
        mine = [row for row in rows if row["parameter"] == parameter]
        places = np.arange(len(mine)) + 0.4 * i
        axes.bar(places, [row["deviation"] for row in mine], 0.36, label=parameter)
        axes.set_xticks(np.arange(len(mine)) + 0.2 * (len(parameters) - 1), [row["term"] for row in mine])
    axes.set(yscale="log", ylabel="standard deviation")
    axes.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--spp", type=int, default=16)
    options = parser.parse_args()
    folder = options.oracle / SCENE
    rows = []
    for parameter in (p["name"] for p in json.loads((folder / "oracle.json").read_text())["parameters"]):
        some, seconds = common.in_fresh_process(measure, folder, parameter, options.spp, 4 if options.quick else 32)
        print(f"{SCENE}, {parameter}, {options.spp} spp: {seconds:.3f} s", flush=True)
        rows += [row | {"spp": options.spp, "seconds": seconds} for row in some]
    out = common.results(STUDY, options.quick)
    common.write_json(out / "terms.json", {"scene": SCENE, "rows": rows})
    chart(rows, out / "terms.png")
    print("\n" + common.table(rows, COLUMNS))


if __name__ == "__main__":
    main()
