"""Path tracing against bidirectional path tracing: are the images the same, and which error is smaller at equal time?

    python -m experiments.bidirectional.run

Both render the same scenes in turns, image by image, so that other work of the machine slows both equally.
"""

import statistics

import jax
import numpy as np

import jaxdr as jd
from experiments import common
from experiments.bidirectional.scenes import SCENES

STUDY = "bidirectional"
SPP = 16  # samples of the bidirectional path tracer; the path tracer gets as many as fit into the same time
ROUNDS, REFERENCE_ROUNDS, REFERENCE_SPP = 16, 8, 256
COLUMNS = {
    "scene": ("scene", "s"),
    "segments": ("depth", "d"),
    "PT spp": ("path_spp", "d"),
    "PT s": ("path_seconds", ".3f"),
    "PT error": ("path_error", ".4f"),
    "BDPT spp": ("bidirectional_spp", "d"),
    "BDPT s": ("bidirectional_seconds", ".3f"),
    "BDPT error": ("bidirectional_error", ".4f"),
    "error, PT / BDPT, at equal time": ("ratio", ".2f"),
    "z of the mean": ("mean_z", ".2f"),
    "rms z of blocks": ("block_z", ".2f"),
}


def renderer(scene, integrator, spp):
    """A compiled function of a key."""
    image = jd.jit(lambda scene, key: jd.render(scene, key, spp=spp, integrator=integrator))
    return lambda key: np.asarray(image(scene, key), float)


def in_turns(renderers, rounds, seed):
    """(images [rounds, H, W, 3] and seconds [rounds] of each), one image of each after the other."""
    for render in renderers:
        render(jax.random.key(seed))
    found = [([], []) for _ in renderers]
    for i in range(rounds):
        for j, (render, (images, seconds)) in enumerate(zip(renderers, found, strict=True)):
            image, taken = common.seconds_of(render, jax.random.fold_in(jax.random.key(seed + 1 + j), i))
            images.append(image)
            seconds.append(taken)
    return [(np.stack(images), seconds) for images, seconds in found]


def measure(name, rounds, reference_rounds, reference_spp):
    """A row of the table."""
    make, depth = SCENES[name]
    scene = make()
    path, both = jd.PathTracer(depth, None), jd.BidirectionalPathTracer(depth)
    (_, one), (_, two) = in_turns([renderer(scene, path, SPP), renderer(scene, both, SPP)], 5, 100)
    path_spp = max(1, round(SPP * statistics.median(b / a for a, b in zip(one, two, strict=True))))
    renderers = [renderer(scene, path, path_spp), renderer(scene, both, SPP)]
    (one, one_seconds), (two, two_seconds) = in_turns(renderers, rounds, 200)
    truth = renderer(scene, both, reference_spp)
    truth = np.stack([truth(jax.random.fold_in(jax.random.key(300), i)) for i in range(reference_rounds)])
    noise = truth.var(0, ddof=1).mean() / reference_rounds
    reference = truth.mean(0)
    errors = [np.sqrt(max(((images - reference) ** 2).mean() - noise, 0.0)) / reference.mean() for images in (one, two)]
    seconds = [statistics.median(s) for s in (one_seconds, two_seconds)]
    apart = statistics.median(a / b for a, b in zip(one_seconds, two_seconds, strict=True))
    means, pixels = z_scores(one, truth)
    return {
        "scene": name,
        "depth": depth,
        "path_spp": path_spp,
        "path_seconds": seconds[0],
        "path_error": errors[0],
        "bidirectional_spp": SPP,
        "bidirectional_seconds": seconds[1],
        "bidirectional_error": errors[1],
        "ratio": errors[0] / errors[1] * np.sqrt(apart),
        "mean_z": means,
        "block_z": pixels,
    }


def z_scores(one, two):
    """(z-score of the mean over the image, root mean square of those of 8 x 8 blocks) of two sets of images."""

    def score(a, b):
        # A background of one radiance has no noise but that of sums in float32.
        rounding = 1e-6 * np.abs(a).mean(0)
        error2 = a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b) + rounding**2
        return np.where(error2 > 0, (a.mean(0) - b.mean(0)) / np.sqrt(np.where(error2 > 0, error2, 1.0)), 0.0)

    def blocks(images):
        n, height, width, _ = images.shape
        return images.reshape(n, height // 8, 8, width // 8, 8, 3).mean((2, 4, 5))

    whole = float(score(one.mean((1, 2, 3)), two.mean((1, 2, 3))))
    return whole, float(np.sqrt((score(blocks(one), blocks(two)) ** 2).mean()))


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--scenes", default=",".join(SCENES), help="names, separated by commas")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    sizes = (4, 2, 64) if options.quick else (ROUNDS, REFERENCE_ROUNDS, REFERENCE_SPP)
    rows = []
    for name in options.scenes.split(","):
        rows.append(measure(name, *sizes))
        print(rows[-1], flush=True)
        common.write_json(folder / "bidirectional.json", {"rows": rows})
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
