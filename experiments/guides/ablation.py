"""Guides x strategies x sorting of `GuidedEdges` at equal time: the ablation of Yan et al. 2022 (figures 6 and 8).

    python -m experiments.guides.ablation [--scene environment_penguin shadow_goathead] [--remeshed]

As in the paper, it is the boundary term alone: derivative images of a rotated penguin under a sky, and of the soft
shadow of a head that moves. All settings take turns, call by call, and guides are built once. The error at equal time
is that of the mean of as many independent calls as fit into the time: its variance is that of a call over their number.
With --remeshed the moving mesh has as many vertices, but its edges follow a field of directions in long chains (4.3 of
the paper).
"""

import dataclasses
import statistics

import numpy as np
from tqdm import tqdm

from experiments import common, reference_scenes

STUDY = "guides"
SCENES = "environment_penguin", "shadow_goathead"
STRATEGIES = {"emitter": "light", "direction": "direction", "mis": "both"}
GUIDES = "none", "grid", "kdtree", "projective"
SECONDS = 4.0  # the equal time
COLUMNS = {
    "guide": ("guide", ""),
    "sampling": ("sampling", ""),
    "sorted": ("sorted", ""),
    "error after 4 s": ("error", ".3f"),
    "and with the guide built in them": ("error_built", ".3f"),
    "projection": ("projection", ".3f"),
    "±": ("projection_error", ".3f"),
    "seconds a call": ("seconds", ".3f"),
    "to build": ("build", ".2f"),
    "MB": ("megabytes", ".2f"),
}


def settings(guides):
    """(guide, sampling, sorted): without a guide the order of edges means nothing."""
    return [(g, s, order) for g in guides for s in STRATEGIES for order in (False, True) if g != "none" or not order]


def line(case, guide, sampling, order, segments):
    """(function key -> boundary term's derivative image, what `jd.guide_report` says) of a setting."""
    import jax

    import jaxdr as jd
    from experiments import one_term
    from jaxdr.transport.path_settings import PathSettings

    scene, name, (_, _, width, height) = case.scene, f"{case.shape}.vertices", case.scene.camera.film.window
    boundary = jd.GuidedEdges(guide=guide, sampling=sampling, sort=order, samples=segments / (width * height))
    moving = tuple(shape == case.shape for shape in scene.shapes)

    def context(scene):
        return one_term.context(scene, moving, PathSettings(2, True, "auto"))

    prepared = jd.jit(lambda scene: boundary.prepare(context(scene), jax.random.key(0)))(scene)

    @jd.jit
    def derivative(scene, prepared, key):
        def image(vertices):
            return one_term.image(boundary, context(scene.replace({name: vertices})), prepared, 1, key)

        return jax.jvp(image, (scene.parameters()[name],), (case.direction,))[1]

    derivative(scene, prepared, jax.random.key(10**6))
    report = jd.guide_report(scene, boundary, moving=(case.shape,))
    return lambda key: derivative(scene, prepared, key), report


def remeshed(case):
    """The same scene with a moving mesh whose edges form long chains."""
    import jaxdr as jd

    mesh = case.scene.shapes[case.shape].mesh
    mesh = jd.remesh_field_aligned(mesh, len(mesh.vertices))
    shape = dataclasses.replace(case.scene.shapes[case.shape], mesh=mesh)
    scene = dataclasses.replace(case.scene, shapes=case.scene.shapes | {case.shape: shape})
    direction = reference_scenes.velocity(case.motion, mesh.vertices)
    return dataclasses.replace(case, scene=scene, vertices=mesh.vertices, direction=direction)


