"""Noise under lamps that are meshes of many faces, before and after a change: error² · seconds, calls in turns.

    python -m experiments.mesh_lamps.run --before FOLDER

`FOLDER` is a checkout of the version to compare with. Two processes, one for each version, first compile everything and
then answer in turns. Without `--before` only the present version is measured.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from experiments import common

STUDY = "mesh_lamps"
STEP, POSITIONS = 0.02, 8
VELOCITY = (1.0, 0.4, 0.2)
SPP = 16
CASES = {
    "tiny": "a lamp of 1,280 faces, a two hundred and fiftieth of its distance wide",
    "near_floor": "a lamp of 320 faces, twice its radius above the floor",
    "tiny_flat": "a flat lamp of 32 faces, a hundred and fiftieth of its distance wide",
    "wide": "a lamp of 1,280 faces, two fifths of its distance wide",
    "tiny_indirect": "tiny, with indirect light",
    "near_floor_indirect": "near_floor, with indirect light",
    "wide_indirect": "wide, with indirect light",
    "direct_spot": "the reference scene; its lamp has few faces",
}
COLUMNS = {
    "case": ("case", "s"),
    "what": ("what", "s"),
    "version": ("version", "s"),
    "projection": ("projection", ".3f"),
    "standard error": ("projection_error", ".3f"),
    "spread": ("spread", ".3g"),
    "seconds": ("seconds", ".3f"),
    "spread² · seconds": ("work", ".3g"),
}


def scene_of(case: str, oracle: Path):
    """(scene, name of the moving shape)."""
    import equinox as eqx

    import jaxdr as jd
    from jaxdr.geometry import shapes

    case = case.removesuffix("_indirect")
    if case == "direct_spot":
        scene = jd.load_mitsuba(str(oracle / case / "scene.xml"))
        return eqx.tree_at(lambda s: s.camera.film, scene, jd.Film(32, 32)), "spot"
    if case == "tiny_flat":
        pose = jd.look_at((0.9, -0.5, 2.4), (0.0, 0.0, 0.3), (0.3, 0.8, 0.1))
        lamp = shapes.transformed(shapes.plane(0.016, 4), pose)
    elif case == "wide":
        lamp = shapes.sphere(3, radius=0.5, center=(0.9, -0.5, 2.4))
    elif case == "tiny":
        lamp = shapes.sphere(3, radius=0.005, center=(0.9, -0.5, 2.4))
    else:
        lamp = shapes.sphere(2, radius=0.2, center=(0.7, -0.3, 0.4))
    size, place = (0.4, (0.0, 0.0, 0.7)) if case != "near_floor" else (0.3, (0.1, 0.0, 0.3))
    turned = np.add(place, (0.3, 0.5, 0.1))
    blocker = shapes.transformed(shapes.box(size), jd.look_at(place, turned, (0.0, 0.0, 1.0)))
    corners = np.asarray(lamp.vertices, float)[np.asarray(lamp.faces)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    named = {
        "blocker": jd.Shape(blocker, jd.TwoSided(jd.Diffuse(0.5))),
        "floor": jd.Shape(shapes.plane(6.0)),
        "lamp": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(6.0 / area)),
    }
    view = jd.Perspective(jd.look_at((-0.64, -1.5, 0.9), (-0.4, 0.36, 0.0), (0, 0, 1)), 60.0, jd.Film(16, 16))
    return jd.Scene(named, view), "blocker"


def functions(case: str, oracle: Path):
    """What is measured, as functions of (t, key): images [H, W, 3]; the first is that of `reference`."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    scene, shape = scene_of(case, oracle)
    depth = 3 if case.endswith("_indirect") else 2
    name = f"{shape}.vertices"
    still = scene.parameters()[name]
    velocity = jnp.asarray(VELOCITY, still.dtype)
    estimators = {"LineSampling": jd.LineSampling(), "GuidedEdges": jd.GuidedEdges()}

    def at(t, key, spp, boundary):
        return jd.render(scene.replace({name: still + t * velocity}), key, spp, jd.PathTracer(depth, boundary))

    def derivative(boundary):
        return jd.jit(lambda t, key: jax.jvp(lambda t: at(t, key, SPP, boundary), (t,), (jnp.ones(()),))[1])

    found = {"reference": jd.jit(lambda t, key: at(t, key, 512, None))}
    found |= {"image": jd.jit(lambda t, key: at(t, key, SPP, None))}
    return found | {what: derivative(boundary) for what, boundary in estimators.items()}


