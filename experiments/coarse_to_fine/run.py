"""What levels are worth: Chamfer distance against seconds with fixed settings and from coarse to fine.

    python -m experiments.coarse_to_fine.run [--levels configs/spot_levels.toml]

Both runs start in processes of their own, one after the other; seconds are of everything, compilation included.
"""

import csv
from itertools import pairwise

from experiments import common

STUDY = "coarse_to_fine"
COLUMNS = {
    "run": ("run", ""),
    "steps": ("steps", "d"),
    "seconds": ("seconds", ".0f"),
    "Chamfer distance": ("chamfer", ".5f"),
    "seconds to the fixed run's": ("reached", ".0f"),
}


def run(config, quick, target):
    """(summary, rows of metrics.csv) of a run."""
    from pathlib import Path

    from jaxdr.optimize.config import read_config
    from jaxdr.optimize.loop import optimize

    changes = [f"output={common.scratch(STUDY) / Path(config).stem}", "report.chamfer=10", "report.pictures=1000"]
    changes += [f"target.path={target}"] if target else []
    changes += ["optimizer.iterations=20", "samples.target=4", "optimizer.learning_rate=0.02"] if quick else []
    made = read_config(Path(config), changes)
    summary = optimize(made, overwrite=True)
    with open(Path(made.output) / "metrics.csv") as file:
        return summary, list(csv.DictReader(file))


def curve(rows):
    """(seconds, Chamfer distance) where it was measured."""
    return [(float(row["seconds"]), float(row["chamfer"])) for row in rows if row["chamfer"]]


def chart(curves, changes, path):
    """Chamfer distance over seconds; where levels begin is marked."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(6.4, 3.8))
    for name, points in curves.items():
        (line,) = panel.semilogy(*zip(*points, strict=True), ".-", label=name)
        for seconds in changes[name]:
            panel.axvline(seconds, color=line.get_color(), linewidth=0.8, linestyle=":")
    panel.set(xlabel="seconds, compilation included", ylabel="Chamfer distance / diagonal")
    panel.grid(True, which="both", alpha=0.3)
    panel.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--fixed", default="configs/spot.toml")
    parser.add_argument("--levels", default="configs/spot_levels.toml")
    parser.add_argument("--target", default="", help="mesh to be found, if not at the place that the configs name")
    options = parser.parse_args()
    folder, rows, curves, changes = common.results(STUDY, options.quick), [], {}, {}
    for name in ("fixed", "levels"):
        summary, metrics = common.in_fresh_process(run, getattr(options, name), options.quick, options.target)
        curves[name] = curve(metrics)
        changes[name] = [
            float(row["seconds"])
            for before, row in pairwise(metrics)
            if (before["level"], before["vertices"]) != (row["level"], row["vertices"])
        ]
        goal = curves["fixed"][-1][1]
        reached = next((seconds for seconds, distance in curves[name] if distance <= goal), None)
        rows.append(
            {
                "run": name,
                "steps": summary["iterations"],
                "seconds": summary["seconds"],
                "chamfer": summary["chamfer_final"],
                "reached": reached,
            }
        )
        common.write_json(folder / "coarse_to_fine.json", {"rows": rows, "curves": curves, "changes": changes})
    chart(curves, changes, folder / "coarse_to_fine.png")
    print(common.table(rows, COLUMNS))


if __name__ == "__main__":
    main()
