"""STL files, text or binary: triangles without anything else."""

import re

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.formats.triangles import Triangles, check_numbers, table_of

HEADER = 84  # bytes before the triangles of a binary file: any text, then their number
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# A letter for each statement, so that one pattern says what a text looks like.
LETTERS = {"solid": "s", "facet": "f", "outer": "o", "vertex": "v", "endloop": "l", "endfacet": "x", "endsolid": "e"}
WHOLE = re.compile("(?:s(?:fovvvlx)*e)+")
TRIANGLE = "(?:f(?:o(?:v(?:v(?:v(?:l)?)?)?)?)?)?"  # as far as it goes
BEGINNING = re.compile(f"(?:s(?:fovvvlx)*e)*(?:s(?:fovvvlx)*{TRIANGLE})?")


def read_stl(content: bytes) -> list[Triangles]:
    """The triangles of a file. Raises ValueError for a damaged one."""
    promised = int.from_bytes(content[80:HEADER], "little")
    length = HEADER + promised * FACET.itemsize
    if len(content) >= HEADER and len(content) == length:
        corners = np.frombuffer(content, FACET, promised, HEADER)["corners"].reshape(-1, 3).astype(float)
        check_numbers("corners", corners)
    elif content[:80].lstrip()[:5].lower() == b"solid":
        corners = _text_corners(content.decode("latin-1"))
    else:
        raise ValueError(f"its header says {promised} triangles, which take {length} bytes; it has {len(content)}")
    return [Triangles(corners, np.arange(len(corners)).reshape(-1, 3))] if len(corners) else []


def _text_corners(text: str) -> Float[np.ndarray, "n 3"]:
    """The corners of the triangles, three each. Every solid must be whole."""
    letters, lines, rows, row_lines = [], [], [], []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        words = line.split(None, 1)
        if not words:
            continue
        letter = LETTERS.get(words[0]) or LETTERS.get(words[0].lower(), "?")
        letters.append(letter)
        lines.append(number)
        if letter == "v":
            rows.append(words[1] if len(words) > 1 else "")
            row_lines.append(number)
    structure = "".join(letters)
    if not WHOLE.fullmatch(structure):
        good = BEGINNING.match(structure)
        end = good.end() if good else 0
        place = f"line {lines[end]}" if end < len(lines) else "its end"
        raise ValueError(
            f"{place}: a solid is not whole; its triangles have three vertices, and endsolid is behind them"
        )
    return table_of(rows, row_lines, "a vertex", 3, 3)