def serve(folder: Path, oracle: Path) -> None:
    """Answer requests, lines of JSON: the seconds of a call; its image is left in a file."""
    answers, sys.stdout = sys.stdout, sys.stderr  # Warp prints that it has started
    import jax
    import jax.numpy as jnp

    made = {}
    for line in sys.stdin:
        case, what, t, key = json.loads(line)
        if case not in made:
            made = {case: functions(case, oracle)}
        image, seconds = common.seconds_of(made[case][what], jnp.asarray(t), jax.random.key(key))
        np.save(folder / "image.npy", np.asarray(image))
        print(json.dumps(seconds), file=answers, flush=True)


class Version:
    """A process with one version of the library."""

    def __init__(self, code: Path, oracle: Path):
        self.folder = Path(tempfile.mkdtemp())
        environment = os.environ | {"PYTHONPATH": f"{code}{os.pathsep}{common.ROOT}"}
        command = [sys.executable, str(Path(__file__).resolve()), "--serve", str(self.folder), "--oracle", str(oracle)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(command, env=environment, cwd=code, **pipes)

    def __call__(self, case: str, what: str, t: float, key: int):
        """(image, seconds)."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(json.dumps([case, what, t, key]) + "\n")
        self.process.stdin.flush()
        seconds = json.loads(self.process.stdout.readline())
        return np.load(self.folder / "image.npy").astype(float), seconds


def reference(version, case: str, batches: int) -> np.ndarray:
    """Central differences with common random numbers."""
    total = 0.0
    for key in range(batches):
        ahead, behind = (version(case, "reference", t, 1000 + key)[0] for t in (STEP, -STEP))
        total = total + (ahead - behind) / (2 * STEP * batches)
    return total


def measure(case: str, versions: dict, calls: int, batches: int) -> list[dict]:
    """Rows of one case."""
    present = versions["after"]
    truth = reference(present, case, batches)
    size = np.sqrt((truth**2).mean())
    found = {}
    for what in ("image", "LineSampling", "GuidedEdges"):
        for version in versions.values():
            version(case, what, 0.0, 0)  # compiles
        for call in range(calls):
            t = STEP * (2.0 * (call % POSITIONS + 0.5) / POSITIONS - 1.0)
            for name, version in versions.items():
                found.setdefault((what, name), []).append(version(case, what, 0.0 if what == "image" else t, call))
    rows = []
    for (what, name), answers in found.items():
        images, seconds = np.stack([a[0] for a in answers]), float(np.median([a[1] for a in answers]))
        unit = np.sqrt((images.mean(0) ** 2).mean()) if what == "image" else size
        variance = images.var(0, ddof=1).mean() / unit**2
        row = {"case": case, "what": what, "version": name, "spread": float(np.sqrt(variance)), "seconds": seconds}
        row["work"] = float(variance * seconds)
        if what != "image":
            shares = (images * truth).sum((1, 2, 3)) / (truth**2).sum()
            row["projection"] = float(shares.mean())
            row["projection_error"] = float(shares.std(ddof=1) / np.sqrt(len(shares)))
        rows.append(row)
    return rows


def main():
    made = common.parser(__doc__)
    made.add_argument("--before", type=Path, help="checkout of the version to compare with")
    made.add_argument("--serve", type=Path, help="for its own use")
    made.add_argument("--cases", default=",".join(CASES), help="names separated by commas")
    made.add_argument("--calls", type=int, default=32)
    options = made.parse_args()
    if options.serve:
        serve(options.serve, options.oracle)
        return
    calls, batches = (2, 1) if options.quick else (options.calls, 16)
    versions = {} if options.before is None else {"before": Version(options.before.resolve(), options.oracle)}
    versions["after"] = Version(common.ROOT, options.oracle)
    folder = common.results(STUDY, options.quick)
    for case in options.cases.split(","):
        rows = measure(case, versions, calls, batches)
        common.write_json(folder / f"{case}.json", {"about": CASES[case], "rows": rows})
        print(common.table(rows, COLUMNS), flush=True)


if __name__ == "__main__":
    main()
