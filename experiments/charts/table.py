"""Errors after 1, 10 and 60 seconds on the reference scenes: `results/table.md` from `results/rows.csv`.

python -m experiments.charts.table
"""

import csv

from experiments import common
from jaxdr.chart.default import error_after

STUDY = "charts"
BUDGETS = (1.0, 10.0, 60.0)  # seconds


def cell(rows: list[dict]) -> str:
    """Errors after the budgets."""
    measured = [row for row in rows if row["rmse"]]
    if not measured:
        return "refuses" if rows else ""
    errors = [error_after(measured, budget) for budget in BUDGETS]
    return " / ".join("–" if error is None else f"{float(f'{error:.2g}'):g}" for error in errors)


def main():
    options = common.parser(__doc__).parse_args()
    folder = common.results(STUDY, options.quick)
    with open(folder / "rows.csv") as file:
        rows = list(csv.DictReader(file))
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    made = []
    for name in dict.fromkeys(row["estimator"] for row in rows):
        mine = [row for row in rows if row["estimator"] == name]
        made.append({"method": name} | {s: cell([row for row in mine if row["scene"] == s]) for s in scenes})
    table = common.table(made, {"method": ("method", ""), **{f"`{name}`": (name, "") for name in scenes}})
    (folder / "table.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
