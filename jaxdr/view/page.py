"""The page of a folder of results: pictures, meshes, curves and tables in one HTML file that needs no other file."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from jaxdr.images import load_image, to_srgb
from jaxdr.untrusted import damage, opened_picture, text_of
from jaxdr.view.curves import svg
from jaxdr.view.folder import Item, Results, by_name, spread
from jaxdr.view.models import glb_bytes
from jaxdr.view.tables import chart_diagrams, metrics_diagrams, summary_rows, view_scores
from jaxdr.web_page import content_policy

HERE = Path(__file__).parent
GENERATOR = '<meta name="generator" content="jaxdr view">'
Z_UP, Y_UP = "0deg -90deg 0deg", "0deg 0deg 0deg"  # roll, pitch, yaw: glTF has y up
FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".gif": "GIF"}  # that browsers show, in Pillow's words
GRIDS = {"reconstruction": "Photograph and rendering of a step"}
MOST = 12  # pictures of a kind
TITLES = {
    "optimisation": "Shape from images",
    "recovery": "Parameters from images",
    "reconstruction": "Reconstruction from photographs",
    "chart": "Error of derivatives against time",
}


def page(results: Results) -> str:
    """The page as HTML. Raises ValueError for a mesh, a picture or a table that can't be read."""
    title = html.escape(f"{results.path.resolve().name}: {TITLES[results.kind]}")
    state = "" if results.finished else " The run is not finished."
    viewers = _meshes(results)
    head = [
        "<!doctype html>",
        f'<html lang="en"><head><meta charset="utf-8">{GENERATOR}',
        content_policy(viewer=bool(viewers)),
        f"<title>{title}</title><style>{_own('page.css')}</style></head><body>",
        f"<h1>{title}</h1><p class='note'>{html.escape(str(results.path))}.{state}</p>",
        *_left_out(results),
    ]
    shown = [*_compared(results), *_pictures(results), *_diagrams(results), *_summary(results), *_config(results)]
    parts = [*head, *viewers, *shown]
    if viewers:
        parts.append(f"<details><summary>Licences of the viewer</summary><pre>{_licences()}</pre></details>")
        parts.append(f'<script type="module">{_own("viewer/model-viewer.min.js")}</script>')
        parts.append(f'<script type="module">{_own("page.js")}</script>')
    return "\n".join([*parts, "</body></html>", ""])


def _left_out(results: Results) -> list[str]:
    """What says that links are not shown."""
    if not results.left_out:
        return []
    names = [str(path.relative_to(results.path)) for path in results.left_out]
    more = f" and {len(names) - MOST} more" if len(names) > MOST else ""
    said = f"Left out, because they are links or no regular files: {', '.join(names[:MOST])}{more}."
    return [f"<p class='note'>{html.escape(said)}</p>"]


def _meshes(results: Results) -> list[str]:
    """The viewers of meshes: targets, first and last states, and results."""
    shown = [("", item) for item in results.meshes if item.step is None]
    # Targets come first, results last.
    before = [(name, item) for name, item in shown if item.name == "target"]
    behind = [(name, item) for name, item in shown if item.name != "target"]
    states = []
    for items in by_name(results.meshes).values():
        has_result = any(item.name == "result" for _, item in behind)
        ends = items[:1] if has_result else dict.fromkeys((items[0], items[-1]))
        states += [(_state(item, items, results.finished), item) for item in ends]
    viewers = [_viewer(label or item.name, item) for label, item in [*before, *states, *behind]]
    if not viewers:
        return []
    lines = ["<h2>Meshes</h2>", '<p class="note">Drag to turn all of them, scroll to zoom. ']
    lines.append('<label><input type="checkbox" id="y-up"> y is up</label></p>')
    return [*lines, f'<div class="row">{"".join(viewers)}</div>']


def _viewer(label: str, item: Item) -> str:
    source = _data("model/gltf-binary", glb_bytes(item.path))
    up = Y_UP if item.name == "asset" else Z_UP  # an asset stands upright in glTF
    return (
        f'<figure><model-viewer src="{source}" alt="{html.escape(label)}" orientation="{up}" data-up="{up}" '
        'camera-controls interaction-prompt="none" loading="eager" environment-image="legacy" exposure="0.8">'
        f"</model-viewer><figcaption>{html.escape(label)}</figcaption></figure>"
    )


