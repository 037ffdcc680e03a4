"""Chamfer distance against seconds: fixed settings compared with levels from coarse to fine.

    python -m experiments.coarse_to_fine.run [--seed N ...] [--levels configs/spot_levels.toml]

Each run has a process of its own, one after the other. Seconds include everything, also compilation. Seeds that were
measured before stay in the table and the picture.
"""

import csv
import json
from itertools import pairwise

from experiments import common

STUDY = "coarse_to_fine"
COLUMNS = {
    "seed": ("seed", "d"),
    "run": ("run", ""),
    "steps": ("steps", "d"),
    "seconds": ("seconds", ".0f"),
    "Chamfer distance": ("chamfer", ".5f"),
    "seconds to the fixed run's": ("reached", ".0f"),
}


def run(config, seed, quick, target):
    """(summary, rows of metrics.csv) of a run."""
    from pathlib import Path

    from jaxdr.optimize.config import read_config
    from jaxdr.optimize.shape import optimize

    folder = common.scratch(STUDY) / f"{Path(config).stem}_{seed}"
    changes = [f"output={folder}", f"seed={seed}", "report.chamfer=10", "report.pictures=1000"]
    changes += [f"target.path={target}"] if target else []
    changes += ["optimizer.iterations=20", "samples.target=4", "optimizer.learning_rate=0.02"] if quick else []
    made = read_config(Path(config), changes)
    summary = optimize(made, overwrite=True)
    with open(Path(made.output) / "metrics.csv") as file:
        return summary, list(csv.DictReader(file))


def curve(rows):
    """(seconds, Chamfer distance) where it was measured."""
    return [(float(row["seconds"]), float(row["chamfer"])) for row in rows if row["chamfer"]]


def chart(studies, path):
    """Chamfer distance over seconds, a line a run; where levels begin is marked."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(6.4, 3.8))
    for number, study in enumerate(studies):
        for color, (name, points) in zip(("C0", "C1"), study["curves"].items(), strict=True):
            label = name if number == 0 else None
            panel.semilogy(*zip(*points, strict=True), ".-", color=color, label=label, linewidth=0.9, markersize=3)
            for seconds in study["changes"][name]:
                panel.axvline(seconds, color=color, linewidth=0.8, linestyle=":")
    panel.set(xlabel="seconds, compilation included", ylabel="Chamfer distance / diagonal")
    panel.grid(True, which="both", alpha=0.3)
    panel.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def measured(options, seed):
    """Rows, curves and times of change of both runs of a seed."""
    rows, curves, changes = [], {}, {}
    for name in ("fixed", "levels"):
        summary, metrics = common.in_fresh_process(run, getattr(options, name), seed, options.quick, options.target)
        curves[name] = curve(metrics)
        changes[name] = [
            float(row["seconds"])
            for before, row in pairwise(metrics)
            if (before["level"], before["vertices"]) != (row["level"], row["vertices"])
        ]
        goal = curves["fixed"][-1][1]
        row = {"seed": seed, "run": name, "steps": summary["iterations"], "seconds": summary["seconds"]}
        row["reached"] = next((seconds for seconds, distance in curves[name] if distance <= goal), None)
        rows.append(row | {"chamfer": summary["chamfer_final"]})
    return {"rows": rows, "curves": curves, "changes": changes}


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--fixed", default="configs/spot.toml")
    parser.add_argument("--levels", default="configs/spot_levels.toml")
    parser.add_argument("--seed", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--target", default="", help="mesh to be found, if not at the place that the configs name")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    for seed in options.seed:
        common.write_json(folder / f"seed_{seed}.json", measured(options, seed))
        studies = [json.loads(file.read_text()) for file in sorted(folder.glob("seed_*.json"))]
        chart(studies, folder / "coarse_to_fine.png")
        table = common.table([row for study in studies for row in study["rows"]], COLUMNS)
        (folder / "table.md").write_text(table + "\n")
        print(table, flush=True)


if __name__ == "__main__":
    main()
