"""Derivatives of the reference scenes in this folder, compared with their references.

    python check.py                                    all scenes
    python check.py direct_spot mirror_spot            some folders
    python check.py --case cornell --spp 4096          scenes whose name contains "cornell"
    python check.py --boundary WarpedArea --bidirectional

README.md explains the columns.
"""

import argparse
import json
import math
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent

PRIMAL_TOLERANCE = 0.03
PROJECTION_TOLERANCE = 0.05
MEAN_TOLERANCE = 0.05
MEAN_FLOOR = 0.2  # a mean gradient that cancels is measured against this share of mean |gradient|


def motion(parameter, scene_parameters):
    """The scene parameter that moves, its value, and its derivative with respect to the motion."""
    kind = parameter["kind"]
    if kind == "rotate_environment":
        name = f"{parameter['shape']}.to_world"
        x, y, z = parameter["axis"]
        generator = np.array([[0, -z, y, 0], [z, 0, -x, 0], [-y, x, 0, 0], [0, 0, 0, 0]], float)
        value = scene_parameters[name]
        derivative = generator @ np.asarray(value, float)
    else:
        name = f"{parameter['shape']}.vertices"
        value = scene_parameters[name]
        vertices = np.asarray(value, float)
        if kind == "translate":
            derivative = np.broadcast_to(np.array(parameter["direction"], float), vertices.shape)
        elif kind == "rotate":
            pivot = np.array(parameter["pivot"], float)
            derivative = np.cross(np.array(parameter["axis"], float), vertices - pivot)
        else:
            raise ValueError(f"unknown kind of parameter: {kind}")
    return name, value, derivative


