"""Strategies and guides of `GuidedEdges` in an optimisation (Yan et al. 2022, figures 9 and 10): Chamfer distances.

    python -m experiments.guides.recovery [--seed 0 1] [--target MESH]

It runs `configs/sun_and_sky.toml` with different settings, each in a process of its own, one after the other. All have
the same number of steps. Seconds include everything, also compilation and guides, which are built anew for every view
of every step.
"""

import csv
import json
from itertools import pairwise
from pathlib import Path

from experiments import common

STUDY = "guides"
CONFIG = "configs/sun_and_sky.toml"
SETTINGS = {
    "light": {"sampling": "emitter"},
    "direction": {"sampling": "direction"},
    "both": {"sampling": "mis"},
    "both, grid": {"sampling": "mis", "guide": "grid"},
    "both, kd-trees": {"sampling": "mis", "guide": "kdtree"},
    "both, kd-trees, sorted": {"sampling": "mis", "guide": "kdtree", "sort": True},
}
COLUMNS = {
    "setting": ("setting", ""),
    "seed": ("seed", "d"),
    "Chamfer distance": ("chamfer", ".5f"),
    "seconds": ("seconds", ".0f"),
    "a step": ("step", ".2f"),
}


def run(setting, seed, quick, target):
    """(summary, rows of metrics.csv) of a run."""
    from jaxdr.optimize.config import read_config
    from jaxdr.optimize.shape import optimize

    folder = common.scratch(STUDY) / f"recovery_{seed}_{setting.replace(', ', '_')}"
    changes = [f"output={folder}", f"seed={seed}", "report.pictures=1000", "report.chamfer=10"]
    changes += [f"target.path={target}"] if target else []
    changes += [f"integrator.boundary_options.{key}={json.dumps(value)}" for key, value in SETTINGS[setting].items()]
    changes += ["optimizer.iterations=20", "samples.target=4", "optimizer.remesh=[]"] if quick else []
    summary = optimize(read_config(Path(CONFIG), changes), overwrite=True)
    with open(folder / "metrics.csv") as file:
        return summary, list(csv.DictReader(file))


def measured(setting, options, seed):
    """The row and the curve of a run."""
    summary, metrics = common.in_fresh_process(run, setting, seed, options.quick, options.target)
    curve = [(int(row["iteration"]), float(row["seconds"]), float(row["chamfer"])) for row in metrics if row["chamfer"]]
    seconds = [float(row["seconds"]) for row in metrics]
    steps = sorted(b - a for a, b in pairwise(seconds))
    row = {"setting": setting, "seed": seed, "chamfer": summary["chamfer_final"], "seconds": summary["seconds"]}
    return {"row": row | {"step": steps[len(steps) // 2]}, "curve": curve}


def chart(runs, path):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
    for found in runs:
        color, label = f"C{list(SETTINGS).index(found['row']['setting'])}", found["row"]["setting"]
        first = found["row"]["seed"] == runs[0]["row"]["seed"]
        steps, seconds, distances = zip(*found["curve"], strict=True)
        for panel, across in zip(panels, (steps, seconds), strict=True):
            panel.semilogy(across, distances, color=color, label=label if first else None, linewidth=0.9)
    panels[0].set(xlabel="steps", ylabel="Chamfer distance / diagonal")
    panels[1].set(xlabel="seconds")
    for panel in panels:
        panel.grid(True, which="both", alpha=0.3)
    panels[0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--seed", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--target", default="", help="mesh to be found, if not at the place that the config names")
    options = parser.parse_args()
    folder, runs = common.results(STUDY, options.quick), []
    for seed in options.seed:
        for setting in SETTINGS:
            runs.append(measured(setting, options, seed))
            print(runs[-1]["row"], flush=True)
            common.write_json(folder / "recovery.json", {"runs": runs})
    chart(runs, folder / "recovery.png")
    table = common.table([found["row"] for found in runs], COLUMNS)
    (folder / "recovery.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
