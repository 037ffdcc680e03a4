"""Guides of `GuidedEdges` against Mitsuba's octree on `shadow_goathead`, from a chart's rows.

    jaxdr chart configs/chart_guides.toml --set peers=true
    python -m experiments.guides.octree [--rows runs/chart_guides/rows.csv]

The seconds of a call are a for building the guide and b for each sample, by a line through the rungs of the chart. The
squared error is c over the number of samples. So an error takes a + b c / error² seconds. b c is error² · seconds once
the guide is paid off.
"""

import csv
import shutil
from pathlib import Path

import numpy as np

from experiments import common

STUDY = "guides"
OCTREE = "Mitsuba, octree"
COLUMNS = {
    "estimator": ("estimator", ""),
    "seconds to build": ("build", ".2f"),
    "seconds to Mitsuba's error": ("seconds", ".2f"),
    "as a share of Mitsuba's": ("share", ".2f"),
    "error² x seconds, paid off": ("work", ".3f"),
    "as a share of Mitsuba's ": ("work_share", ".2f"),
    "projection": ("projection", ".3f"),
    "±": ("projection_error", ".3f"),
}


def fitted(rows):
    """(a, b, c) of an estimator's rungs."""
    samples, seconds, deviation = (np.array([float(r[k]) for r in rows]) for k in ("samples", "seconds", "deviation"))
    # Relative residuals: the longest calls have the largest noise.
    basis = np.stack([np.ones_like(samples), samples], 1) / seconds[:, None]
    a, b = np.linalg.lstsq(basis, np.ones_like(samples), rcond=None)[0]
    return max(float(a), 0.0), float(b), float(np.mean(deviation**2 * samples))


def compared(rows):
    """Table rows; Mitsuba's error is that of its middle rung, bias left out for everyone."""
    lines = {}
    for row in rows:
        if row["deviation"]:
            lines.setdefault(row["estimator"], []).append(row)
    octree = sorted(lines[OCTREE], key=lambda row: int(row["samples"]))
    middle = octree[len(octree) // 2]
    error2, theirs = float(middle["deviation"]) ** 2, float(middle["seconds"])
    _, b, c = fitted(octree)
    paid = b * c
    for name, rungs in lines.items():
        last = max(rungs, key=lambda row: int(row["samples"]))
        a, b, c = fitted(rungs)
        yield {
            "estimator": name, "build": a, "seconds": a + b * c / error2, "share": (a + b * c / error2) / theirs,
            "work": b * c, "work_share": b * c / paid,
            "projection": float(last["projection"]), "projection_error": float(last["projection_error"]),
        }  # fmt: skip


def main():
    parser = common.parser(__doc__)
    parser.add_argument("--rows", type=Path, help="rows.csv of a chart (default: the rows in results/)")
    options = parser.parse_args()
    folder = common.results(STUDY, options.quick)
    kept = folder / "octree.csv"
    if options.rows:
        shutil.copy(options.rows, kept)
        picture = options.rows.parent / "shadow_goathead.png"
        if picture.exists():
            shutil.copy(picture, folder / "octree.png")
    with open(kept) as file:
        table = common.table(list(compared(csv.DictReader(file))), COLUMNS)
    (folder / "octree.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