def _state(item: Item, items: Sequence[Item], finished: bool) -> str:
    """The caption of a step of a run."""
    name = f"{item.name}, " if item.name else ""
    if item.step == 0:
        return f"{name}start"
    return f"{name}{'result, ' if finished and item is items[-1] else ''}step {item.step}"


def _compared(results: Results) -> list[str]:
    """Photographs beside renderings and their differences, with their scores."""
    if not results.compared:
        return []
    scores = view_scores(results.summary) if results.summary else {}
    kind = results.summary and dict(summary_rows(results.summary)).get("judged_by")
    some = "" if len(scores) <= len(results.compared) else f" {len(results.compared)} of {len(scores)} are shown."
    views = f"Views that were {kind}: photograph" if kind else "Photograph"
    note = f"{views}, rendering, difference. Red is too bright, blue too dark.{some}"
    captions = [(" · ".join((item.name, *scores.get(item.name, ()))), item) for item in results.compared]
    return [f"<h2>Photographs and renderings</h2><p class='note'>{html.escape(note)}</p>", _figures("wide", captions)]


def _pictures(results: Results) -> list[str]:
    parts = []
    groups = by_name(results.pictures)
    for name, items in groups.items():
        heading = name or GRIDS.get(results.kind, "Target, current image and their difference")
        first, *between = spread(items, MOST)
        last = [between.pop()] if between else []
        parts.append(f"<h2>{html.escape(heading)}</h2>")
        parts.append(_figures("large", [(_state(item, items, results.finished), item) for item in (first, *last)]))
        if between:
            parts.append("<h3>On the way</h3>")
            parts.append(_figures("small", [(_state(item, items, False), item) for item in between]))
    others = [item for item in results.pictures if item.step is None]
    held_out = () if results.compared else results.held_out
    size = "large" if results.kind == "chart" else "small"
    for heading, items in (("Pictures", others), ("Held-out views", held_out)):
        if items:
            parts.append(f"<h2>{heading}</h2>")
            parts.append(_figures(size, [(item.path.name, item) for item in spread(items, MOST)]))
    return parts


def _figures(size: str, pictures: Sequence[tuple[str, Item]]) -> str:
    figures = [
        f'<figure><img alt="{html.escape(caption)}" src="{_picture(item.path)}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        for caption, item in pictures
    ]
    return f'<div class="row {size}">{"".join(figures)}</div>'


def _picture(path: Path) -> str:
    """The file itself if a browser can show it. Linear values are scaled so that their 99th percentile is white."""
    kind = FORMATS.get(path.suffix.lower())
    if kind is not None:
        content = path.read_bytes()
        # A file of another kind may be private: its name says that it is a picture.
        with damage(f"{path}: can't be shown"), opened_picture(io.BytesIO(content), (kind,)) as image:
            image.load()
        return _data(f"image/{kind.lower()}", content)
    values = np.nan_to_num(np.asarray(load_image(path), float)[..., :3], posinf=1e38, neginf=-1e38)
    white = max(float(np.percentile(values, 99)), 1e-12)
    stream = io.BytesIO()
    Image.fromarray(to_srgb(np.broadcast_to(values / white, (*values.shape[:2], 3)))).save(stream, format="png")
    return _data("image/png", stream.getvalue())


def _diagrams(results: Results) -> list[str]:
    found = metrics_diagrams(results.metrics) if results.metrics else []
    found += chart_diagrams(results.rows) if results.rows else []
    return ["<h2>Curves</h2>", f'<div class="row">{"".join(map(svg, found))}</div>'] if found else []


def _summary(results: Results) -> list[str]:
    rows = summary_rows(results.summary) if results.summary else []
    if not rows:
        return []
    lines = [f"<tr><td>{html.escape(name)}</td><td>{html.escape(value)}</td></tr>" for name, value in rows]
    return ["<h2>Numbers</h2>", f"<table>{''.join(lines)}</table>"]


def _config(results: Results) -> list[str]:
    text = text_of(results.config)
    return [f"<details><summary>{results.config.name}</summary><pre>{html.escape(text)}</pre></details>"]


def _own(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def _licences() -> str:
    return html.escape(_own("viewer/LICENSES.txt"))


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
