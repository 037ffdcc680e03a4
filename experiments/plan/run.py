"""The plan against every fixed choice, the gain from leaving out edges, sizes of programs, and depths by brute force.

python -m experiments.plan.run --part choices|edges|program|depth [--scene NAME]
"""

import json
import statistics

import numpy as np

from experiments import common
from experiments.plan.scenes import SCENES, diffuse, everything, load, room

STUDY = "plan"
PARTS = ("choices", "edges", "program", "depth")
SPP = 8


def choices(name, oracle, budget, keys, spp=SPP):
    """Squared error times seconds of what a plan chose and of every fixed setting, all in turns, on one scene.

    All have the depth of the scene, and fresh random numbers. The error is the noise, since only `WarpedArea` is biased
    on these scenes.
    """
    import jax

    import jaxdr as jd
    from jaxdr.plan.directions import direction, moving_along
    from jaxdr.plan.pilot import Pilot, Refused
    from jaxdr.plan.plan import small_film

    scene, parameter, depth = load(name, oracle)
    plan, pilots = common.seconds_of(lambda: jd.plan(scene, [parameter], budget, max_depth=depth))
    fixed = {
        "LineSampling": jd.LineSampling(),
        "LineSampling, chords 4": jd.LineSampling(chords=4.0),
        "KernelDensity": jd.KernelDensity(),
        "KernelDensity, radius 0.06": jd.KernelDensity(radius=0.06),
        "GuidedEdges": jd.GuidedEdges(),
        "WarpedArea": jd.WarpedArea(),
    }
    settings = {"plan": (plan.integrator, spp)}
    settings |= {label: (jd.PathTracer(depth, estimator), spp) for label, estimator in fixed.items()}
    small, _ = small_film(scene)
    along = direction(scene, [parameter], jax.random.key(1))
    moving = moving_along(scene, tuple(along.values))
    pilot = Pilot(small, along, moving, jax.random.key(100))
    rounds = [pilot(settings, jax.random.key(100 + k)) for k in range(keys)]
    rows = []
    for label in settings:
        found = [some[label] for some in rounds]
        row = {"scene": name, "setting": label, "plan_seconds": pilots, "chosen": plan.figures["chosen"]}
        if isinstance(found[0], Refused):
            rows.append(row | {"refused": found[0].message})
            continue
        seconds = statistics.median(m.seconds for m in found)
        variance = statistics.fmean(m.variance for m in found)
        rows.append(row | {"seconds": seconds, "variance": variance, "work": seconds * variance})
    ours = next(row["work"] for row in rows if row["setting"] == "plan")
    works = [row["work"] for row in rows if "work" in row and row["setting"] != "plan"]
    for row in rows:
        row |= {"against_best": ours / min(works), "worst_against": max(works) / ours}
        if "work" in row:
            row["relative"] = row["work"] / ours
    return rows


def edges(statues, subdivisions, turns, spp=4):
    """Seconds of a derivative by the moving ball: with the edges of everything, and with those that can matter."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    scene = room(statues, subdivisions)
    value = scene.parameters()["ball.vertices"]
    flags = {"all edges": (True,) * len(scene.shapes), "those that matter": tuple(n == "ball" for n in scene.shapes)}
    counts = [shape.mesh.edges.vertices.shape[0] for shape in scene.shapes.values()]
    moving = sum(c for c, moves in zip(counts, flags["those that matter"], strict=True) if moves)
    programs, calls = {}, {}
    for estimator in (jd.KernelDensity(), jd.LineSampling()):
        for label, shapes in flags.items():
            tracer = jd.PathTracer(2, estimator)

            def derivative(scene, t, key, tracer=tracer, shapes=shapes):
                def terms(t):
                    moved = scene.replace({"ball.vertices": value + t * jnp.array([1.0, 0, 0])})
                    return jd.derivative_terms(moved, key, spp, tracer, jd.Moving(shapes, False))

                return sum(jax.jvp(terms, (t,), (jnp.ones_like(t),))[1].values())

            programs[type(estimator).__name__, label] = jd.jit(derivative)
    for turn in range(turns + 1):
        for name, program in programs.items():
            answer, seconds = common.seconds_of(program, scene, jnp.asarray(1e-6 * (turn + 1)), jax.random.key(turn))
            if turn:
                calls.setdefault(name, []).append((np.asarray(answer, float), seconds))
    rows = []
    for (estimator, label), some in calls.items():
        images, seconds = np.stack([c[0] for c in some]), [c[1] for c in some]
        row = {"estimator": estimator, "edges": label, "total": sum(counts), "left out": 1 - moving / sum(counts)}
        row |= {"seconds": statistics.median(seconds), "fastest": min(seconds)}
        rows.append(row | {"deviation": float(np.sqrt(images.var(0, ddof=1).mean())), "mean": float(images.mean())})
    return rows


def program():
    """Instructions and characters of lowered derivative programs by the vertices of a ball."""
    import jax

    import jaxdr as jd

    rows = []
    for label, scene in (("diffuse, direct light", diffuse()), ("everything", everything())):
        value = scene.parameters()["ball.vertices"]

        def derivative(scene, value, key):
            def image(v):
                return jd.render(scene.replace({"ball.vertices": v}), key, 2, jd.PathTracer(max_depth=2))

            return jax.jvp(image, (value,), (value,))[1]

        text = jd.jit(derivative).lower(scene, value, jax.random.key(0)).as_text()
        rows.append({"program": label, "instructions": text.count(" = "), "characters": len(text)})
    for row in rows:
        row["share"] = row["instructions"] / rows[-1]["instructions"]
    return rows


def depth(name, oracle, spp, keys, deepest):
    """What the pilot of depths finds, and the whole derivative (visibility included) of every depth."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd
    from jaxdr.plan.depth import choose_depth
    from jaxdr.plan.directions import direction, moving_along
    from jaxdr.plan.plan import DEPTH_TOLERANCE, small_film

    scene, parameter, _ = load(name, oracle)
    scene, _ = small_film(scene)
    along = direction(scene, [parameter], jax.random.key(0))
    moving = moving_along(scene, tuple(along.values))
    found = choose_depth(scene, along, DEPTH_TOLERANCE, jax.random.key(1))
    images, energy = {}, {}
    for d in range(1, deepest + 1):
        tracer = jd.PathTracer(d, jd.LineSampling())

        @jd.jit
        def both(scene, along, key, tracer=tracer):
            def terms(t):
                return sum(jd.derivative_terms(along.at(scene, t), key, spp, tracer, moving).values())

            return jax.jvp(terms, (jnp.zeros(()),), (jnp.ones(()),))

        calls = [both(scene, along, k) for k in jax.random.split(jax.random.key(2), keys)]
        energy[d] = float(np.mean([np.mean(c[0]) for c in calls]))
        images[d] = np.stack([np.asarray(c[1], float) for c in calls])
        print(f"{name}: depth {d}", flush=True)
    whole = images[deepest]

    def size(stack):  # of the mean, from products of independent calls
        return (stack.sum(0) ** 2 - (stack**2).sum(0)).mean() / (len(stack) * (len(stack) - 1))

    def share(d, calls):  # squared, that is left out at depth d as some of the calls see it: it may be negative
        return size((whole - images[d])[calls]) / size(whole[calls])

    rows, every = [], np.arange(keys)
    for d in range(1, deepest + 1):
        row = {"scene": name, "depth": d, "light": 1 - energy[d] / energy[deepest]}
        squared, without = share(d, every), [share(d, np.delete(every, k)) for k in every]
        error = np.sqrt((keys - 1) * np.var(without))  # jackknife
        row["derivative"] = float(np.sqrt(max(squared, 0.0)))
        row["at most"] = float(np.sqrt(max(squared, 0.0) + 2 * error))
        row |= {"pilot_light": float(found.energy.rest[d - 1]), "chosen": found.max_depth}
        if found.gradient is not None:
            row["pilot_derivative"] = float(found.gradient.rest[d - 1])
        rows.append(row)
    return rows


