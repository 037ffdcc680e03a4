"""Estimators against the tessellation: the same soft shadow of a mesh with a thousand to a million triangles.

    python -m experiments.tessellation.run

It measures standard deviation and time of a derivative image, and its bias against central differences of the image
with common random numbers. Guides are built in every call.
"""

import statistics

import numpy as np
from tqdm import tqdm

from experiments import common

STUDY = "tessellation"
LEVELS = (3, 5, 7, 8)
# By label: boundary estimator and options.
ESTIMATORS = {
    "LineSampling": ("LineSampling", {}),
    "KernelDensity": ("KernelDensity", {}),
    "GuidedEdges": ("GuidedEdges", {"sampling": "emitter"}),
    "GuidedEdges, grid": ("GuidedEdges", {"sampling": "emitter", "guide": "grid"}),
    "GuidedEdges, kd-trees": ("GuidedEdges", {"sampling": "emitter", "guide": "kdtree"}),
}
SPP, KEYS = 16, 12
STEP = 0.02
REFERENCE_SPP, REFERENCE_KEYS = 256, 12
COLUMNS = {
    "triangles": ("triangles", ",d"),
    "estimator": ("estimator", ""),
    "seconds": ("seconds", ".3f"),
    "standard deviation": ("deviation", ".3f"),
    "projection": ("projection", ".4f"),
    "± (differences' noise and ours)": ("projection_error", ".4f"),
    "error² · seconds": ("work", ".2e"),
}


def scene_of(level):
    """A bumpy ball between a floor and a square light; the camera sees the shadow alone."""
    import jaxdr as jd

    floor = jd.Mesh([[-6, -6, 0], [6, -6, 0], [6, 6, 0], [-6, 6, 0]], [[0, 1, 2], [0, 2, 3]])
    light = jd.Mesh([[-2, -1, 4], [-2, 1, 4], [0, 1, 4], [0, -1, 4]], [[0, 1, 2], [0, 2, 3]])
    ball = jd.shapes.displaced_sphere(level, radius=0.6, center=(0.0, 0.0, 1.6))
    shapes = {
        "ball": jd.Shape(ball, jd.Diffuse(0.5)),
        "floor": jd.Shape(floor, jd.TwoSided(jd.Diffuse(0.6))),
        "light": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(20.0)),
    }
    eye = jd.look_at((3.5, 0.0, 1.2), (0.8, 0.0, 0.0), (0.0, 0.0, 1.0))
    return jd.Scene(shapes, jd.Perspective(eye, 24.0, jd.Film(64, 64, jd.Box())))


def measure(level, label, quick):
    """One row: translation of the ball along x."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    scene = scene_of(level)
    rest = scene.parameters()["ball.vertices"]
    boundary, options = ESTIMATORS[label]
    integrator = jd.PathTracer(max_depth=2, boundary=getattr(jd, boundary)(**options), sampling="emitter")

    def image(x, key, spp):
        moved = rest.at[:, 0].add(x)
        return jd.render(scene.replace({"ball.vertices": moved}), key, spp=spp, integrator=integrator)

    @jd.jit
    def derivative(x, key):
        return jax.jvp(lambda x: image(x, key, SPP), (x,), (jnp.ones_like(x),))[1]

    @jd.jit
    def difference(key):
        return (image(STEP, key, REFERENCE_SPP) - image(-STEP, key, REFERENCE_SPP)) / (2 * STEP)

    keys = 4 if quick else REFERENCE_KEYS
    rows = [np.asarray(difference(jax.random.key(1000 + k)), float) for k in tqdm(range(keys), leave=False)]
    reference, spread = np.mean(rows, 0), np.var(rows, 0, ddof=1) / keys
    power = np.mean(reference**2) - spread.mean()

    offsets = [STEP * ((2 * k + 1) / KEYS - 1) for k in range(KEYS)]
    derivative(jnp.float32(0), jax.random.key(0))
    found, seconds = [], []
    for k, x in enumerate(offsets):
        pair = [common.seconds_of(derivative, jnp.float32(x), jax.random.key(1 + 2 * k + s)) for s in (0, 1)]
        found.append([np.asarray(answer, float) for answer, _ in pair])
        seconds += [t for _, t in pair]
    found = np.array(found)
    deviation2 = found.var(1, ddof=1).mean() / power
    # Halves of the reference: one weighs, the other is projected on, so that its noise does not bias the projection.
    one, two = np.mean(rows[::2], 0), np.mean(rows[1::2], 0)
    means = found.mean(1)
    projections = np.array([np.mean(mean * reference) / np.mean(one * two) for mean in means])
    noise = np.hypot(
        projections.std(ddof=1) / KEYS**0.5, np.sqrt(np.mean(spread * reference**2) / power**2 / reference.size)
    )
    time = statistics.median(seconds)
    return {
        "triangles": int(scene.shapes["ball"].mesh.faces.shape[0]),
        "estimator": label,
        "seconds": time,
        "deviation": float(np.sqrt(deviation2)),
        "projection": float(projections.mean()),
        "projection_error": float(noise),
        "work": float(deviation2 * time),
    }


def chart(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 4, figsize=(16, 4))
    for i, estimator in enumerate(dict.fromkeys(row["estimator"] for row in rows)):
        mine = [row for row in rows if row["estimator"] == estimator]
        triangles = [row["triangles"] for row in mine]
        panels[0].loglog(triangles, [row["seconds"] for row in mine], "o-", color=f"C{i}", label=estimator)
        panels[1].loglog(triangles, [row["deviation"] for row in mine], "o-", color=f"C{i}")
        panels[3].loglog(triangles, [row["work"] for row in mine], "o-", color=f"C{i}")
        panels[2].errorbar(
            triangles, [row["projection"] for row in mine], [row["projection_error"] for row in mine],
            fmt="o-", capsize=3, color=f"C{i}",
        )  # fmt: skip
    panels[2].set_xscale("log")
    panels[2].axhspan(0.99, 1.01, color="0.93", zorder=0)
    labels = "seconds", "standard deviation / size", "projection on differences", "error² · seconds"
    for panel, label in zip(panels, labels, strict=True):
        panel.set(xlabel="triangles", ylabel=label)
        panel.grid(True, which="major", alpha=0.3)
    panels[0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    options = common.parser(__doc__).parse_args()
    folder = common.results(STUDY, options.quick)
    rows = []
    for level in LEVELS[:2] if options.quick else LEVELS:
        for label in ESTIMATORS:
            rows.append(common.in_fresh_process(measure, level, label, options.quick))
            print(rows[-1], flush=True)
            common.write_json(folder / "tessellation.json", {"rows": rows})
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)
    chart(rows, folder / "tessellation.png")


if __name__ == "__main__":
    main()
