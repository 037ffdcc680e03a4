"""Signal and noise of the gradient by every vertex: how much signal does an optimiser get per second?

    python -m experiments.vertex_signal.run

Only the soft shadow of a ball of some 40,000 vertices is in view. The loss is the squared difference from the shadow of
a bumpy ball. Signal is the squared length of the expected gradient, from pairs of independent gradients, so that noise
adds nothing. Noise is the variance of one gradient. Both are summed over all vertices.
"""

import itertools
import statistics

import numpy as np

from experiments import common
from experiments.tessellation.run import scene_of

STUDY = "vertex_signal"
KEYS = 16
SAMPLES = (4, 16, 64)
COLUMNS = {
    "estimator": ("estimator", ""),
    "spp": ("spp", ""),
    "seconds": ("seconds", ".2f"),
    "signal / noise": ("ratio", ".4f"),
    "(signal / noise)² a second": ("rate", ".3e"),
}


def measure(boundary, spp, quick):
    """One row: the gradient of a loss on the shadow with respect to every vertex."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    level = 4 if quick else 6
    target_scene = scene_of(level)
    ball = jd.shapes.sphere(level, radius=0.6, center=(0.0, 0.0, 1.6))
    scene = jd.Scene(dict(target_scene.shapes) | {"ball": jd.Shape(ball, jd.Diffuse(0.5))}, target_scene.camera)
    integrator = jd.PathTracer(max_depth=2, boundary=getattr(jd, boundary)(), sampling="emitter")
    target = jd.render(target_scene, jax.random.key(99), spp=256)
    vertices = scene.parameters()["ball.vertices"]

    @jd.jit
    def gradient(key):
        def loss(v):
            image = jd.render(scene.replace({"ball.vertices": v}), key, spp=spp, integrator=integrator)
            return jnp.mean((image - target) ** 2)

        return jax.grad(loss)(vertices)

    gradient(jax.random.key(0))
    calls = [common.seconds_of(gradient, jax.random.key(1 + k)) for k in range(KEYS)]
    seconds = statistics.median(t for _, t in calls)
    rows = np.array([np.asarray(g, float).reshape(-1) for g, _ in calls])
    signal2 = np.mean([a @ b for a, b in itertools.combinations(rows, 2)])
    noise2 = rows.var(0, ddof=1).sum()
    return {
        "estimator": boundary, "spp": spp, "seconds": seconds, "vertices": len(vertices),
        "ratio": float(np.sqrt(max(signal2, 0.0) / noise2)), "rate": float(signal2 / noise2 / seconds),
    }  # fmt: skip


def main():
    options = common.parser(__doc__).parse_args()
    folder = common.results(STUDY, options.quick)
    rows = []
    for boundary in ("LineSampling", "KernelDensity"):
        for spp in SAMPLES[:1] if options.quick else SAMPLES:
            rows.append(common.in_fresh_process(measure, boundary, spp, options.quick))
            print(rows[-1], flush=True)
    common.write_json(folder / "vertex_signal.json", {"rows": rows})
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
