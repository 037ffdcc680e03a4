"""OBJ files: polygons whose corners index positions, texture coordinates and normals separately.

Read here and not by trimesh, which takes relative indices, zeros and mixed faces for something else without a word.
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxdr.geometry.formats.triangles import Triangles, fans, split_vertices, table_of, unit
from jaxdr.untrusted import shortened

NAMES = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}  # in the order of a corner's indices
# Statements that say nothing about triangles: groups, points, lines, curves, how to render.
IGNORED = frozenset(
    "o g s mg p l vp mtllib maplib usemap lod bevel c_interp d_interp shadow_obj trace_obj cstype deg bmat step parm "
    "curv curv2 trim hole scrv sp con end ctech stech".split()
)
TAB, NEWLINE, SPACE, MINUS, SLASH, ZERO, NINE = b"\t\n -/09"
LONGEST = 18  # digits of an index: 64 bits hold it


class Rows(NamedTuple):
    """All statements of one kind: the numbers of their lines, and what they say behind the keyword."""

    lines: list[int]
    texts: list[str]


class ObjFile(NamedTuple):
    """What is in an OBJ file: its meshes, and the keywords that were not understood."""

    parts: list[Triangles]
    unread: list[str]


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, else Latin-1: only comments and names can have other characters than ASCII.

    Lines end with a line feed.
    """
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def material_files(path: Path, text: str) -> list[Path]:
    """The MTL files that an OBJ file with this text names. They may be missing."""
    return [path.parent / found.strip() for found in re.findall(r"^[ \t]*mtllib[ \t]+(.+)$", text, re.MULTILINE)]


def read_obj(text: str) -> ObjFile:
    """The polygons of a text as triangles, see `fans`.

    There is a mesh for each material, or several if only some of its faces have UVs or normals. The last material comes
    first, as it always did: folders of runs hold vertices in that order.

    Raises ValueError, with the line, for numbers and faces that can't be read, and for indices out of range.
    """
    rows, unread = _statements(text)
    vertices = table_of(rows["v"].texts, rows["v"].lines, "v", 3, 8)
    # The second number of a texture coordinate may be missing, and is zero then.
    uvs = table_of([f"{row} 0" for row in rows["vt"].texts], rows["vt"].lines, "vt", 2, 4)
    normals = unit(table_of(rows["vn"].texts, rows["vn"].lines, "vn", 3, 3))
    colored, colors = _colors(rows["v"])
    names = list(dict.fromkeys([None, *rows["usemtl"].texts]))
    parts = []
    for number, corners in _grouped(rows, names):
        faces, (v, vt, vn) = split_vertices(corners)
        parts.append(
            Triangles(
                *(vertices[v], faces),
                uvs[vt] if vt[0] >= 0 else None,
                normals[vn] if vn[0] >= 0 else None,
                stored={} if colors is None else {"vertex": dict(zip("rgb", colors[v].T, strict=True))},
                colored="vertices" if colored else None,
                material=names[number],
            )
        )
    return ObjFile(parts[::-1], unread)


def _statements(text: str) -> tuple[dict[str, Rows], list[str]]:
    """(statements by keyword, keywords of others that the format does not have)."""
    rows = {key: Rows([], []) for key in (*NAMES, "f", "usemtl")}
    add = {key: (found.lines.append, found.texts.append) for key, found in rows.items()}
    unread = {}
    for number, line in enumerate(_lines(text), 1):
        key, _, rest = line.partition(" ")
        if key not in add:  # blanks before it, or tabs behind it
            key, rest = [*line.split(None, 1), "", ""][:2]
        if key in add:
            if "#" in rest and key != "usemtl":
                rest = rest.partition("#")[0]
            add_line, add_text = add[key]
            add_line(number)
            add_text(rest.strip() if key == "usemtl" else rest)
        elif key and key[0] != "#" and key not in IGNORED:
            unread[key] = True
    return rows, list(unread)


def _lines(text: str) -> list[str]:
    """The lines. One that ends with a backslash goes on in the next; empty ones keep the numbers of those behind."""
    lines = text.split("\n")
    if "\\\n" not in text:
        return lines
    held: list[str] = []
    for number, line in enumerate(lines):
        goes_on = line.endswith("\\") and number < len(lines) - 1 and (held or not line.lstrip().startswith("#"))
        held.append(line[:-1] if goes_on else line)
        lines[number] = "" if goes_on else " ".join(held)
        if not goes_on:
            held = []
    return lines


def _colors(rows: Rows) -> tuple[bool, Float[np.ndarray, "V 3"] | None]:
    """(whether vertices have colours behind their positions, the colours if all have)."""
    widths = [len(row.split()) for row in rows.texts]
    if max(widths, default=0) < 6:
        return False, None
    if min(widths) < 6:
        return True, None
    return True, table_of(rows.texts, rows.lines, "v", 6, 8)[:, 3:]