COLUMNS = {
    "choices": {
        "scene": ("scene", ""),
        "setting": ("setting", ""),
        "seconds": ("seconds", ".3f"),
        "squared error x seconds, relative to the plan's": ("relative", ".2f"),
        "chosen": ("chosen", ""),
        "refused": ("refused", ""),
    },
    "edges": {
        "estimator": ("estimator", ""),
        "edges": ("edges", ""),
        "of": ("total", ",d"),
        "left out": ("left out", ".1%"),
        "seconds": ("seconds", ".3f"),
        "fastest": ("fastest", ".3f"),
        "standard deviation": ("deviation", ".4f"),
    },
    "program": {
        "program": ("program", ""),
        "instructions": ("instructions", ",d"),
        "share": ("share", ".2f"),
    },
    "depth": {
        "scene": ("scene", ""),
        "depth": ("depth", "d"),
        "light left out": ("light", ".2%"),
        "pilot": ("pilot_light", ".2%"),
        "derivative left out": ("derivative", ".2%"),
        "at most, two standard errors": ("at most", ".2%"),
        "pilot, interior": ("pilot_derivative", ".2%"),
        "chosen": ("chosen", "d"),
    },
}


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--part", choices=PARTS, action="append", help="may be repeated; default: all")
    parser.add_argument("--scene", choices=SCENES, action="append", help="of choices and depth; default: all, and two")
    parser.add_argument("--budget", type=float, default=0.5, help="seconds of a derivative image in the pilots' film")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    quick = options.quick
    for part in options.part or PARTS:
        if part == "choices":
            names = options.scene or SCENES[: 1 if quick else None]
            jobs = {n: (choices, n, options.oracle, options.budget, 1 if quick else 4) for n in names}
        elif part == "depth":
            names = options.scene or ("cornell_indirect", "soft_lamp")[: 1 if quick else None]
            jobs = {n: (depth, n, options.oracle, *((4, 4, 3) if quick else (64, 32, 10))) for n in names}
        elif part == "edges":
            jobs = {"room": (edges, *((4, 3, 3) if quick else (8, 5, 9)))}
        else:
            jobs = {"programs": (program,)}
        for name, job in jobs.items():
            rows = common.in_fresh_process(*job)
            common.write_json(folder / f"{part}_{name}.json", {"rows": rows})
            print(common.table(rows, COLUMNS[part]) + "\n", flush=True)
            if part == "choices":
                row = rows[0]
                against = (
                    f"{row['against_best']:.2f} of the best fixed setting's, {row['worst_against']:.1f} times less"
                )
                print(f"{name}: the plan's squared error x seconds is {against} than the worst's\n", flush=True)
    if not quick:
        summary(folder)


def summary(folder):
    """`table.md`: the plan against the best and the worst fixed setting, for all scenes that were measured."""
    rows = [json.loads(file.read_text())["rows"][0] for file in sorted(folder.glob("choices_*.json"))]
    columns = {
        "scene": ("scene", ""),
        "chosen": ("chosen", ""),
        "against the best fixed": ("against_best", ".2f"),
        "the worst fixed": ("worst_against", ".1f"),
        "seconds to plan": ("plan_seconds", ".0f"),
    }
    if rows:
        (folder / "table.md").write_text(common.table(rows, columns) + "\n")


if __name__ == "__main__":
    main()
