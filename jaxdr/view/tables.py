"""Tables of a run for its page: columns of `metrics.csv` and rows of a chart as curves, numbers of a summary."""

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

STEPS = ("iteration", "step")


class Curve(NamedTuple):
    """A line of a diagram."""

    name: str
    x: list[float]
    y: list[float]


class Diagram(NamedTuple):
    """Curves that share their axes."""

    title: str
    x_label: str
    curves: list[Curve]
    logarithmic_x: bool = False


def metrics_diagrams(path: Path) -> list[Diagram]:
    """A diagram over the steps for each column whose numbers change."""
    rows = _rows(path)
    if not rows:
        return []
    steps = next((name for name in STEPS if name in rows[0]), None)
    diagrams = []
    for name in rows[0]:
        points = [(_number(row.get(steps)) if steps else float(i), _number(row[name])) for i, row in enumerate(rows)]
        x, y = _both(points)
        if name != steps and len(set(y)) > 1:
            diagrams.append(Diagram(name, steps or "row", [Curve(name, x, y)]))
    return diagrams


def chart_diagrams(path: Path) -> list[Diagram]:
    """A diagram of error against seconds for each scene of a chart, with a curve for each estimator."""
    scenes: dict[str, dict[str, list]] = {}
    for row in _rows(path):
        point = (_number(row.get("seconds")), _number(row.get("rmse")))
        if None not in point:
            scenes.setdefault(row["scene"] or "", {}).setdefault(row["estimator"] or "", []).append(point)
    return [
        Diagram(
            f"{scene}: rmse", "seconds", [Curve(name, *_both(sorted(found))) for name, found in lines.items()], True
        )
        for scene, lines in scenes.items()
    ]


def summary_rows(path: Path) -> list[tuple[str, str]]:
    """(name, value) of the numbers and texts of a summary. Long lists and deeper nesting are left out.

    Raises ValueError for a damaged file.
    """
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise ValueError(f"{path}: is damaged ({problem})") from None
    return list(_flat(summary)) if isinstance(summary, dict) else []


def _flat(table: dict, prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in table.items():
        if isinstance(value, dict) and not prefix:
            yield from _flat(value, f"{name}.")
        elif isinstance(value, list) and len(value) <= 4 and all(isinstance(v, int | float) for v in value):
            yield prefix + name, ", ".join(map(_text, value))
        elif isinstance(value, str | int | float):
            yield prefix + name, _text(value)


def _text(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _rows(path: Path) -> list[dict[str, str | None]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _number(text: str | None) -> float | None:
    """A finite number, or None. Cells may be empty, and the last line of a running optimisation may be incomplete."""
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _both(points: list) -> tuple[list[float], list[float]]:
    whole = [point for point in points if None not in point]
    return [x for x, _ in whole], [y for _, y in whole]