def _grouped(rows: dict[str, Rows], names: list[str | None]) -> list[tuple[int, list[Int[np.ndarray, "F 3"]]]]:
    """(material, indices of the corners of its triangles in each table) for faces that can be one mesh.

    Such faces have one material, and all of them or none have UVs, or normals. Where there are none, indices are -1.
    """
    lines, texts = rows["f"]
    if not lines:
        return []
    corners, faces = _corners(rows["f"])
    counts = np.bincount(faces, minlength=len(lines))
    if counts.min() < 3:
        row = int(np.argmin(counts))
        raise ValueError(f"line {lines[row]}: a face needs at least three corners, got {shortened(texts[row])}")
    for place, key in enumerate(NAMES):
        corners[:, place] = _absolute(corners[:, place], faces, rows["f"].lines, rows[key].lines, NAMES[key])
    first = np.cumsum(counts) - counts
    has = corners >= 0
    mixed = np.any(has != has[first][faces], axis=1)
    if mixed.any():
        row = faces[np.argmax(mixed)]
        raise ValueError(
            f"line {lines[row]}: all corners of a face must have texture coordinates and normals, or none of them, got "
            f"{shortened(texts[row])}"
        )
    number = {name: row for row, name in enumerate(names)}
    in_turn = np.array([number[name] for name in (None, *rows["usemtl"].texts)])
    material = in_turn[np.searchsorted(rows["usemtl"].lines, lines)]
    places, polygon = fans(counts)
    group = (4 * material + has[first] @ (0, 2, 1))[polygon]
    order = np.argsort(group, kind="stable")
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    # Groups in the order of their first faces.
    return [
        (int(group[part[0]]) // 4, [column[places[part]] for column in corners.T])
        for part in sorted(np.split(order, starts[1:]), key=lambda part: part[0])
    ]


def _corners(rows: Rows) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """(the three numbers of every corner of all faces, zero where there is none; the row of each).

    Works on the bytes of all rows together: files have millions of corners. A corner has up to three fields with
    slashes between them, and ends with a blank.
    """
    data = np.frombuffer("\n".join([*rows.texts, ""]).encode("latin-1", "replace"), np.uint8)
    newlines = np.flatnonzero(data == NEWLINE)

    def told(place: int | np.integer) -> tuple[int, str]:
        row = int(np.searchsorted(newlines, place))
        return rows.lines[row], shortened(rows.texts[row])

    blank, slash, minus = (data == SPACE) | (data == TAB) | (data == NEWLINE), data == SLASH, data == MINUS
    digit = (data >= ZERO) & (data <= NINE)
    begins = np.append(True, (blank | slash)[:-1])
    bad = ~(blank | slash | digit | (minus & begins & np.append(digit[1:], False)))
    if bad.any():
        line, text = told(np.argmax(bad))
        raise ValueError(f"line {line}: a corner of a face must be whole numbers, as 1, 1/2, 1//3 or 1/2/3, got {text}")
    ends = np.flatnonzero(slash | (blank & ~np.append(True, blank[:-1])))  # of fields
    filled = ~(blank | slash)[ends - 1]
    last = ~slash[ends]  # of its corner
    corner = np.cumsum(last) - last
    starts = np.flatnonzero(np.append(True, last[:-1]))
    place = np.arange(len(ends)) - starts[corner] if len(ends) else np.zeros(0, int)
    wrong = (place > 2) | ((place == 0) & ~filled)
    wrong[filled] |= ends[filled] - np.flatnonzero((digit | minus) & begins) > LONGEST
    if wrong.any():
        line, text = told(ends[np.argmax(wrong)])
        raise ValueError(f"line {line}: a corner of a face must have one to three indices, got {text}")
    if not filled.any():  # NumPy makes a number of blanks alone
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    values = np.fromstring(bytes(np.where(slash, SPACE, data).astype(np.uint8)), np.int64, sep=" ")
    if (values == 0).any():
        line, text = told(ends[filled][np.argmax(values == 0)])
        raise ValueError(f"line {line}: indices start at 1, got {text}")
    table = np.zeros((int(last.sum()), 3), np.int64)
    table[corner[filled], place[filled]] = values
    return table, np.searchsorted(newlines, ends[last])


def _absolute(
    values: Int[np.ndarray, " n"], faces: Int[np.ndarray, " n"], lines: list[int], targets: list[int], name: str
) -> Int[np.ndarray, " n"]:
    """Indices from 0 on, and -1 for none. Negative ones count back from the last target before the face.

    `lines` are those of the faces, `targets` those of what is indexed.
    """
    before = np.searchsorted(targets, lines)[faces]
    rows = np.where(values < 0, before + values, values - 1)
    outside: Bool[np.ndarray, " n"] = (values != 0) & ((rows < 0) | (rows >= len(targets)))
    if outside.any():
        at = np.argmax(outside)
        there = before[at] if values[at] < 0 else len(targets)
        raise ValueError(f"line {lines[faces[at]]}: a face has the {name} {values[at]}, and there are {there}")
    return rows
