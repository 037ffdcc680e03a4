"""What is in the bytes of a PLY file: elements with columns of numbers, and of lists. Text, or binary of both orders.

Read here and not by trimesh, which reads less than the header says without a word, and not all lists of two lengths.
"""

import re
import struct
import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxdr.untrusted import shortened

KINDS = {
    **{name: "i1" for name in ("char", "int8")},
    **{name: "u1" for name in ("uchar", "uint8")},
    **{name: "i2" for name in ("short", "int16")},
    **{name: "u2" for name in ("ushort", "uint16")},
    **{name: "i4" for name in ("int", "int32")},
    **{name: "u4" for name in ("uint", "uint32")},
    **{"int64": "i8", "uint64": "u8", "float16": "f2"},
    **{name: "f4" for name in ("float", "float32")},
    **{name: "f8" for name in ("double", "float64")},
}
LENGTHS = {name for name, kind in KINDS.items() if kind[0] in "iu"}  # what can count the numbers of a list
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


class Property(NamedTuple):
    """A number of every row, or a list of numbers: `count` is the type of its length."""

    name: str
    kind: np.dtype
    count: np.dtype | None


class Element(NamedTuple):
    """What the header says of an element: so many rows with these properties."""

    name: str
    rows: int
    properties: list[Property]


class Columns(NamedTuple):
    """The rows of an element by property. Lists are their lengths, and all their numbers in turn."""

    count: int
    scalars: dict[str, np.ndarray]
    lists: dict[str, tuple[Int[np.ndarray, " n"], np.ndarray]]


def read_elements(content: bytes) -> dict[str, Columns]:
    """The elements of a file by name. Raises ValueError for a damaged one, or one of another length than it says."""
    beginning = re.match(rb"ply[ \t]*(\r\n|\n|\r)", content)
    if beginning is None:
        raise ValueError("it does not start with the line ply")
    end = re.compile(rb"[\r\n]end_header[ \t]*(?:" + beginning[1] + rb"|\Z)").search(content)
    if end is None:
        raise ValueError("its header has no end_header")
    order, elements = _header(content[beginning.end() : end.start()].decode("latin-1"))
    if order == "=":
        return _of_text(content[end.end() :].decode("latin-1"), elements)
    return _of_bytes(content, end.end(), elements)


def _header(text: str) -> tuple[str, list[Element]]:
    """(order of bytes, elements)."""
    order, elements = None, []
    for number, line in enumerate(re.split("\r\n|\n|\r", text), 2):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, "1.0"] if name in ORDERS and order is None:
                order = ORDERS[name]
            case ["element", name, rows] if re.fullmatch(r"\d{1,18}", rows, re.ASCII):
                if any(name == other.name for other in elements):
                    raise ValueError(f"line {number}: there are two elements {shortened(name)}")
                elements.append(Element(name, int(rows), []))
            case ["property", kind, name] if kind in KINDS and elements and order:
                _add(elements[-1], Property(name, np.dtype(order + KINDS[kind]), None), number)
            case ["property", "list", length, kind, name] if kind in KINDS and length in LENGTHS and elements and order:
                _add(elements[-1], Property(name, *(np.dtype(order + KINDS[key]) for key in (kind, length))), number)
            case _:
                raise ValueError(f"line {number}: expected a statement of a PLY header, got {shortened(line)}")
    if order is None:
        raise ValueError("its header has no format")
    return order, elements


def _add(element: Element, found: Property, number: int) -> None:
    if any(found.name == other.name for other in element.properties):
        raise ValueError(f"line {number}: there are two properties {shortened(found.name)}")
    element.properties.append(found)


def _of_text(text: str, elements: list[Element]) -> dict[str, Columns]:
    lines = [line for line in re.split("\r\n|\n|\r", text) if line.strip()]
    promised = sum(element.rows for element in elements)
    if len(lines) != promised:
        raise ValueError(f"its header says {promised} rows, it has {len(lines)}")
    found, start = {}, 0
    for element in elements:
        found[element.name] = _text_columns(element, lines[start : start + element.rows])
        start += element.rows
    return found


def _text_columns(element: Element, rows: list[str]) -> Columns:
    """The numbers of every row are taken from left to right: one for a number, its length and more for a list."""
    found = Columns(len(rows), {}, {})
    widths = np.array([len(row.split()) for row in rows], np.int64)
    numbers = _flat(element.name, rows, widths)
    ends = np.cumsum(widths)
    at = ends - widths

    def check(good: np.ndarray, why: str) -> None:
        if not good.all():
            row = int(np.argmin(good))
            raise ValueError(f"{element.name} {row}: {why}, got {shortened(rows[row])}")

    def taken(places: np.ndarray, kind: np.dtype, row_of: np.ndarray) -> np.ndarray:
        values = numbers[places]
        if kind.kind in "iu":
            limits = np.iinfo(kind)
            good = (values >= float(limits.min)) & (values < limits.max + 1.0) & (np.floor(values) == values)
            check(np.bincount(row_of, ~good, len(rows)) == 0, f"needs whole numbers up to {limits.max}")
        with np.errstate(over="ignore", invalid="ignore"):  # infinity is found later
            return values.astype(kind)

    for name, kind, length in element.properties:
        each = np.arange(len(rows))
        lengths = np.ones(len(rows), np.int64)
        if length is not None:
            check(at < ends, f"its numbers end before {name}")
            counted = taken(at, length, each)
            check((counted >= 0) & (counted <= widths), f"has no {name} of such a length")
            lengths, at = counted.astype(np.int64), at + 1
        check(at + lengths <= ends, f"its numbers end before those of {name}")
        values = taken(_places(at, lengths), kind, np.repeat(each, lengths))
        if length is None:
            found.scalars[name] = values
        else:
            found.lists[name] = lengths, values
        at = at + lengths
    check(at == ends, "has more numbers than the header says")
    return found


