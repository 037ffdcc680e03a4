"""Several runs of one config that differ in what `[[compare]]` says: results side by side, as curves and pictures."""

import csv
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxdr.atomic_file import atomic_path
from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.shapes import rectangle, transformed
from jaxdr.images import labelled_grid, save_png, to_srgb
from jaxdr.integrators import PathTracer
from jaxdr.optimize.config_checks import require
from jaxdr.render import render
from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.film import Box, Film
from jaxdr.scene.scene import Scene, Shape

KEY = "compare"
PICTURE = 112  # pixels, edge length of a picture of a mesh
SAMPLES = 64


class Variant(NamedTuple):
    """A run of a comparison: its `label`, its config as a TOML table, and the `folder` of its results."""

    label: str
    table: dict
    folder: Path


def is_comparison(table: dict) -> bool:
    """Whether a config asks for several runs."""
    return KEY in table


def variants(table: dict, path: Path) -> list[Variant]:
    """The runs that a config in `path` asks for. Tables in `[[compare]]` are merged into the config's, key by key.

    Raises ValueError that names file and key.
    """
    entries, output = table[KEY], table.get("output")
    rest = {key: value for key, value in table.items() if key != KEY}
    good = isinstance(entries, list) and bool(entries) and all(isinstance(entry, dict) for entry in entries)
    require(good, f"{path}: {KEY}", "expected tables [[compare]]", entries)
    require(
        isinstance(output, str) and bool(output.strip()),
        f"{path}: output",
        "must name the folder for the results",
        output,
    )
    found: list[Variant] = []
    for number, entry in enumerate(entries):
        place, label = f"{path}: {KEY}[{number}]", entry.get("label")
        require(isinstance(label, str), f"{place}.label", "expected a string", label)
        name = re.sub(r"[^A-Za-z0-9]+", "_", str(label)).strip("_").lower()
        known = [variant.folder.name for variant in found]
        good = bool(name) and name not in known
        require(good, f"{place}.label", "labels must have letters or digits, and differ in them", label)
        for key in ("output", KEY):
            require(key not in entry, f"{place}.{key}", "is the same for all: leave it out", entry.get(key))
        folder = Path(str(output)) / name
        changed = {key: value for key, value in entry.items() if key != "label"} | {"output": str(folder)}
        found.append(Variant(str(label), merged(rest, changed), folder))
    return found


def merged(table: dict, changes: dict) -> dict:
    """A table with changes; tables in it are merged key by key, all else is replaced."""
    both = {
        k: merged(table[k], v) for k, v in changes.items() if isinstance(v, dict) and isinstance(table.get(k), dict)
    }
    return table | changes | both


def compare(found: Sequence[Variant], run: Callable[[dict, bool], Any], resume: bool) -> list[dict]:
    """Run all variants one after another, write the comparison beside their folders, and return its rows.

    `run`: called with the table of a variant, and whether its run goes on. With `resume` finished runs are kept.
    """
    for variant in found:
        done, begun = (variant.folder / "metrics.json").exists(), (variant.folder / "config.json").exists()
        if not (resume and done):
            run(variant.table, resume and begun)
    rows = [row_of(variant) for variant in found]
    folder = found[0].folder.parent
    with atomic_path(folder / "comparison.csv") as temporary, temporary.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    with atomic_path(folder / "comparison.png") as temporary:
        _curves(found, temporary)
    if all((variant.folder / "meshes" / "result.glb").exists() for variant in found):
        save_png(folder / "meshes.png", _meshes(found))
    return rows


def row_of(variant: Variant) -> dict:
    """Label, the last value of every error, and the median of the seconds of a step."""
    steps = metrics(variant)
    seconds = np.diff([float(step["seconds"]) for step in steps])
    row: dict[str, Any] = {"label": variant.label, "steps": len(steps)}
    row |= {name: curve(steps, name)[1][-1] for name in errors(steps)}
    return row | {"seconds_a_step": round(float(np.median(seconds)), 3), "seconds": float(steps[-1]["seconds"])}


def metrics(variant: Variant) -> list[dict[str, str]]:
    """The rows of a run's `metrics.csv`."""
    with (variant.folder / "metrics.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def errors(steps: Sequence[dict[str, str]]) -> list[str]:
    """Columns that say how far a run is from its target: the Chamfer distance, or the errors of parameters."""
    other = ("iteration", "gradient_norm", "seconds", "vertices", "folded", "level", "signal_to_noise", "damping")
    names = [name for name in steps[0] if name not in other and any(step[name] for step in steps)]
    return [name for name in names if name != "loss"] or ["loss"]


def curve(steps: Sequence[dict[str, str]], name: str, against: str = "iteration") -> tuple[list[float], list[float]]:
    """The values of a column that are there, against another column."""
    shown = [step for step in steps if step[name]]
    return [float(step[against]) for step in shown], [float(step[name]) for step in shown]


def _curves(found: Sequence[Variant], path: Path) -> None:
    """Picture of the errors against steps and seconds, a row for each error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    runs = [metrics(variant) for variant in found]
    names = errors(runs[0])
    figure = Figure(figsize=(9.0, 0.6 + 3.2 * len(names)))
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(names), 2, squeeze=False)
    for panel_row, name in zip(panels, names, strict=True):
        for panel, (against, unit) in zip(panel_row, (("iteration", "step"), ("seconds", "seconds")), strict=True):
            for variant, steps in zip(found, runs, strict=True):
                panel.semilogy(*curve(steps, name, against), label=variant.label, linewidth=1.3)
            panel.set(xlabel=unit, ylabel="Chamfer distance" if name == "chamfer" else name)
            panel.grid(True, which="both", alpha=0.25)
    panels[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, format="png", dpi=100)


def _meshes(found: Sequence[Variant]) -> np.ndarray:
    """Pictures of the target and of every result in the same light, from two sides."""
    files = [found[0].folder / "meshes" / "target.glb", *(v.folder / "meshes" / "result.glb" for v in found)]
    lamp = transformed(rectangle(1.5, 1.5), look_at((1.5, -2.0, 3.0), (0, 0, 0), (0, 0, 1)))
    columns = []
    for file in files:
        shapes = {
            "object": Shape(load_mesh(str(file)), TwoSided(Diffuse(0.6))),
            "lamp": Shape(lamp, Diffuse(0.0), AreaEmitter(4.0)),
        }
        pictures = []
        for origin in ((0.6, -3.0, 0.9), (-0.9, 2.9, 0.9)):
            camera = Perspective(look_at(origin, (0, 0, 0), (0, 0, 1)), 24.0, Film(PICTURE, PICTURE, filter=Box()))
            scene = Scene(shapes, camera, ConstantEnvironment(0.35))
            image = render(scene, jax.random.key(0), spp=SAMPLES, integrator=PathTracer(2, boundary=None))
            pictures.append(to_srgb(np.asarray(image)))
        columns.append(pictures)
    titles = ["target", *(variant.label for variant in found)]
    return labelled_grid(titles, [list(row) for row in zip(*columns, strict=True)])
