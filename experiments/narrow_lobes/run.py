"""Noise of derivatives under light that narrow lobes and glass send to a diffuse surface, by several versions.

    python -m experiments.narrow_lobes.run --versions before=CHECKOUT after=.

In `floor 0.1` a diffuse ball moves over a floor that is a mirror of roughness 0.1 (depth 3). In `lens` a board moves
behind a glass lens, and the camera sees it through the lens (depth 4). Each version answers in a process of its own.
Rows have projections of its derivative images on central differences with other keys, their spread, and processor
seconds of a call.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from experiments import common

STUDY = "narrow_lobes"
STEP, POSITIONS = 0.02, 8
SIZE = 32
CASES = ("floor 0.01", "floor 0.03", "floor 0.1", "floor 0.3", "lens")
BOUNDARIES = ("LineSampling", "KernelDensity")
REFERENCES, REFERENCE_SPP = 3, 512
COLUMNS = {
    "version": ("version", "s"),
    "case": ("case", "s"),
    "boundary": ("boundary", "s"),
    "projection": ("projection", ".3f"),
    "standard error": ("error", ".3f"),
    "of one call": ("spread", ".3g"),
    "of the reference": ("reference_error", ".2g"),
    "seconds": ("seconds", ".2f"),
    "variance · seconds": ("work", ".3g"),
}


def floor(roughness: float):
    """(a ball, its floor and a square lamp; what moves; its velocity; max_depth)."""
    import jaxdr as jd
    from jaxdr.geometry import shapes

    lamp = shapes.transformed(shapes.plane(0.6), jd.look_at((0.8, 0.5, 2.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    named = {
        "ball": jd.Shape(shapes.sphere(2, radius=0.4, center=(0.0, 0.0, 0.5)), jd.Diffuse((0.7, 0.6, 0.5))),
        "floor": jd.Shape(shapes.plane(4.0), jd.RoughConductor(roughness)),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(8.0)),
    }
    view = jd.Perspective(jd.look_at((0.6, -3.0, 1.0), (0.0, 0.0, 0.4), (0, 0, 1)), 30.0, jd.Film(SIZE, SIZE))
    return jd.Scene(named, view), "ball.vertices", (1.0, 0.4, 0.2), 3


def lens():
    """As `floor`: a board behind a glass lens, before a grey wall."""
    import jaxdr as jd
    from jaxdr.geometry import shapes

    def facing(size, y):
        return shapes.transformed(shapes.plane(size), jd.look_at((0, y, 0), (0, y - 1, 0), (0, 0, 1)))

    place = np.diag([0.5, 0.12, 0.5, 1.0])
    lamp = shapes.transformed(shapes.plane(1.0), jd.look_at((1.5, -1.0, 2.5), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)))
    named = {
        "board": jd.Shape(facing(0.6, 1.0), jd.TwoSided(jd.Diffuse((0.8, 0.5, 0.3)))),
        "wall": jd.Shape(facing(6.0, 2.0), jd.TwoSided(jd.Diffuse(0.4))),
        "lens": jd.Shape(shapes.transformed(shapes.sphere(3), place), jd.Dielectric()),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(8.0)),
    }
    view = jd.Perspective(jd.look_at((0.0, -3.0, 0.0), (0.0, 0.0, 0.0), (0, 0, 1)), 22.0, jd.Film(SIZE, SIZE))
    return jd.Scene(named, view), "board.vertices", (1.0, 0.2, 0.4), 4


def measure(case: str, boundaries: list[str], calls: int, spp: int, references: int) -> list[dict]:
    """Rows of one case, of the version that is imported."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    kind, _, roughness = case.partition(" ")
    scene, name, velocity, depth = floor(float(roughness)) if kind == "floor" else lens()
    still, velocity = scene.parameters()[name], jnp.asarray(velocity)

    def at(t, key, samples, boundary):
        moved = scene.replace({name: still + t * velocity})
        return jd.render(moved, key, samples, jd.PathTracer(depth, boundary))

    image = jd.jit(lambda t, key: at(t, key, REFERENCE_SPP, None))
    truths = []
    for number in range(2 * references):
        key = jax.random.key(10_000 + number)
        ahead, behind = (np.asarray(image(jnp.float32(t), key), float) for t in (STEP, -STEP))
        truths.append((ahead - behind) / (2 * STEP))
    weights = np.mean(truths[::2], 0)  # of other keys than what they are compared with
    exact = [np.sum(weights * truth) for truth in truths[1::2]]
    unit, unit_error = np.mean(exact), np.std(exact, ddof=1) / np.sqrt(references)
    rows = []
    for estimator in boundaries:
        boundary = getattr(jd, estimator)()
        derivative = jd.jit(lambda t, key, b=boundary: jax.jvp(lambda t: at(t, key, spp, b), (t,), (jnp.ones(()),))[1])
        derivative(jnp.float32(0), jax.random.key(0)).block_until_ready()
        shares, start = [], time.process_time()
        for call in range(calls):
            t = STEP * (2.0 * (call % POSITIONS + 0.5) / POSITIONS - 1.0)
            shares.append(np.sum(weights * np.asarray(derivative(jnp.float32(t), jax.random.key(call)), float)) / unit)
        seconds, spread = (time.process_time() - start) / calls, float(np.std(shares, ddof=1))
        rows.append(
            {
                "case": case,
                "boundary": estimator,
                "projection": float(np.mean(shares)),
                "error": spread / calls**0.5,
                "reference_error": float(unit_error / unit),
                "spread": spread,
                "seconds": seconds,
                "work": spread**2 * seconds,
            }
        )
    return rows


def main():
    made = common.parser(__doc__)
    made.add_argument("--versions", nargs="+", default=["after=."], help="name=CHECKOUT")
    made.add_argument("--measure", help="for its own use")
    made.add_argument("--cases", nargs="+", default=CASES)
    made.add_argument("--boundaries", nargs="+", default=BOUNDARIES)
    made.add_argument("--calls", type=int, default=32)
    made.add_argument("--spp", type=int, default=16)
    options = made.parse_args()
    if options.measure:
        arguments = json.loads(options.measure)
        answers, sys.stdout = sys.stdout, sys.stderr  # Warp prints that it has started
        print(json.dumps(measure(*arguments)), file=answers)
        return
    rows = []
    for case in options.cases:
        for version in options.versions:
            name, _, folder = version.partition("=")
            code = Path(folder).resolve()
            calls, references = (2, 2) if options.quick else (options.calls, REFERENCES)
            arguments = json.dumps([case, list(options.boundaries), calls, options.spp, references])
            environment = os.environ | {"PYTHONPATH": f"{code}{os.pathsep}{common.ROOT}"}
            command = [sys.executable, str(Path(__file__).resolve()), "--measure", arguments]
            answer = subprocess.run(command, env=environment, cwd=code, stdout=subprocess.PIPE, check=True, text=True)
            rows += [{"version": name} | row for row in json.loads(answer.stdout)]
            print(common.table(rows, COLUMNS), flush=True)
    common.write_json(common.results(STUDY, options.quick) / "rows.json", {"rows": rows})


if __name__ == "__main__":
    main()
