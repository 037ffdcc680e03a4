"""Derivatives of a caustic: bidirectional and unidirectional boundary estimators at equal time, and finite differences.

    python -m experiments.bidirectional.gradients

A half pipe of rough metal throws the light of a small lamp onto a diffuse floor, and a sheet shades some of it. The
estimators run in turns, derivative by derivative, so that other work of the machine slows all of them equally.
"""

import statistics

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from experiments import common
from experiments.bidirectional.run import in_turns
from jaxdr.geometry.shapes import rectangle, transformed
from jaxdr.images import diverging, labelled_grid, save_png

STUDY, UP, DEPTH = "bidirectional", [0, 0, 1], 3
SIZE, SPP, ROUNDS, PILOTS = 32, 16, 16, 3
REFERENCE_SPP, REFERENCE_ROUNDS = 512, 32
STEP = 0.01  # of finite differences
COLUMNS = {
    "moves": ("moves", "s"),
    "method": ("method", "s"),
    "spp": ("spp", "d"),
    "s": ("seconds", ".3f"),
    "error": ("error", ".3f"),
    "projection": ("projection", ".3f"),
    "±": ("projection_error", ".3f"),
    "z of the mean": ("mean_z", ".2f"),
}


def scene(size):
    """The half pipe, the sheet, the floor, and the lamp; the camera looks down on the caustic."""
    angle = np.linspace(0.0, np.pi, 33)
    # It does not touch the floor. Where the two touch, the derivative of the light between them has infinite variance.
    arc = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.15 + 0.0 * angle], -1)
    pipe = np.concatenate([arc, arc + np.array([0.0, 0.0, 0.5])])
    i = np.arange(32)
    faces = np.concatenate([np.stack([i, i + 1, i + 34], -1), np.stack([i, i + 34, i + 33], -1)])
    sheet = np.array([[0.1, -0.4, 0.6], [0.4, -0.4, 0.6], [0.4, -0.3, 0.9], [0.1, -0.3, 0.9]])
    matrix = np.array([[1, 0, 0, 0.2], [0, -1, 0, -1.0], [0, 0, -1, 1.6], [0, 0, 0, 1.0]])
    lamp = transformed(rectangle(0.15, 0.15), matrix)
    shapes = {
        "floor": jd.Shape(rectangle(4.0, 4.0), jd.Diffuse(0.6)),
        "pipe": jd.Shape(jd.Mesh(pipe, faces), jd.TwoSided(jd.RoughConductor(0.1, "Al"))),
        "sheet": jd.Shape(jd.Mesh(sheet, [[0, 1, 2], [0, 2, 3]]), jd.TwoSided(jd.Diffuse(0.1))),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(100.0)),
    }
    view = jd.Perspective(jd.look_at([0, -0.5, 2], [0, 0.1, 0], UP), 30.0, jd.Film(size, size, jd.Gaussian()))
    return jd.Scene(shapes, view)


def motions(of):
    """Velocities of vertices by what moves: the reflector, one of its vertices, the blocker, the lamp."""
    at = {name: np.asarray(of.parameters()[f"{name}.vertices"]) for name in ("pipe", "sheet", "lamp")}
    corner = np.zeros_like(at["pipe"])
    corner[40] = [0.0, 1.0, 0.0]
    return {
        "reflector": ("pipe", np.broadcast_to([0.0, 1.0, 0.0], at["pipe"].shape)),
        "its vertex": ("pipe", corner),
        "blocker": ("sheet", np.broadcast_to([1.0, 0.0, 0.0], at["sheet"].shape)),
        "lamp": ("lamp", np.broadcast_to([1.0, 0.0, 0.0], at["lamp"].shape)),
    }


def methods():
    """Integrators by name; the first one's time is what the others get."""
    estimators = {"KernelDensity": jd.KernelDensity(capacity=1.0), "WarpedArea": jd.WarpedArea(sigma0=0.03)}
    made = {f"bidirectional {n}": jd.BidirectionalPathTracer(DEPTH, boundary=b) for n, b in estimators.items()}
    return made | {f"unidirectional {n}": jd.PathTracer(DEPTH, b) for n, b in estimators.items()}


