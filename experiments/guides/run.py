"""What guides of `GuidedEdges` gain, and what they cost, as the light grows smaller.

    python -m experiments.guides.run

Derivatives of the film's mean by the vertices of a blocker over a floor, from independent keys and as many segments in
all of them. `floor_patch` has a closed form; of the others the mean over all guides is taken.
"""

from functools import partial

import numpy as np

from experiments import common

STUDY = "guides"
GUIDES = ("none", "grid", "kdtree", "projective")
SIZES = (1.0, 0.05)
STRATEGIES = ("emitter", "mis")
COLUMNS = {
    "blocker": ("blocker", ""),
    "light": ("light", ".3g"),
    "sampling": ("sampling", ""),
    "guide": ("guide", ""),
    "standard deviation": ("deviation", ".4f"),
    "largest z": ("z", ".1f"),
    "seconds": ("seconds", ".3f"),
    "to build": ("build", ".2f"),
    "kB": ("kilobytes", ".0f"),
}


def scene_of(blocker, size):
    """(scene, derivative in closed form or None)."""
    import jaxdr as jd
    from tests.gradients import floor_patch
    from tests.gradients.floor_point import LIGHT, QUADRANGLE, sheet

    middle = LIGHT.mean(0)
    light = middle + size * (LIGHT - middle)
    if blocker == "quadrangle":
        mesh = sheet(QUADRANGLE, 0.1)
        return floor_patch.scene(mesh, light), floor_patch.exact(mesh, light, 24 if size == 1 else 64)
    above = np.eye(4)
    above[2, 3] = 0.6
    return floor_patch.scene(jd.shapes.transformed(jd.shapes.torus(0.3, 0.1, 32, 16), above), light), None


def measure(blocker, size, sampling, guide, segments, keys, options):
    """(estimates of all keys, row of numbers) for one guide."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from jaxdr.scene.packed import pack
    from jaxdr.transport.path import PathSettings

    of, _ = scene_of(blocker, size)
    boundary = jd.GuidedEdges(guide, sampling, **options)
    settings = PathSettings(2, True, "auto")
    moving = (False, False, True)

    @jd.jit
    def prepare(of):
        return boundary.prepare(pack(of), moving, settings)

    @jd.jit
    def derivative(of, prepared, key):
        def mean(vertices):
            packed = pack(of.replace({"blocker.vertices": vertices}))
            return boundary.film_term(packed, prepared, segments, key, settings, "fixed").mean()

        return jax.grad(mean)(jnp.asarray(of.parameters()["blocker.vertices"]))

    prepare(of)
    prepared, build = common.seconds_of(prepare, of)
    memory = sum(leaf.nbytes for leaf in jax.tree.leaves(prepared.guides))
    derivative(of, prepared, jax.random.key(12345))
    calls = [common.seconds_of(partial(derivative, of, prepared), jax.random.key(k)) for k in range(keys)]
    rows = np.stack([np.asarray(answer, float) for answer, _ in calls])
    seconds = float(np.median([t for _, t in calls]))
    return rows, {"seconds": seconds, "build": build, "kilobytes": memory / 1000}


def compare(blocker, size, sampling, segments, keys, options, guides=GUIDES):
    """Rows of all guides."""
    found = [common.in_fresh_process(measure, blocker, size, sampling, g, segments, keys, options) for g in guides]
    truth = common.in_fresh_process(scene_of, blocker, size)[1]
    if truth is None:
        weights = [1 / max(estimates.var(0, ddof=1).mean(), 1e-30) for estimates, _ in found]
        truth = np.average([estimates.mean(0) for estimates, _ in found], axis=0, weights=weights)
    scale = np.abs(truth).max()
    for guide, (estimates, row) in zip(guides, found, strict=True):
        deviation = estimates.std(0, ddof=1) / scale
        z = np.abs(estimates.mean(0) / scale - truth / scale) / np.maximum(deviation / keys**0.5, 1e-6)
        numbers = {"deviation": float(np.sqrt((deviation**2).mean())), "z": float(z.max())}
        yield {"blocker": blocker, "light": size, "sampling": sampling, "guide": guide} | numbers | row


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--segments", type=int, default=1 << 14)
    parser.add_argument("--keys", type=int, default=8)
    parser.add_argument("--blocker", nargs="*", default=("quadrangle", "torus"))
    options = parser.parse_args()
    segments, keys = (1 << 11, 2) if options.quick else (options.segments, options.keys)
    rows = []
    for blocker in options.blocker:
        for size in SIZES:
            for sampling in STRATEGIES:
                rows += compare(blocker, size, sampling, segments, keys, {})
                print(common.table(rows[-len(GUIDES) :], COLUMNS), flush=True)
    common.write_json(common.results(STUDY, options.quick) / "guides.json", {"segments": segments, "rows": rows})


if __name__ == "__main__":
    main()
