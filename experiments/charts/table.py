"""The chart of the reference scenes as a table: `results/table.md` from `results/rows.csv`.

python -m experiments.charts.table
"""

import csv

from experiments import common

STUDY = "charts"


def main():
    options = common.parser(__doc__).parse_args()
    folder = common.results(STUDY, options.quick)
    with open(folder / "rows.csv") as file:
        rows = list(csv.DictReader(file))
    estimators = list(dict.fromkeys(row["estimator"] for row in rows))
    made = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        line = {"scene": f"`{scene}`"}
        for name in estimators:
            mine = [row for row in rows if (row["scene"], row["estimator"]) == (scene, name)]
            measured = [row for row in mine if row["rmse"]]
            if measured:
                last = max(measured, key=lambda row: int(row["samples"]))
                line[name] = f"{float(last['rmse']):.2g} / {float(last['seconds']):.2g} / {float(last['work']):.2g}"
            else:
                line[name] = "refuses" if mine else ""
        made.append(line)
    table = common.table(made, {"scene": ("scene", ""), **{name: (name, "") for name in estimators}})
    (folder / "table.md").write_text(table + "\n")
    print(table)


if __name__ == "__main__":
    main()