def derivative(of, name, along, integrator, spp):
    """A compiled function of a key: the derivative image by `along`."""
    at = of.parameters()[f"{name}.vertices"]
    along = jnp.asarray(along, at.dtype)

    @jd.jit
    def image(key):
        def rendered(step):
            return jd.render(of.replace({f"{name}.vertices": at + step * along}), key, spp, integrator)

        return jax.jvp(rendered, (0.0,), (1.0,))[1]

    return lambda key: np.asarray(image(key), float)


def finite_differences(of, name, along, spp, rounds):
    """Central differences of bidirectional images, [rounds, H, W, 3]."""
    at = of.parameters()[f"{name}.vertices"]
    image = jd.jit(lambda v, key: jd.render(of.replace({f"{name}.vertices": v}), key, spp, TRACER))
    found = []
    for i in range(rounds):
        key = jax.random.fold_in(jax.random.key(7), i)
        ends = [np.asarray(image(at + sign * STEP * along, key), float) for sign in (1, -1)]
        found.append((ends[0] - ends[1]) / (2 * STEP))
    return np.stack(found)


TITLES = {
    "finite differences": "finite differences",
    "bidirectional KernelDensity": "BDPT, kernel",
    "bidirectional WarpedArea": "BDPT, warped",
    "unidirectional KernelDensity": "PT, kernel",
    "unidirectional WarpedArea": "PT, warped",
}
TRACER = jd.BidirectionalPathTracer(DEPTH)


def measure(of, moves, spp, rounds, reference):
    """(rows of the table, mean derivative images by method, the reference's first)."""
    name, along = motions(of)[moves]
    truth = finite_differences(of, name, along, *reference)
    mean, noise = truth.mean(0), truth.var(0, ddof=1).mean() / len(truth)
    power = max((mean**2).mean() - noise, 1e-30)
    pilots = in_turns([derivative(of, name, along, i, spp) for i in methods().values()], PILOTS, 100)
    times = [statistics.median(seconds) for _, seconds in pilots]
    counts = [max(1, round(spp * times[0] / t)) for t in times]
    runs = [derivative(of, name, along, i, n) for i, n in zip(methods().values(), counts, strict=True)]
    rows, pictures = [], {"finite differences": mean}
    for method, count, (images, seconds) in zip(methods(), counts, in_turns(runs, rounds, 200), strict=True):
        pictures[method] = images.mean(0)
        error2 = max(((images - mean) ** 2).mean() - noise, 0.0)
        projection = (images * mean).mean((1, 2, 3)) / power
        blurred = np.sqrt((mean**2 * truth.var(0, ddof=1)).sum() / len(truth)) / (power * mean.size)
        totals, expected = images.mean((1, 2, 3)), truth.mean((1, 2, 3))
        apart = np.sqrt(totals.var(ddof=1) / len(totals) + expected.var(ddof=1) / len(expected))
        rows.append(
            {
                "moves": moves,
                "method": method,
                "spp": count,
                "seconds": statistics.median(seconds),
                "error": float(np.sqrt(error2 / power)),
                "projection": float(projection.mean()),
                "projection_error": float(np.hypot(projection.std(ddof=1) / np.sqrt(len(projection)), blurred)),
                "mean_z": float((totals.mean() - expected.mean()) / apart),
            }
        )
        print(rows[-1], flush=True)
    return rows, pictures


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--moves", default="", help="names of what moves, separated by commas (default: all)")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    of = scene(8 if options.quick else SIZE)
    sizes = (2, 2, (16, 2)) if options.quick else (SPP, ROUNDS, (REFERENCE_SPP, REFERENCE_ROUNDS))
    rows, pictures = [], []
    for moves in options.moves.split(",") if options.moves else motions(of):
        found, images = measure(of, moves, *sizes)
        rows += found
        scale = np.quantile(np.abs(images["finite differences"]).mean(-1), 0.98)
        shown = [diverging(v.mean(-1), scale) for v in images.values()]
        pictures.append(labelled_grid([TITLES[k] for k in images], [shown]))
        common.write_json(folder / "gradients.json", {"rows": rows})
    save_png(folder / "gradients.png", np.concatenate(pictures))
    table = common.table(rows, COLUMNS)
    (folder / "gradients.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
