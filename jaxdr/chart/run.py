"""Runs a chart, from its config to its page."""

import jax
import numpy as np

from jaxdr.chart.config import ChartConfig, Stored
from jaxdr.chart.default import line, times_as_long
from jaxdr.chart.figure import chart_png, require_matplotlib
from jaxdr.chart.folder import ChartFolder
from jaxdr.chart.machine import machine
from jaxdr.chart.page import Section, page, png_of
from jaxdr.chart.peers import require_mitsuba
from jaxdr.chart.pictures import images_picture, vertices_picture
from jaxdr.chart.reference import stored_reference
from jaxdr.chart.scene_run import SceneRun, mean_image
from jaxdr.chart.scenes import describe, load_case
from jaxdr.chart.table import COLUMNS, TERM_COLUMNS, csv_text, mark_front, megabytes, row_of, term_rows
from jaxdr.optimize.progress import Interruption, NotFinite, deferred_interrupt
from jaxdr.untrusted import json_text


def chart(config: ChartConfig, *, resume: bool = False, overwrite: bool = False) -> dict:
    """Measure everything that a config asks for, write it to `output`, and return the summary.

    With `resume`, what was measured before is not measured again, and gives the same rows.

    - Raises ValueError for a config that can't be run, or a folder in use.
    - Raises ImportError before the start, if matplotlib or Mitsuba is missing.
    - Raises `Interrupted` after Ctrl-C.
    - Raises `NotFinite` at once for a reference that is not finite, and at the end of the chart for such estimates.
    """
    require_matplotlib()
    if config.peers:
        require_mitsuba()
    cases = [load_case(s.name, s.file, s.procedural, s.options, s.motion) for s in config.scenes]
    for scene, case in zip(config.scenes, cases, strict=True):
        if isinstance(scene.reference, Stored):
            stored_reference(scene, case)  # a mistake shows before anything is written
    folder = ChartFolder(config)
    with folder.opened(resume, overwrite):
        rows, default = _measured(config, cases, folder)
        counts = {
            kind: sum(row["status"].startswith(kind) for row in rows) for kind in ("ok", "over", "refused", "not")
        }
        summary = {
            "rows": len(rows),
            "measured": counts["ok"] + counts["not"],
            "over_budget": counts["over"],
            "refused": counts["refused"],
            "not_finite": counts["not"],
            "default": default,
            "machine": machine(),
        }
        folder.write_text("summary.json", json_text(summary))
    if counts["not"]:
        bad = [f"{r['scene']}, {r['estimator']}, {r['samples']} spp" for r in rows if r["status"].startswith("not")]
        raise NotFinite(
            f"{folder.path}: the chart is complete, and has estimates that are not finite: {'; '.join(bad)}"
        )
    return summary


def _measured(config: ChartConfig, cases, folder: ChartFolder) -> tuple[list[dict], dict[str, str]]:
    """(the rows of all scenes, a line about the default by scene). All files are written anew after each scene."""
    rows, terms, sections, default = [], [], [], {}
    with deferred_interrupt() as interruption:
        for scene, case in zip(config.scenes, cases, strict=True):
            scene_rows, scene_terms, section = _scene(config, scene, case, folder, interruption)
            rows += scene_rows
            terms += scene_terms
            if (said := _about_default(config, scene_rows)) is not None:
                default[scene.name] = said
                section = section._replace(about=[*section.about, f"{said}."])
            sections.append(section)
            folder.write_text("rows.csv", csv_text(rows, COLUMNS))
            folder.write_text("terms.csv", csv_text(terms, TERM_COLUMNS))
            for suffix, png in zip(("", "_vertices"), section.charts, strict=False):
                folder.write_bytes(f"{scene.name}{suffix}.png", png)
            for suffix, pixels in section.pictures.items():
                folder.write_bytes(f"{scene.name}_{suffix}.png", png_of(pixels))
            folder.write_text("index.html", page("Speed against accuracy", _about(config), sections))
            jax.clear_caches()
    return rows, default


def _about_default(config: ChartConfig, rows: list[dict]) -> str | None:
    """How far the default is from the best of this library's estimators on a scene; None if it was not measured."""
    own = [estimator.name for estimator in config.estimators]
    names = [estimator.name for estimator in config.estimators if estimator.by_default]
    found = times_as_long([row for row in rows if row["estimator"] in own], names[0]) if names else {}
    return line(found) if found else None


