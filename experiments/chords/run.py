"""Variance · seconds of derivative images against the chords of LineSampling per path sample, on the reference scenes.

    python -m experiments.chords.run

Line sampling is unbiased for any number of chords, so only variance and time matter. All numbers take turns, call by
call, in one process. Only the ratios along a row mean anything.
"""

import json

import numpy as np
from tqdm import tqdm

from experiments import common
from experiments.reference_scenes import SCENES, load

STUDY = "chords"
CHORDS = (0.5, 1.0, 2.0, 4.0, 8.0)  # and as many backgrounds


def measure(folder, spp, keys, chords):
    """A row for every number of chords: variance of the derivative image, median seconds, and their product."""
    import jax

    import jaxdr as jd

    reference = load(folder)

    def derivative_of(count):
        boundary = jd.LineSampling(chords=count, backgrounds=count)
        return reference.derivative(jd.PathTracer(max_depth=reference.max_depth, boundary=boundary), spp)

    functions = [derivative_of(count) for count in chords]
    for function in functions:
        common.seconds_of(function, jax.random.key(12345))
    images, seconds = [[] for _ in chords], [[] for _ in chords]
    for k in tqdm(range(keys), desc=f"{folder.name} {spp} spp", leave=False):
        for i, function in enumerate(functions):
            image, took = common.seconds_of(function, jax.random.key(k))
            images[i].append(np.asarray(image, float))
            seconds[i].append(took)
    rows = []
    for count, stack, took in zip(chords, images, seconds, strict=True):
        variance = np.var(stack, axis=0, ddof=1).mean()
        time = float(np.median(took))
        row = {"scene": folder.name, "spp": spp, "chords": count, "variance": variance, "seconds": time}
        rows.append(row | {"work": variance * time})
    return rows


def table(rows):
    """work over that of one chord, a line a scene and number of samples."""
    lines = [
        "| scene | spp | " + " | ".join(f"{count:g}" for count in CHORDS) + " |",
        "|" + " --- |" * (len(CHORDS) + 2),
    ]
    for scene, spp in dict.fromkeys((row["scene"], row["spp"]) for row in rows):
        mine = {row["chords"]: row for row in rows if (row["scene"], row["spp"]) == (scene, spp)}
        cells = [f"{mine[count]['work'] / mine[1.0]['work']:.2f} ({mine[count]['seconds']:.2f} s)" for count in CHORDS]
        lines.append(f"| {scene} | {spp} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--scene", choices=SCENES, action="append", help="may be repeated; default: all")
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--keys", type=int, default=8)
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    file = folder / "chords.json"
    rows = json.loads(file.read_text())["rows"] if file.exists() else []
    for name in options.scene or SCENES[: 1 if options.quick else None]:
        keys = 2 if options.quick else options.keys
        fresh = common.in_fresh_process(measure, options.oracle / name, options.spp, keys, CHORDS)
        rows = [row for row in rows if (row["scene"], row["spp"]) != (name, options.spp)] + fresh
        rows.sort(key=lambda row: (SCENES.index(row["scene"]), row["spp"], row["chords"]))
        common.write_json(file, {"rows": rows})
        print(table([row for row in rows if row["scene"] == name]), flush=True)
    (folder / "table.md").write_text(table(rows) + "\n")


if __name__ == "__main__":
    main()
