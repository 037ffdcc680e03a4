"""Processor seconds of tracing, lowering and compiling a first image, against the number of shapes in the scene.

    python -m experiments.real_scenes.many_shapes --versions before=CHECKOUT after=.

Boxes of different colours under a lamp. Each version and number has a process of its own.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from experiments import common

STUDY = "real_scenes"
COUNTS = (10, 100, 400)
COLUMNS = {
    "version": ("version", "s"),
    "shapes": ("shapes", "d"),
    "trace": ("trace", ".1f"),
    "lower": ("lower", ".1f"),
    "compile": ("compile", ".1f"),
}


def measure(count: int) -> dict:
    """The times of the version that is imported."""
    import jax

    import jaxdr as jd
    from jaxdr.geometry import shapes

    boxes = {
        f"box{i}": jd.Shape(shapes.box(0.5, (i % 20 - 10, i // 20 - 10, 0.0)), jd.Diffuse((0.5, 0.8 * i / count, 0.3)))
        for i in range(count)
    }
    lamp = jd.Shape(shapes.plane(3.0), jd.Diffuse(0.0), jd.AreaEmitter(3.0))
    view = jd.Perspective(jd.look_at((0, -20, 20), (0, 0, 0), (0, 0, 1)), 40.0, jd.Film(32, 32))
    leaves, structure = jax.tree.flatten(jd.Scene(boxes | {"lamp": lamp}, view))

    @jax.jit
    def image(leaves):
        return jd.render(jax.tree.unflatten(structure, leaves), jax.random.key(0), 4, jd.PathTracer())

    row, state = {"shapes": count}, image
    for name in ("trace", "lower", "compile"):
        start = time.process_time()
        state = getattr(state, name)(*([leaves] if name == "trace" else []))
        row[name] = time.process_time() - start
    return row


def main():
    made = common.parser(__doc__)
    made.add_argument("--versions", nargs="+", default=["after=."], help="name=CHECKOUT")
    made.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    made.add_argument("--measure", type=int, help="for its own use")
    options = made.parse_args()
    if options.measure:
        answers, sys.stdout = sys.stdout, sys.stderr  # Warp prints that it has started
        print(json.dumps(measure(options.measure)), file=answers)
        return
    rows = []
    for count in options.counts[:1] if options.quick else options.counts:
        for version in options.versions:
            name, _, folder = version.partition("=")
            code = Path(folder).resolve()
            environment = os.environ | {"PYTHONPATH": f"{code}{os.pathsep}{common.ROOT}"}
            command = [sys.executable, str(Path(__file__).resolve()), "--measure", str(count)]
            answer = subprocess.run(command, env=environment, cwd=code, stdout=subprocess.PIPE, check=True, text=True)
            rows.append({"version": name} | json.loads(answer.stdout))
            print(common.table(rows, COLUMNS), flush=True)
    common.write_json(common.results(STUDY, options.quick) / "many_shapes.json", {"rows": rows})


if __name__ == "__main__":
    main()
