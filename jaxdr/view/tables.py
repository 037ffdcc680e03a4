"""Tables of a run for its page: columns of `metrics.csv` and rows of a chart as curves, numbers of a summary."""

import contextlib
import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from jaxdr.untrusted import damage, read_json, shortened, text_of

STEPS = ("iteration", "step")
CHART = ("scene", "estimator", "seconds", "rmse")
SCORES = {"psnr": "{:.2f} dB", "psnr_inside": "{:.2f} dB inside", "ssim": "SSIM {:.4f}", "iou": "overlap {:.4f}"}
LARGEST = 1e300  # of a number in a diagram: differences of two are finite


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
    """A diagram over the steps for each column whose numbers change. Raises ValueError for a damaged file."""
    table = _table(path)
    steps = next((name for name in STEPS if name in table), None)
    diagrams = []
    for name, cells in table.items():
        y = [_number(cell) for cell in cells]
        x = [_number(cell) for cell in table[steps]] if steps else list(map(float, range(len(cells))))
        curve = Curve(name, *_both(zip(x, y, strict=True)))
        if name != steps and len(set(curve.y)) > 1:
            diagrams.append(Diagram(f"{name}{_not_shown(cells)}", steps or "row", [curve]))
    return diagrams


def chart_diagrams(path: Path) -> list[Diagram]:
    """A diagram of error against seconds for each scene of a chart, with a curve for each estimator.

    Raises ValueError for a damaged file, and for one without the columns of a chart.
    """
    table = _table(path)
    missing = [name for name in CHART if table and name not in table]
    if missing:
        raise ValueError(f"{path}: has no column {missing[0]!r}; it is not the table of a chart")
    scenes: dict[str, dict[str, list]] = {}
    for scene, estimator, *cells in zip(*(table.get(name, []) for name in CHART), strict=True):
        point = tuple(map(_number, cells))
        if None not in point:
            scenes.setdefault(scene, {}).setdefault(estimator, []).append(point)
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
    summary = read_json(path)
    if not isinstance(summary, dict):
        raise ValueError(f"{path}: expected numbers by name, got {shortened(summary)}")
    return list(_flat(summary))


def view_scores(path: Path) -> dict[str, list[str]]:
    """Scores of each view of a reconstruction, in words, by its name. Raises ValueError for a damaged file."""
    summary = read_json(path)
    views = summary.get("views") if isinstance(summary, dict) else None
    found = {}
    for view in views if isinstance(views, list) else []:
        if isinstance(view, dict) and isinstance(view.get("name"), str):
            numbers = ((words, view.get(key)) for key, words in SCORES.items())
            found[view["name"]] = [words.format(x) for words, x in numbers if isinstance(x, int | float)]
    return found


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


def _table(path: Path) -> dict[str, list[str]]:
    """The cells of a table by column. The last line of a running optimisation may be incomplete: it is left out.

    Raises ValueError, with the line, for other lines that have another number of cells than the header, and for two
    columns of one name.
    """
    reader = csv.reader(io.StringIO(text_of(path), newline=""), strict=True)
    rows = []
    with damage(f"{path}: is no table of comma-separated values"):
        rows += [(reader.line_num, row) for row in reader if row]
    if not rows:
        return {}
    (_, header), *rows = rows
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise ValueError(f"{path}: has two columns called {shortened(twice)}; rename one")
    if rows and len(rows[-1][1]) < len(header):
        rows.pop()
    for line, row in rows:
        if len(row) != len(header):
            raise ValueError(f"{path}: line {line}: has {len(row)} cells, the header has {len(header)}; mend the line")
    columns = zip(*(row for _, row in rows), strict=True) if rows else ([] for _ in header)
    return {name: list(cells) for name, cells in zip(header, columns, strict=True)}


def _number(text: str) -> float | None:
    """A number that a diagram can show, or None. Cells may be empty."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST else None


def _not_shown(cells: list[str]) -> str:
    """What a title says of numbers that a diagram can't show."""
    count = 0
    for cell in cells:
        with contextlib.suppress(ValueError):
            count += not abs(float(cell)) <= LARGEST
    return f" ({count} not finite or too large)" if count else ""


def _both(points: Iterable) -> tuple[list[float], list[float]]:
    whole = [point for point in points if None not in point]
    return [x for x, _ in whole], [y for _, y in whole]
