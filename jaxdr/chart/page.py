"""The page of a chart: charts, derivative images and tables in one HTML file that needs no other file."""

import base64
import html
import io
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.images import diverging
from jaxdr.web_page import content_policy

STYLE = """
body { font: 14px/1.45 sans-serif; max-width: 1100px; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; font-size: 12px; margin: 1em 0; display: block; overflow-x: auto }
th, td { padding: 2px 7px; border-bottom: 1px solid #ddd; text-align: right; white-space: nowrap }
th:first-child, td:first-child { text-align: left } tr.front td:first-child { font-weight: bold }
.images { display: flex; flex-wrap: wrap; gap: 10px } figure { margin: 0; width: 170px; font-size: 11px }
figure img { width: 160px; image-rendering: pixelated; border: 1px solid #ccc } .chart { max-width: 100% }
.note { color: #555 } .bad { color: #a00 }
"""
TABLE = {  # heading -> (key, format)
    "estimator": ("estimator", ""),
    "spp": ("samples", "d"),
    "seconds": ("seconds", ".3g"),
    "compile": ("compile_seconds", ".1f"),
    "RMSE": ("rmse", ".3f"),
    "deviation": ("deviation", ".3f"),
    "bias": ("bias", ".3f"),
    "bias seen from": ("bias_resolution", ".3f"),
    "projection": ("projection", ".3f"),
    "±": ("projection_error", ".3f"),
    "RMSE²·s": ("work", ".2e"),
    "peak MiB": ("peak_mb", ".0f"),
    "program MiB": ("program_mb", ".1f"),
    "vertices: seconds": ("vertex_seconds", ".3g"),
    "RMSE ": ("vertex_rmse", ".3f"),
    "deviation ": ("vertex_deviation", ".3f"),
    "bias ": ("vertex_bias", ".3f"),
}


class Section(NamedTuple):
    """What the page shows of a scene. `images` are pairs (caption, derivative image), and `charts` are PNGs.

    `pictures`: pixels of files beside the page, by the ends of their names.
    """

    title: str
    about: Sequence[str]
    charts: Sequence[bytes]
    images: Sequence[tuple[str, Float[np.ndarray, "H W 3"]]]
    rows: Sequence[dict]
    terms: Sequence[dict]
    pictures: dict[str, np.ndarray]


def page(title: str, about: Sequence[str], sections: Sequence[Section]) -> str:
    """The page as HTML. The colours of a scene's images end at the 99th percentile of its first image's values."""
    parts = [f"<!doctype html><meta charset='utf-8'>{content_policy()}<title>{html.escape(title)}</title>"]
    parts.append(f"<style>{STYLE}</style>")
    parts.append(f"<h1>{html.escape(title)}</h1>")
    parts += [f"<p class='note'>{html.escape(line)}</p>" for line in about]
    for section in sections:
        parts.append(f"<h2>{html.escape(section.title)}</h2>")
        parts += [f"<p class='note'>{html.escape(line)}</p>" for line in section.about]
        parts += [f"<img class='chart' alt='chart' src='{_embedded(png)}'>" for png in section.charts]
        parts.append(_images(section.images))
        columns = {h: c for h, c in TABLE.items() if any(row.get(c[0]) is not None for row in section.rows)}
        parts.append(_table([row for row in section.rows if "seconds" in row], columns))
        for row in section.rows:
            if row["status"] != "ok":
                said = f"{row['estimator']}, {row['samples']} spp: {row['status']}"
                parts.append(f"<p class='bad'>{html.escape(said)}</p>")
        if section.terms:
            parts.append(f"<h3>Terms, {section.terms[0]['samples']} spp</h3>")
            headings = {"estimator": ("estimator", ""), "term": ("term", ""), "deviation": ("deviation", ".3f")}
            parts.append(_table(section.terms, headings | {"size": ("size", ".3f")}))
    return "\n".join(parts) + "\n"


def _images(images: Sequence[tuple[str, np.ndarray]]) -> str:
    if not images:
        return ""
    limit = float(np.percentile(np.abs(images[0][1].mean(-1)), 99)) or 1.0
    shown = []
    for caption, image in images:
        if not np.isfinite(image).all():
            shown.append(f"<figure><figcaption class='bad'>{html.escape(caption)}: not finite</figcaption></figure>")
            continue
        picture = _embedded(png_of(diverging(image.mean(-1), limit)))
        shown.append(f"<figure><img alt='' src='{picture}'><figcaption>{html.escape(caption)}</figcaption></figure>")
    return f"<p class='note'>Blue to red: ±{limit:.3g}.</p><div class='images'>{''.join(shown)}</div>"


def _table(rows: Sequence[dict], columns: dict[str, tuple[str, str]]) -> str:
    lines = ["<table><tr>" + "".join(f"<th>{html.escape(name)}</th>" for name in columns) + "</tr>"]
    for row in rows:
        cells = ["" if row.get(key) is None else format(row[key], form) for key, form in columns.values()]
        kind = " class='front'" if row.get("pareto") else ""
        lines.append(f"<tr{kind}>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    return "\n".join([*lines, "</table>"])


def png_of(pixels: np.ndarray) -> bytes:
    """8-bit pixels as the bytes of a PNG."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="png")
    return stream.getvalue()


def _embedded(png: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
