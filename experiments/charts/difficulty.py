"""Which method to take, by what makes a scene difficult: two tables from four studies, for docs/by_difficulty.md.

    python -m experiments.charts.difficulty

It reads the results of `soft_light`, `roughness`, `tessellation` and `charts`. Nothing is measured.
"""

import csv
import json

from experiments import common

METHODS = ["LineSampling", "KernelDensity", "GuidedEdges", "AllSilhouettes", "Mitsuba, unguided", "Mitsuba, octree"]
BASELINES = ["WarpedArea", "RednerWAS", "QuadricSampling", "MarkovChains", "WalkOnCaps"]  # on the reference scenes


def of_study(study: str, label) -> list[tuple[str, dict]]:
    """[(name, error² x seconds by method)] of the cases of a study, each method with its best settings."""
    rows = json.loads((common.results(study, False) / f"{study}.json").read_text())["rows"]
    cases = {}
    for row in rows:
        name = label(row)
        if name is None:
            continue
        method = (row.get("method") or row["estimator"]).removeprefix("jaxdr, ")
        method = next(m for m in METHODS if method.startswith(m))
        case = cases.setdefault(name, {})
        case[method] = min(row["work"], case.get(method, row["work"]))
    return list(cases.items())


def of_charts() -> list[tuple[str, dict]]:
    """The same for the reference scenes, by depth. From the largest number of samples."""
    depths = {"direct_spot": 2, "shadow_goathead": 2, "environment_penguin": 2, "mirror_spot": 4, "cornell_indirect": 5}
    with open(common.results("charts", False) / "rows.csv") as file:
        rows = [row for row in csv.DictReader(file) if row["rmse"]]
    found = []
    for scene, depth in depths.items():
        case = {}
        for row in sorted(rows, key=lambda row: int(row["samples"])):
            if row["scene"] == scene and row["estimator"] in METHODS + BASELINES:
                case[row["estimator"]] = float(row["work"])
        found.append((f"depth {depth}: `{scene}`", case))
    return found


def cases() -> list[tuple[str, dict]]:
    """All rows of the table."""
    sizes = {0.125: "1/8", 1 / 3: "1/3"}

    def mirror(row):
        return f"a mirror of roughness {row['alpha']}" if row["scene"] == "ball" else None

    return [
        *of_study("soft_light", lambda row: f"a lamp x {sizes.get(row['light']) or int(row['light'])}, its shadow"),
        *of_study("roughness", mirror),
        *of_study("tessellation", lambda row: f"{row['triangles']:,} triangles, their shadow"),
        *of_charts(),
    ]


def table() -> str:
    """Markdown: the seconds to the same error, as multiples of the best method's."""
    lines = ["| scene | take | " + " | ".join(METHODS) + " |", "| --- |" + " --- |" * (len(METHODS) + 1)]
    for name, works in cases():
        best = min(works, key=works.__getitem__)
        lines.append(f"| {name} | {best} | {multiples(works, METHODS)} |")
    return "\n".join(lines)


def table_of_baselines() -> str:
    """The same for the methods that are there for comparison."""
    lines = ["| scene | " + " | ".join(BASELINES) + " |", "| --- |" + " --- |" * len(BASELINES)]
    lines += [f"| {name} | {multiples(works, BASELINES)} |" for name, works in of_charts()]
    return "\n".join(lines)


def multiples(works: dict, methods: list[str]) -> str:
    """The cells of a row."""
    cells = [f"{works[m] / min(works.values()):.2g}" if m in works else "" for m in methods]
    return " | ".join(f"{float(cell):.0f}" if "e" in cell else cell for cell in cells)


def main():
    common.parser(__doc__).parse_args()
    text = f"{table()}\n\n{table_of_baselines()}"
    (common.results("charts", False) / "difficulty.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
