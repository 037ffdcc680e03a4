"""Rows of a chart, made from the calls in its folder, and CSV files of them."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from jaxdr.chart.statistics import errors, is_resolved, mean_and_noise, pareto_front, size2

ERRORS = ("rmse", "bias", "bias2", "bias_resolution", "deviation", "projection", "projection_error", "noise")
COLUMNS = (
    *("scene", "estimator", "samples", "status", "calls", "seconds", "seconds_low", "seconds_high"),
    *("compile_seconds", "program_mb", "peak_mb", "peak_has_compilation", *ERRORS, "work", "resolved", "pareto"),
    *("vertex_seconds", "vertex_compile_seconds", *(f"vertex_{name}" for name in ERRORS)),
)
TERM_COLUMNS = ("scene", "estimator", "samples", "term", "deviation", "size")
FRACTION = 1 / (1 << 20)


def row_of(
    calls: dict[str, np.ndarray],
    positions: int,
    image: tuple[np.ndarray, float],
    vertices: tuple[np.ndarray, float] | None,
) -> dict:
    """Errors and times from the calls of a cell. Call k is at position k modulo `positions`.

    `image` and `vertices` are references with their noise. If values are not finite, the errors are left out, and
    `status` says how many calls have such values.
    """
    row: dict = {"calls": len(calls["image"])}
    low, middle, high = np.percentile(calls["seconds"], (25, 50, 75))
    row |= {"seconds": float(middle), "seconds_low": float(low), "seconds_high": float(high)}
    status = []
    bad = _not_finite(calls["image"])
    if bad:
        status.append(f"not finite: {bad} of {len(calls['image'])} images")
    else:
        row |= errors(_by_position(calls["image"], positions), *image)
        row |= {"work": row["rmse"] ** 2 * row["seconds"], "resolved": is_resolved(row["rmse"], row["noise"])}
    if vertices is not None and "vertices" in calls:
        row["vertex_seconds"] = float(np.median(calls["vertex_seconds"]))
        bad = _not_finite(calls["vertices"])
        if bad:
            status.append(f"not finite: {bad} of {len(calls['vertices'])} gradients by vertices")
        else:
            found = errors(calls["vertices"][None], *vertices)
            row |= {f"vertex_{name}": value for name, value in found.items()}
    return row | {"status": "; ".join(status) or "ok"}


def mark_front(rows: Sequence[dict]) -> None:
    """Set `pareto` in the rows of a scene that have an error."""
    measured = [row for row in rows if "rmse" in row]
    front = {id(measured[i]) for i in pareto_front([(row["seconds"], row["rmse"]) for row in measured])}
    for row in measured:
        row["pareto"] = id(row) in front


def term_rows(calls: dict[str, np.ndarray], image: tuple[np.ndarray, float]) -> list[dict]:
    """For each term its standard deviation in a call, and the size of its mean without noise.

    Both are relative to the reference.
    """
    power = size2(*image)
    rows = []
    for term, values in sorted(calls.items()):
        if _not_finite(values):
            rows.append({"term": term})
            continue
        mean, noise = mean_and_noise(values)
        variance = float(values.astype(np.float64).var(0, ddof=1).mean())
        size = max(float(np.mean(mean**2)) - noise**2, 0.0)
        rows.append({"term": term, "deviation": (variance / power) ** 0.5, "size": (size / power) ** 0.5})
    return rows


def csv_text(rows: Sequence[dict], columns: Sequence[str]) -> str:
    """The rows as CSV. A value that a row lacks is left empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: _cell(value) for key, value in row.items()})
    return text.getvalue()


def megabytes(size: int | None) -> float | None:
    """Bytes in units of 2^20."""
    return None if size is None else size * FRACTION


def _by_position(values: np.ndarray, positions: int) -> np.ndarray:
    """[calls, ...] -> [positions, calls a position, ...]."""
    return np.stack([values[i::positions] for i in range(positions)])


def _not_finite(values: np.ndarray) -> int:
    return int((~np.isfinite(values).reshape(len(values), -1).all(1)).sum())


def _cell(value) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
