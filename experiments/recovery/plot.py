"""Curves of finished recoveries: loss and errors against iterations.

    python -m experiments.recovery.plot runs/pose_and_light runs/roughness_and_sky runs/duck

For each run it writes `results/<name>.png` (curves), `<name>.json` (metrics) and the picture grids of start and end.
"""

import csv
import json
import shutil
import sys
from pathlib import Path

RESULTS = Path(__file__).parent / "results"


def plot(run: Path) -> None:
    """Write the files of one run."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with open(run / "metrics.csv") as file:
        rows = list(csv.DictReader(file))
    summary = json.loads((run / "metrics.json").read_text())
    columns = ["loss", *summary["errors"]]
    figure, axes = plt.subplots(1, len(columns), figsize=(3.2 * len(columns), 2.6), squeeze=False)
    for axis, column in zip(axes[0], columns, strict=True):
        points = [(int(row["iteration"]), float(row[column])) for row in rows if row[column]]
        if column in summary["errors"]:
            points.insert(0, (0, summary["errors"][column][0]))
        axis.semilogy(*zip(*points, strict=True), lw=1)
        axis.set_title(column, fontsize=8)
        axis.set_xlabel("iteration", fontsize=8)
        axis.tick_params(labelsize=7)
    figure.tight_layout()
    figure.savefig(RESULTS / f"{run.name}.png", dpi=90)
    pictures = sorted((run / "pictures").glob("[0-9]*[0-9].png"))
    shutil.copy(pictures[0], RESULTS / f"{run.name}_start.png")
    shutil.copy(pictures[-1], RESULTS / f"{run.name}_end.png")
    (RESULTS / f"{run.name}.json").write_text(json.dumps(summary, indent=2) + "\n")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        plot(Path(argument))