def measure(folder, guides, segments, keys, with_field):
    """(rows, pictures: mean images by setting) of a scene."""
    import jax

    case = reference_scenes.load(folder)
    case = remeshed(case) if with_field else case
    lines = {setting: line(case, *setting, segments) for setting in tqdm(settings(guides), "compile")}
    images, seconds = {s: [] for s in lines}, {s: [] for s in lines}
    for k in tqdm(range(keys), "calls"):
        for setting, (derivative, _) in lines.items():
            answer, time = common.seconds_of(derivative, jax.random.key(k))
            images[setting].append(np.asarray(answer, float))
            seconds[setting].append(time)
    images = {setting: np.array(found) for setting, found in images.items()}
    variances = {setting: found.var(0, ddof=1).mean() for setting, found in images.items()}
    # Every line is unbiased: what they are compared with is the mean of all, weighted by how good they are.
    weights = [1 / max(variances[s], 1e-30) for s in lines]
    truth = np.average([images[s].mean(0) for s in lines], axis=0, weights=weights)
    size = np.sqrt((truth**2).mean())
    rows = []
    for setting, (_, report) in lines.items():
        time = statistics.median(seconds[setting])
        along = (images[setting] * truth).sum((1, 2, 3)) / (truth**2).sum()
        left = SECONDS - report.seconds
        deviation = float(np.sqrt(variances[setting]) / size)
        rows.append({
            "guide": setting[0],
            "sampling": STRATEGIES[setting[1]],
            "sorted": "yes" if setting[2] else "no",
            "deviation": deviation,
            "seconds": time,
            "build": report.seconds,
            "megabytes": report.bytes / 1e6,
            "error": deviation * (time / SECONDS) ** 0.5,
            "error_built": deviation * (time / left) ** 0.5 if left > time else None,
            "projection": float(along.mean()),
            "projection_error": float(along.std(ddof=1) / keys**0.5),
        })  # fmt: skip
    shown = {}
    for setting in lines:
        calls = int(np.clip(round(SECONDS / statistics.median(seconds[setting])), 1, keys))
        shown[setting] = images[setting][:calls].mean(0), calls
    return rows, shown, truth


def picture(rows, guides, shown, truth, path):
    """Guides across, strategies down, unsorted; the mean of all lines in front."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    errors = {(row["guide"], row["sampling"]): row["error"] for row in rows if row["sorted"] == "no"}
    figure, panels = plt.subplots(
        len(STRATEGIES), len(guides) + 1, squeeze=False, figsize=(1 + 2 * (len(guides) + 1), 7)
    )
    limit = np.quantile(np.abs(truth.sum(-1)), 0.99)
    style = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit, "interpolation": "nearest"}
    for down, (sampling, name) in zip(panels, STRATEGIES.items(), strict=True):
        down[0].imshow(truth.sum(-1), **style)
        down[0].set(title="mean of all", ylabel=name)
        for panel, guide in zip(down[1:], guides, strict=True):
            image, calls = shown[guide, sampling, False]
            panel.imshow(image.sum(-1), **style)
            panel.set(title=f"{guide}, {calls} calls: {errors[guide, name]:.2f}")
        for panel in down:
            panel.set(xticks=[], yticks=[])
            panel.title.set_fontsize(9)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--segments", type=int, default=1 << 15)
    parser.add_argument("--keys", type=int, default=24)
    parser.add_argument("--scene", nargs="*", choices=SCENES, default=SCENES)
    parser.add_argument("--guide", nargs="*", choices=GUIDES, default=GUIDES)
    parser.add_argument("--remeshed", action="store_true", help="needs the extra field-aligned")
    options = parser.parse_args()
    segments, keys = (1 << 11, 2) if options.quick else (options.segments, options.keys)
    folder = common.results(STUDY, options.quick)
    for scene in options.scene:
        job = (measure, options.oracle / scene, options.guide, segments, keys, options.remeshed)
        rows, shown, truth = common.in_fresh_process(*job)
        name = f"ablation_{scene}_remeshed" if options.remeshed else f"ablation_{scene}"
        common.write_json(folder / f"{name}.json", {"segments": segments, "keys": keys, "rows": rows})
        table = common.table(rows, COLUMNS)
        (folder / f"{name}.md").write_text(table + "\n")
        picture(rows, options.guide, shown, truth, folder / f"{name}.png")
        print(f"{scene}\n\n{table}\n", flush=True)


if __name__ == "__main__":
    main()
