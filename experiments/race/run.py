"""The race: Chamfer distance against seconds, jaxdr beside Mitsuba with the same optimisation.

    python -m experiments.race.run [--objects spot penguin pawn] [--seeds 0] [--teapot FILE]

Each run has a process of its own, one after the other. Seconds include everything: compiling and targets, too.
The mesh of the teapot is not in the repository, since its source states no licence: `--teapot` names a file of it.
"""

import csv
import json
import os
import tempfile
from pathlib import Path

from experiments import common

STUDY = "race"
GOAL = 0.003  # Chamfer distance over the diagonal of the target's bounding box
MESHES = {"spot": common.DATA / "spot_low.obj", "penguin": common.DATA / "penguin.obj"}
OBJECTS = (*MESHES, "teapot", "pawn")  # the pawn is that of the quickstart
COLUMNS = {
    "object": ("object", ""),
    "seed": ("seed", "d"),
    "by": ("by", ""),
    "seconds to .0030": ("reached", ".0f"),
    "last distance": ("chamfer", ".5f"),
    "seconds": ("seconds", ".0f"),
    "of it before the first step": ("start", ".0f"),
    "seconds a step": ("step", ".3f"),
}


def one_run(side, name, seed, options):
    """(summary, rows of metrics.csv) of one run by `side`."""
    from jaxdr.optimize.config import read_config
    from jaxdr.optimize.shape import optimize

    folder = common.scratch(STUDY) / f"{name}_{seed}_{side}"
    changes = [f"output={folder}", f"seed={seed}", "report.chamfer=5", "report.pictures=1000"]
    mesh = (MESHES | {"teapot": options.teapot}).get(name)
    if mesh:
        changes += [f"target.path={mesh}", "target.up=y"]
    changes += options.set
    changes += ["optimizer.iterations=10", "samples.target=4"] if options.quick else []
    config = read_config(Path(options.config if mesh else "configs/quickstart.toml"), changes)
    if side == "jaxdr":
        summary = optimize(config, overwrite=True)
    else:
        with tempfile.TemporaryDirectory() as home:
            os.environ["HOME"] = home  # where Dr.Jit keeps its kernels: jaxdr starts without any, too
            summary = optimize_with_mitsuba(config)
    with open(Path(config.output) / "metrics.csv") as metrics:
        return summary, list(csv.DictReader(metrics))


def optimize_with_mitsuba(config):
    """The summary of a run whose images and gradients are Mitsuba's."""
    from concurrent.futures import ThreadPoolExecutor

    from experiments.race.mitsuba_side import MitsubaTask
    from jaxdr.optimize.devices import chosen_devices
    from jaxdr.optimize.run import run

    with ThreadPoolExecutor(1) as beside:
        return run(MitsubaTask(config, chosen_devices(1), beside), resume=False, overwrite=True)


def measured(side, name, seed, options):
    """A row of the table, with its curve: [(seconds, Chamfer distance)]."""
    summary, rows = common.in_fresh_process(one_run, side, name, seed, options)
    curve = [(float(row["seconds"]), float(row["chamfer"])) for row in rows if row["chamfer"]]
    first, last = float(rows[0]["seconds"]), float(rows[-1]["seconds"])
    return {
        "object": name,
        "seed": seed,
        "by": side,
        "reached": next((seconds for seconds, distance in curve if distance <= GOAL), None),
        "chamfer": summary["chamfer_final"],
        "seconds": summary["seconds"],
        "start": first,
        "step": (last - first) / (len(rows) - 1),
        "curve": curve,
    }


def chart(rows, path):
    """A panel an object: Chamfer distance over seconds."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["object"] for row in rows))
    figure, panels = plt.subplots(1, len(names), figsize=(3.6 * len(names), 3.4), sharey=True, squeeze=False)
    for panel, name in zip(panels[0], names, strict=True):
        for row in rows:
            if row["object"] == name:
                look = {"color": {"jaxdr": "C0", "Mitsuba": "C1"}[row["by"]], "linewidth": 1, "markersize": 3}
                look |= {"label": row["by"]} if row["seed"] == rows[0]["seed"] else {}
                panel.loglog(*zip(*row["curve"], strict=True), ".-", **look)
        panel.axhline(GOAL, color="gray", linewidth=0.7, linestyle=":")
        panel.set(title=name, xlabel="seconds, everything included")
        panel.grid(True, which="both", alpha=0.3)
    panels[0, 0].set_ylabel("Chamfer distance / diagonal")
    panels[0, 0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--objects", nargs="+", choices=OBJECTS, help="default: all, the teapot if its mesh is given")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--by", nargs="+", choices=("jaxdr", "Mitsuba"), default=["jaxdr", "Mitsuba"])
    parser.add_argument("--config", default="configs/spot_levels.toml", help="for all but the pawn of the quickstart")
    parser.add_argument("--teapot", type=Path, help="file of the teapot's mesh")
    parser.add_argument("--set", action="append", default=[], help="change a value of the config; repeatable")
    options = parser.parse_args()
    if "teapot" in (options.objects or ()) and not options.teapot:
        parser.error("the teapot's mesh is not in the repository: --teapot FILE")
    objects = options.objects or [name for name in OBJECTS if name != "teapot" or options.teapot]
    folder = common.results(STUDY, options.quick)
    for name in objects:
        for seed in options.seeds:
            for side in options.by:
                row = measured(side, name, seed, options)
                common.write_json(folder / f"{name}_{seed}_{side.lower()}.json", row)
                print(common.table([row], COLUMNS), flush=True)
    rows = [json.loads(file.read_text()) for file in sorted(folder.glob("*_*_*.json"))]
    chart(rows, folder / "race.png")
    table = common.table(rows, COLUMNS)
    (folder / "table.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
