"""The picture of a scene: error against seconds, both axes logarithmic."""

import importlib.util
import io
from collections.abc import Sequence

import numpy as np

from jaxdr.chart.statistics import error_of_mean, pareto_front

MARKERS = "osD^vP*X<>hpd8"
COLORS = (*(f"C{i}" for i in range(10)), "black", "navy", "lime", "gold")


def require_matplotlib() -> None:
    """Raises ImportError, which says what to install, if matplotlib is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        raise ImportError('charts need matplotlib, which is optional: pip install -e ".[experiments]"')


def chart_png(title: str, rows: Sequence[dict], prefix: str = "", until: float = 0.0) -> bytes | None:
    """PNG of the rows of a scene; None if no row has an error. `prefix` "vertex_" shows the gradients by vertices.

    Every estimator is a line. It goes on, dashed, up to `until` seconds, as the mean of more calls of its last point.
    The band is the noise of the reference; points in it are hollow. Dotted lines have slope -1/2, that is, the same
    error² · seconds. Points of the Pareto front have a ring.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    error, seconds = f"{prefix}rmse", f"{prefix}seconds"
    measured = [row for row in rows if error in row]
    if not measured:
        return None
    noise = measured[0][f"{prefix}noise"]
    figure = Figure(figsize=(8.6, 5.0))
    FigureCanvasAgg(figure)
    panel = figure.add_subplot()
    # Estimators that refused the scene are counted too, so that colours and markers are the same in all scenes.
    for i, name in enumerate(dict.fromkeys(row["estimator"] for row in rows)):
        mine = sorted((row for row in measured if row["estimator"] == name), key=lambda row: row["samples"])
        if not mine:
            continue
        x, y = [row[seconds] for row in mine], [row[error] for row in mine]
        compiled = [row.get(f"{prefix}compile_seconds") for row in mine]
        compiled = max((t for t in compiled if t is not None), default=None)
        label = name if compiled is None else f"{name} (compiles in {compiled:.1f} s)"
        color, marker = COLORS[i % len(COLORS)], MARKERS[i % len(MARKERS)]
        panel.loglog(x, y, "-", color=color, linewidth=1.2)
        panel.loglog(*_means(mine[-1], prefix, until), "--", color=color, linewidth=1.0)
        panel.loglog([], [], f"{marker}-", color=color, label=label)
        for row, a, b in zip(mine, x, y, strict=True):
            face = color if b > noise else "white"
            panel.loglog([a], [b], marker, color=color, markerfacecolor=face, markersize=6, zorder=3)
            panel.annotate(
                str(row["samples"]), (a, b), textcoords="offset points", xytext=(5, 4), fontsize=7, color=color
            )
    _front(panel, measured, error, seconds)
    ends = [_means(row, prefix, until) for row in measured]
    _guides(panel, np.concatenate([times for times, _ in ends]), np.concatenate([errors for _, errors in ends]))
    if noise > 0:
        low, high = panel.get_ylim()
        panel.axhspan(min(low, noise / 2), noise, color="0.88", zorder=0, label="noise of the reference")
        panel.set_ylim(min(low, noise / 2), max(high, noise * 1.2))
    what = "gradient by vertices" if prefix else "derivative image"
    panel.set(title=title, xlabel=f"seconds per {what} (median)", ylabel=f"RMSE of the {what} / size of the reference")
    panel.grid(True, which="major", alpha=0.3)
    panel.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    figure.tight_layout()
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=110)
    return png.getvalue()


def _front(panel, rows, error: str, seconds: str) -> None:
    points = [(row[seconds], row[error]) for row in rows]
    front = [points[i] for i in pareto_front(points)]
    x, y = zip(*front, strict=True)
    panel.step(x, y, where="post", color="0.35", linewidth=0.9, linestyle="--", zorder=1)
    panel.loglog(x, y, "o", color="0.2", markerfacecolor="none", markersize=12, label="Pareto front", linestyle="none")


def _means(row: dict, prefix: str, until: float) -> tuple[np.ndarray, np.ndarray]:
    """(seconds, errors) of the mean of 1 to `until` / seconds independent calls of a row."""
    seconds = row[f"{prefix}seconds"]
    times = np.geomspace(seconds, max(until, seconds), 32)
    bias2, variance = row[f"{prefix}bias2"], row[f"{prefix}deviation"] ** 2
    return times, np.array([error_of_mean(bias2, variance, time / seconds) for time in times])


def _guides(panel, seconds: np.ndarray, errors: np.ndarray) -> None:
    """Lines of slope -1/2 over the range of the points. Neighbours differ by a factor of two in the error."""
    x = np.array([min(seconds) / 1.5, max(seconds) * 1.5])
    works = errors * np.sqrt(seconds)
    low, high = np.floor(np.log2(works.min())), np.ceil(np.log2(works.max()))
    limits = (min(errors) / 1.6, max(errors) * 1.6)
    for power in np.arange(low, high + 1):
        panel.loglog(x, 2.0**power / np.sqrt(x), ":", color="0.7", linewidth=0.8, zorder=0)
    panel.loglog([], [], ":", color="0.7", label="slope −1/2")
    panel.set_xlim(*x)
    panel.set_ylim(*limits)
