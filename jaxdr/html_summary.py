"""What notebooks show of an object: small tables in HTML. All words are escaped; nothing is loaded and nothing runs."""

import base64
import html
from collections.abc import Iterable, Sequence
from io import BytesIO

import numpy as np
from jaxtyping import UInt8
from PIL import Image

LEFT = ' style="text-align:left"'  # notebooks align cells to the right


def escaped(value: object) -> str:
    """The words of a value, as text of a page."""
    return html.escape(str(value))


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table of words; a row may have fewer cells than the head."""
    titles = "".join(f"<th{LEFT}>{escaped(title)}</th>" for title in head)
    lines = ("".join(f"<td{LEFT}>{escaped(cell)}</td>" for cell in row) for row in rows)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    return f"<table><thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table>"


def summary(title: str, *parts: str) -> str:
    """A bold title over parts that are HTML already."""
    return f"<div><b>{escaped(title)}</b>{''.join(parts)}</div>"


def folded(title: str, part: str) -> str:
    """A part that is HTML already, behind a title that opens it."""
    return f"<details><summary>{escaped(title)}</summary>{part}</details>"


def thumbnail(pixels: UInt8[np.ndarray, "H W 3"], words: str) -> str:
    """A small picture with words below; its pixels are in the HTML itself."""
    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    data = base64.b64encode(file.getvalue()).decode()
    style = "display:inline-block;margin:4px;text-align:center"
    picture = f'<img src="data:image/png;base64,{data}" alt="{escaped(words)}">'
    return f'<div style="{style}">{picture}<br>{escaped(words)}</div>'