def _flat(name: str, rows: list[str], widths: Int[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """All numbers of the rows in turn. A row has as many words as its width says."""

    def numbers(some: list[str]) -> np.ndarray | None:
        if any("\0" in row for row in some):  # NumPy takes it for the end
            return None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy warns of words that are no numbers
                return np.fromstring(" ".join(some), sep=" ")
        except (ValueError, DeprecationWarning):
            return None

    found = numbers(rows)
    # Where a word reads as two numbers, such as 1-2, there are more numbers than words.
    if found is None or len(found) != widths.sum():
        each = map(numbers, ([row] for row in rows))
        bad = next(k for k, one in enumerate(each) if one is None or len(one) != widths[k])
        raise ValueError(f"{name} {bad}: expected numbers, got {shortened(rows[bad])}")
    return found


def _of_bytes(content: bytes, at: int, elements: list[Element]) -> dict[str, Columns]:
    found = {}
    for element in elements:
        least = sum((kind if length is None else length).itemsize for _, kind, length in element.properties)
        if element.rows * max(least, 1) > len(content) - at:
            raise ValueError(
                f"its header says {element.rows} rows of {element.name}, which take at least "
                f"{element.rows * least} bytes; {len(content) - at} are left"
            )
        columns, size = _even(content, at, element) or _uneven(content, at, element)
        found[element.name] = columns
        at += size
    if at != len(content):
        raise ValueError(f"it has {len(content) - at} bytes more than its header says")
    return found


def _even(content: bytes, at: int, element: Element) -> tuple[Columns, int] | None:
    """(the rows from the byte `at` on, their bytes) if all rows have lists of the lengths of the first; else None."""
    fields, size, sizes = [], 0, {}
    for name, kind, length in element.properties:
        sizes[name] = 1
        if length is not None:
            start = at + size
            first = np.frombuffer(content[start : start + length.itemsize], length) if element.rows else [0]
            sizes[name] = int(first[0]) if len(first) else -1
            fields.append((f"length {name}", length))
            size += length.itemsize
        size += sizes[name] * kind.itemsize
        if sizes[name] < 0 or at + element.rows * size > len(content):
            return None
        fields.append((name, kind, (sizes[name],)))
    rows = np.frombuffer(content, np.dtype(fields), element.rows, at)
    columns = Columns(element.rows, {}, {})
    for name, kind, length in element.properties:
        values = rows[name].reshape(-1).astype(kind.newbyteorder("="))
        if length is None:
            columns.scalars[name] = values
        elif (rows[f"length {name}"] == sizes[name]).all():
            columns.lists[name] = np.full(element.rows, sizes[name], np.int64), values
        else:
            return None
    return columns, element.rows * size


def _uneven(content: bytes, at: int, element: Element) -> tuple[Columns, int]:
    """(the rows from the byte `at` on, their bytes), where lists have different lengths: a walk from row to row."""
    first = at
    counters = [
        length and struct.Struct(f"{length.str[0]}{length.char}".replace("|", "")) for *_, length in element.properties
    ]
    starts, lengths = ([[] for _ in counters] for _ in range(2))
    for row in range(element.rows):
        for k, (name, kind, _) in enumerate(element.properties):
            size, counter = 1, counters[k]
            if counter is not None and at + counter.size <= len(content):
                (size,) = counter.unpack_from(content, at)
                at += counter.size
            if size < 0 or at + size * kind.itemsize > len(content):
                raise ValueError(f"{element.name} {row}: {name} ends behind the end of the file, or has no length")
            starts[k].append(at)
            lengths[k].append(size)
            at += size * kind.itemsize
    data, columns = np.frombuffer(content, np.uint8), Columns(element.rows, {}, {})
    for k, (name, kind, length) in enumerate(element.properties):
        sizes = np.array(lengths[k], np.int64)
        places = _places(np.array(starts[k], np.int64), sizes, kind.itemsize)[:, None] + np.arange(kind.itemsize)
        values = data[places].reshape(-1).view(kind).astype(kind.newbyteorder("="))
        if length is None:
            columns.scalars[name] = values
        else:
            columns.lists[name] = sizes, values
    return columns, at - first


def _places(starts: Int[np.ndarray, " n"], lengths: Int[np.ndarray, " n"], step: int = 1) -> Int[np.ndarray, " m"]:
    """From each start, so many places as its length says, one step after the other."""
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    return np.repeat(starts, lengths) + step * within