def estimate(folder, oracle, parameter, options):
    """Images and derivative images, one pair per key: two arrays [keys, H, W, 3]."""
    import jax
    import jax.numpy as jnp

    import jaxdr as jd

    scene = jd.load_mitsuba(str(folder / "scene.xml"))
    name, value, derivative = motion(parameter, scene.parameters())
    value = jnp.asarray(value)
    derivative = jnp.asarray(derivative, value.dtype)

    boundary = None if options.boundary.lower() == "none" else getattr(jd, options.boundary)()
    tracer = jd.BidirectionalPathTracer if options.bidirectional else jd.PathTracer
    integrator = tracer(max_depth=oracle["max_depth"], boundary=boundary)
    spp = max(2, options.spp // options.keys)

    @jax.jit
    def image_and_derivative(key):
        def image(v):
            return jd.render(scene.replace({name: v}), key, spp=spp, integrator=integrator)

        return jax.jvp(image, (value,), (derivative,))

    keys = jax.random.split(jax.random.key(options.seed), options.keys)
    pairs = [jax.device_get(image_and_derivative(key)) for key in keys]
    return tuple(np.stack([np.asarray(pair[i], float) for pair in pairs]) for i in (0, 1))


def compare(folder, oracle, parameter, images, gradients):
    """The numbers of one row."""
    image_reference = np.load(folder / oracle["primal"]["file"]).astype(float)
    reference = np.load(folder / parameter["file"]).astype(float)
    if images.shape[1:] != image_reference.shape:
        raise ValueError(f"image has shape {images.shape[1:]}, expected {image_reference.shape}")
    for what, array in (("image", images), ("derivative", gradients)):
        bad = int((~np.isfinite(array)).sum())
        if bad:
            raise ValueError(f"{bad} values of the {what} are not finite")

    keys = len(images)
    # Squared error of the image without what Monte Carlo noise (ours and the reference's) adds to it.
    error = np.mean((images.mean(0) - image_reference) ** 2)
    noise = np.mean(images.var(0, ddof=1)) / keys + oracle["primal"]["noise_rms"] ** 2
    primal = math.sqrt(max(error - noise, 0.0) / np.mean(image_reference**2))

    gradient = gradients.mean(0)
    power = np.mean(reference**2) - parameter["noise_rms"] ** 2
    projections = np.mean(gradients * reference, axis=(1, 2, 3)) / power
    means = gradients.mean((1, 2, 3))
    mean_error = abs(means.mean() - parameter["mean_gradient"])
    mean_deviation = math.hypot(means.std(ddof=1) / math.sqrt(keys), parameter["mean_gradient_standard_error"])
    scale = max(abs(parameter["mean_gradient"]), MEAN_FLOOR * parameter["mean_absolute_gradient"])
    row = dict(
        primal=primal,
        projection=projections.mean(),
        projection_error=projections.std(ddof=1) / math.sqrt(keys),
        rmse=math.sqrt(np.mean((gradient - reference) ** 2)) / parameter["reference_rms"],
        mean=mean_error / scale,
    )
    row["passed"] = bool(
        row["primal"] < PRIMAL_TOLERANCE
        and abs(row["projection"] - 1) <= PROJECTION_TOLERANCE
        and (row["mean"] <= MEAN_TOLERANCE or mean_error <= 3 * mean_deviation)
    )
    return row


def folders(names, pattern):
    chosen = [Path(name) for name in names] if names else sorted(p.parent for p in ROOT.glob("*/oracle.json"))
    chosen = [p if (p / "oracle.json").exists() else ROOT / p for p in chosen]
    return [p for p in chosen if not pattern or pattern in p.name]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folders", nargs="*", help="scene folders (default: all beside this file)")
    parser.add_argument("--case", default="", help="only folders whose name contains this")
    parser.add_argument("--spp", type=int, default=1024, help="samples per pixel, all keys together (default 1024)")
    parser.add_argument("--keys", type=int, default=8, help="independent keys that share the samples (default 8)")
    parser.add_argument("--boundary", default="KernelDensity", help="KernelDensity, GuidedEdges, WarpedArea or none")
    parser.add_argument("--bidirectional", action="store_true", help="BidirectionalPathTracer in place of PathTracer")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", help="also write the rows to this file")
    options = parser.parse_args()
    if options.keys < 2:
        parser.error("--keys must be at least 2: the spread between keys gives the standard errors")

    chosen = folders(options.folders, options.case)
    if not chosen:
        parser.error("no scene folder matches")
    integrator = "BidirectionalPathTracer" if options.bidirectional else "PathTracer"
    print(f"{integrator}, {options.boundary}, {options.spp} samples per pixel in {options.keys} keys")
    header = f"{'case':24}{'parameter':22}{'primal':>8}{'projection':>18}{'rmse':>8}{'mean':>8}{'seconds':>9}  result"
    print(header + "\n" + "-" * len(header))

    rows = []
    for folder in chosen:
        oracle = json.loads((folder / "oracle.json").read_text())
        for parameter in oracle["parameters"]:
            start = time.perf_counter()
            row = dict(case=folder.name, parameter=parameter["name"])
            label = f"{folder.name:24}{parameter['name']:22}"
            try:
                row |= compare(folder, oracle, parameter, *estimate(folder, oracle, parameter, options))
                row["seconds"] = time.perf_counter() - start
                result = "pass" if row["passed"] else "FAIL"
                print(
                    f"{label}{row['primal']:8.2%}{row['projection']:9.3f} ± {row['projection_error']:.3f}"
                    f"{row['rmse']:10.3f}{row['mean']:8.1%}{row['seconds']:9.1f}  {result}",
                    flush=True,
                )
            except Exception as problem:  # one broken scene must not hide the others
                row["seconds"] = time.perf_counter() - start
                row["passed"] = False
                text = (str(problem).strip().splitlines() or [""])[0]
                row["problem"] = f"{type(problem).__name__}: {text}"[:200]
                print(f"{label}{'':42}{row['seconds']:9.1f}  FAIL  {row['problem']}", flush=True)
            rows.append(row)

    if options.json:
        Path(options.json).write_text(json.dumps(rows, indent=2))
    passed = sum(row["passed"] for row in rows)
    print(f"{passed} of {len(rows)} passed")
    return 0 if passed == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
