"""What the default takes, beside the estimators that it chooses from: variance x seconds on scenes of each structure.

    python -m experiments.default_choice.run [--cases NAMES] [--oracle FOLDER]

Cases that are not named keep their rows. Estimators of a case answer in turns. All are unbiased on these scenes but for
`KernelDensity` (docs/stability.md), so variance stands for error².
"""

import json
import time

import numpy as np

from experiments import common
from experiments.roughness.scenes import write_ball

STUDY, SIZE, SPP, KEYS = "default_choice", 64, 16, 8
REFERENCE = ("direct_spot", "shadow_goathead", "environment_penguin", "cornell_indirect", "mirror_spot")
COLUMNS = {
    "case": ("case", "s"),
    "estimator": ("estimator", "s"),
    "first call, s": ("first", ".1f"),
    "processor, s": ("processor", ".1f"),
    "seconds": ("seconds", ".3f"),
    "deviation": ("deviation", ".3g"),
    "variance x seconds": ("work", ".2g"),
    "times the best": ("times", ".2g"),
}


def made_scene(size=SIZE, floor=None, sky=None, lamp=1.0, bsdf=None, level=3, smooth=False):
    """The README's scene, with changes: a ball over a floor, under a square lamp (of the given side) or a sky."""
    import jaxdr as jd

    ball = jd.shapes.sphere(level, radius=0.5, center=(0.0, 0.0, 0.8))
    shapes = {
        "ball": jd.Shape(ball.smooth() if smooth else ball, bsdf or jd.Diffuse((0.8, 0.5, 0.3))),
        "floor": jd.Shape(jd.shapes.plane(10.0), floor or jd.TwoSided(jd.Diffuse(0.5))),
    }
    if lamp:
        panel = jd.shapes.transformed(jd.shapes.rectangle(lamp, lamp), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
        shapes["lamp"] = jd.Shape(panel, jd.Diffuse(0.0), jd.AreaEmitter(20.0))
    camera = jd.Perspective(jd.look_at((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), 35.0, jd.Film(size, size))
    return jd.Scene(shapes, camera, sky)


def cases(oracle):
    """Functions that make (scene, motion, depth), by name."""
    import jaxdr as jd

    def readme(depth, **options):
        return lambda: (made_scene(**options), "ball.translate.x", depth)

    def in_mirror(roughness):
        def made():
            path = write_ball(roughness, common.scratch(STUDY) / f"mirror_{roughness}")
            return jd.load_mitsuba(str(path)), "ball.translate.x", 2

        return made

    def reference(name):
        motion, depth = {
            "direct_spot": ("spot.translate.x", 2),
            "shadow_goathead": ("goathead.translate.x", 2),
            "environment_penguin": ("penguin.rotate.z", 2),
            "cornell_indirect": ("spot.translate.x", 5),
            "mirror_spot": ("spot.translate.y", 4),
        }[name]
        return lambda: (jd.load_mitsuba(str(oracle / name / "scene.xml")), motion, depth)

    sky = jd.ConstantEnvironment(1.0)
    return {
        "readme": readme(2),
        "readme, indirect": readme(3),
        "a lamp x 4": readme(2, lamp=4.0),
        "a lamp x 1/8": readme(2, lamp=0.125),
        "5,120 faces": readme(2, level=4),
        "20,480 faces": readme(2, level=5),
        "81,920 faces": readme(2, level=6),
        "a sky": readme(2, lamp=None, sky=sky),
        "lamp and sky, indirect": readme(3, sky=jd.ConstantEnvironment(0.3)),
        "smooth normals": readme(2, smooth=True),
        "glossy floor, indirect": readme(3, floor=jd.RoughConductor(alpha=0.2)),
        "principled, indirect": readme(3, floor=jd.Principled(roughness=0.3), bsdf=jd.Principled(roughness=0.4)),
        "glossy floor": readme(2, floor=jd.RoughConductor(alpha=0.2)),
        "glossy floor, a sky": readme(2, lamp=None, sky=sky, floor=jd.RoughConductor(alpha=0.2)),
        "glossy floor, a lamp x 1/8": readme(2, lamp=0.125, floor=jd.RoughConductor(alpha=0.2)),
        "narrow lobes, indirect": readme(3, floor=jd.RoughConductor(alpha=0.05)),
        "glossy ball, indirect": readme(3, bsdf=jd.RoughConductor(alpha=0.05)),
        "a mirror of roughness 0.05": in_mirror(0.05),
        "a mirror of roughness 0.3": in_mirror(0.3),
        **{name: reference(name) for name in REFERENCE},
    }


def measure(case: str, made, keys: int) -> list[dict]:
    """Rows of one case."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from jaxdr.integrators.choice import choose
    from jaxdr.scene.motion import motion

    scene, moved, depth = made()
    ((name, (value, velocity)),) = motion(scene, moved).items()
    estimators = {
        "LineSampling": jd.LineSampling(),
        "KernelDensity": jd.KernelDensity(),
        "GuidedEdges": jd.GuidedEdges(),
    }
    chosen = choose(scene).estimator
    taken = type(chosen).__name__
    estimators |= {} if taken in estimators else {taken: chosen}
    rows, functions = [], {}
    for what, boundary in estimators.items():
        tracer = jd.PathTracer(depth, boundary)

        def derivative(key, tracer=tracer):
            def image(value):
                return jd.render(scene.replace({name: value}), key, SPP, tracer)

            return jax.jvp(image, (value,), (jnp.asarray(velocity),))[1]

        start, began = time.perf_counter(), time.process_time()
        functions[what] = jax.jit(derivative)
        try:
            functions[what](jax.random.key(0)).block_until_ready()
        except ValueError:
            continue  # it says that it does not cover the scene
        row = {"case": case, "estimator": f"**{what}**" if what == taken else what, "what": what}
        rows.append(row | {"first": time.perf_counter() - start, "processor": time.process_time() - began})
    answers = {row["what"]: [] for row in rows}
    for key in range(1, keys + 1):
        for what, found in answers.items():
            found.append(common.seconds_of(functions[what], jax.random.key(key)))
    for row in rows:
        images = np.stack([np.asarray(image, float) for image, _ in answers[row["what"]]])
        row["seconds"] = float(np.median([seconds for _, seconds in answers[row["what"]]]))
        row["deviation"] = float(np.sqrt(images.var(0, ddof=1).mean()))
        row["work"] = row["deviation"] ** 2 * row["seconds"]
    for row in rows:
        row["times"] = row["work"] / min(r["work"] for r in rows)
        row["default"] = row["what"] == taken
    return rows


def main():
    made = common.parser(__doc__)
    made.add_argument("--cases", default="", help="names separated by semicolons (all)")
    options = made.parse_args()
    known = cases(options.oracle)
    path = common.results(STUDY, options.quick) / "default_choice.json"
    rows = json.loads(path.read_text())["rows"] if path.exists() else []
    for case in options.cases.split(";") if options.cases else known:
        found = measure(case, known[case], 2 if options.quick else KEYS)
        rows = [row for row in rows if row["case"] != case] + found
        common.write_json(path, {"rows": sorted(rows, key=lambda row: list(known).index(row["case"]))})
        print(common.table(found, COLUMNS), flush=True)


if __name__ == "__main__":
    main()
