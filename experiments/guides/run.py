"""What guides of `GuidedEdges` gain, and what they cost, as the light and the film grow smaller.

    python -m experiments.guides.run

It takes derivatives of the film's mean by the vertices of a blocker over a floor, from independent keys, with the same
number of segments for all guides. If the light is as wide as in the tests, or the film is small, the derivative of the
quadrangle has a closed form. Otherwise the reference is the mean over all guides.
"""

from functools import partial

import numpy as np

from experiments import common

STUDY = "guides"
# By scene: blocker, middle of the light (x, y), its size (1 is three units wide), field of view (degrees), strategies.
CASES = {
    "wide light": ("quadrangle", (0.0, 0.0), 1.0, 6.0, "emitter"),
    "small light": ("quadrangle", (0.0, 0.0), 0.05, 6.0, "emitter"),
    "small light and film": ("quadrangle", (0.7, 0.2), 0.05, 0.6, "emitter"),
    "torus, wide light": ("torus", (0.0, 0.0), 1.0, 6.0, "mis"),
    "torus, small light": ("torus", (0.0, 0.0), 0.05, 6.0, "mis"),
    "torus, small light, by direction": ("torus", (0.0, 0.0), 0.05, 6.0, "direction"),
}
GUIDES = {
    "none": {"guide": "none"},
    "grid": {"guide": "grid"},
    "kdtree": {"guide": "kdtree"},
    "projective": {"guide": "projective"},
    "projective, sorted": {"guide": "projective", "sort": True},
}
COLUMNS = {
    "scene": ("scene", ""),
    "guide": ("guide", ""),
    "standard deviation": ("deviation", ".4f"),
    "projection": ("projection", ".3f"),
    "±": ("error", ".3f"),
    "seconds": ("seconds", ".3f"),
    "to build": ("build", ".2f"),
    "kB": ("kilobytes", ".0f"),
}


def scene_of(case):
    """(scene, derivative in closed form or None)."""
    import jaxdr as jd
    from tests.gradients import floor_patch
    from tests.gradients.floor_point import LIGHT, QUADRANGLE, sheet

    blocker, middle, size, fov, _ = CASES[case]
    light = LIGHT * [size, size, 1.0] + [*middle, 0.0]
    if blocker == "torus":
        above = np.eye(4)
        above[2, 3] = 0.6
        return floor_patch.scene(jd.shapes.transformed(jd.shapes.torus(0.3, 0.1, 32, 16), above), light, fov), None
    mesh = sheet(QUADRANGLE, 0.1)
    smooth = size == 1.0 or fov < 1.0  # where it is not, quadrature over the film is too coarse
    return floor_patch.scene(mesh, light, fov), floor_patch.exact(mesh, light, fov) if smooth else None


def measure(case, options, segments, keys):
    """(estimates of all keys, row of numbers) for one guide."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from experiments import one_term
    from jaxdr.transport.path_settings import PathSettings

    of, _ = scene_of(case)
    _, _, width, height = of.camera.film.window
    boundary = jd.GuidedEdges(sampling=CASES[case][-1], samples=segments / (width * height), **options)
    report = jd.guide_report(of, boundary, moving=("blocker",))
    moving = tuple(name == "blocker" for name in of.shapes)

    def context(of):
        return one_term.context(of, moving, PathSettings(2, True, "auto"))

    prepared = jd.jit(lambda of: boundary.prepare(context(of), jax.random.key(0)))(of)

    @jd.jit
    def derivative(of, prepared, key):
        def mean(vertices):
            moved = context(of.replace({"blocker.vertices": vertices}))
            return one_term.image(boundary, moved, prepared, 1, key).mean()

        return jax.grad(mean)(jnp.asarray(of.parameters()["blocker.vertices"]))

    derivative(of, prepared, jax.random.key(12345))
    calls = [common.seconds_of(partial(derivative, of, prepared), jax.random.key(k)) for k in range(keys)]
    rows = np.stack([np.asarray(answer, float) for answer, _ in calls])
    seconds = float(np.median([t for _, t in calls]))
    return rows, {"seconds": seconds, "build": report.seconds, "kilobytes": report.bytes / 1000}


def compare(case, segments, keys, guides=GUIDES):
    """Rows of all guides."""
    found = [common.in_fresh_process(measure, case, options, segments, keys) for options in guides.values()]
    truth = common.in_fresh_process(scene_of, case)[1]
    if truth is None:
        weights = [1 / max(estimates.var(0, ddof=1).mean(), 1e-30) for estimates, _ in found]
        truth = np.average([estimates.mean(0) for estimates, _ in found], axis=0, weights=weights)
    scale = np.abs(truth).max()
    for guide, (estimates, row) in zip(guides, found, strict=True):
        deviation = estimates.std(0, ddof=1) / scale
        along = (estimates * truth).sum((1, 2)) / (truth**2).sum()
        numbers = {"projection": float(along.mean()), "error": float(along.std(ddof=1) / keys**0.5)}
        numbers |= {"deviation": float(np.sqrt((deviation**2).mean()))}
        yield {"scene": case, "guide": guide} | numbers | row


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--segments", type=int, default=1 << 14)
    parser.add_argument("--keys", type=int, default=8)
    parser.add_argument("--scene", nargs="*", choices=CASES, default=tuple(CASES))
    options = parser.parse_args()
    segments, keys = (1 << 11, 2) if options.quick else (options.segments, options.keys)
    rows = []
    for case in options.scene:
        rows += compare(case, segments, keys)
        print(common.table(rows[-len(GUIDES) :], COLUMNS), flush=True)
    common.write_json(common.results(STUDY, options.quick) / "guides.json", {"segments": segments, "rows": rows})


if __name__ == "__main__":
    main()