def _scene(config: ChartConfig, scene, case, folder: ChartFolder, interruption: Interruption):
    """Rows, rows of terms, and the section of the page of one scene."""
    run = SceneRun(config, scene, case, folder, interruption)
    run.measure()
    rows, images, gradients = [], [], {}
    for cell in run.cells():
        name, status = run.lines[cell.line], folder.status(cell.file)
        row = {"scene": scene.name, "estimator": name, "samples": cell.samples, "status": status["status"]}
        if status["status"] == "ok":
            calls = folder.calls(cell, config.keys)
            row |= row_of(calls, len(run.positions), run.image, run.vertices)
            images.append((row, calls["image"][0], mean_image(calls["image"])))
            if run.vertices is not None and "vertices" in calls:
                gradients[name] = calls["vertices"][0]  # the line's largest number of samples is the last
        row |= {key: status.get(key) for key in ("compile_seconds", "vertex_compile_seconds")}
        row["program_mb"] = megabytes(status.get("program_bytes"))
        memory = folder.status(f"{scene.name}/{cell.line:02d}_memory")
        if memory is not None and memory["samples"] == cell.samples:
            row |= {"peak_mb": megabytes(memory["peak_bytes"]), "peak_has_compilation": memory["compilation"]}
        rows.append(row)
    mark_front(rows)
    terms = []
    if config.terms:
        for line, name in enumerate(run.lines[: len(config.estimators)]):
            cell = run.term_cell(line)
            if folder.has_call(cell, 0, "terms"):
                found = term_rows(folder.calls(cell, config.keys, "terms"), run.image)
                terms += [{"scene": scene.name, "estimator": name, "samples": config.terms} | row for row in found]
    charts = [chart_png(scene.name, rows, until=config.until)]
    if config.vertices is not None:
        charts.append(chart_png(f"{scene.name}, gradient by vertices", rows, "vertex_", config.until))
    charts = [png for png in charts if png is not None]
    shown, pictures = _images(run, images), {}
    if images:
        pictures["images"] = images_picture(run.image[0], _columns(images))
    if gradients and run.vertices is not None:
        vertices = np.asarray(case.rest, np.float64)
        pictures["vertices_map"] = vertices_picture(vertices, {"reference": run.vertices[0], **gradients})
    return rows, terms, Section(scene.name, _about_scene(run), charts, shown, rows, terms, pictures)


def _by_line(images: list) -> dict[str, list]:
    """The (row, one call, mean of all) of every line, with rising samples."""
    lines = dict.fromkeys(row["estimator"] for row, _, _ in images)
    return {name: [entry for entry in images if entry[0]["estimator"] == name] for name in lines}


def _equal_time(entries: list, seconds: float):
    """Of the entries of a line the one whose call takes closest to so many seconds."""
    return min(entries, key=lambda entry: abs(np.log(entry[0]["seconds"] / seconds)))


def _columns(images: list) -> dict[str, list[np.ndarray]]:
    """Of every line one call at equal samples, one at about equal time, and the mean of all calls of its last rung."""
    lines = _by_line(images)
    counts = [{row["samples"] for row, _, _ in entries} for entries in lines.values()]
    common = max(set.intersection(*counts), default=0)
    seconds = min(entries[-1][0]["seconds"] for entries in lines.values())
    columns = {}
    for name, entries in lines.items():
        same = [entry for entry in entries if entry[0]["samples"] == common] or entries[-1:]
        columns[name] = [same[0][1], _equal_time(entries, seconds)[1], entries[-1][2]]
    return columns


def _images(run: SceneRun, images: list) -> list[tuple[str, np.ndarray]]:
    """(caption, image): the reference, one call of every line, and the mean of all calls of every line's last rung.

    The single calls take about equally long.
    """
    shown = [("reference", run.image[0])]
    last = _by_line(images)
    equal = min((entries[-1][0]["seconds"] for entries in last.values()), default=0.0)
    for name, entries in last.items():
        row, one, _ = _equal_time(entries, equal)
        shown.append((f"{name}, one call: {row['samples']} spp, {row['seconds']:.2g} s", one.astype(np.float64)))
    for name, entries in last.items():
        row, _, mean = entries[-1]
        shown.append((f"{name}, mean of {row['calls']} calls, {row['samples']} spp", mean))
    return shown


def _about_scene(run: SceneRun) -> list[str]:
    scene, source = run.scene, run.scene.reference
    size = float(np.sqrt(np.mean(run.image[0] ** 2)))
    made = "stored" if isinstance(source, Stored) else f"central differences, {source.batches} x {source.samples} spp"
    lines = [
        f"Derivative by the motion of {describe(scene.motion)}; paths of up to {scene.max_depth} segments.",
        f"Reference: {made}, step {source.step:g}; its noise is {run.image[1] / size:.2g} of its size {size:.3g}.",
    ]
    if run.agreement is not None:
        a = run.agreement
        lines.append(
            f"Gradient by vertices: the reference is a long run of {run.config.vertices.reference}. Along the motion "
            f"it gives {a['from_vertices']:.4g}, the reference image {a['from_image']:.4g}: "
            f"the difference is {a['difference'] / a['error']:.1f} standard errors."
        )
    return lines


def _about(config: ChartConfig) -> list[str]:
    found = ", ".join(f"{key} {value}" for key, value in machine().items())
    lines = [
        f"Measured on: {found}. {config.keys} calls a point, all estimators in turns; times are medians of calls that "
        "build acceleration structures and guides, and do not compile.",
        "Errors are of one call, relative to the root mean square of the reference; hollow points lie in its noise.",
    ]
    if config.peers:
        lines.append("Mitsuba's times hold the update of its scene; its 'compile' is the extra time of a first call.")
    return lines
