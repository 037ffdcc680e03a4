"""TOML files read into frozen dataclasses, strictly: every key must be known and have the right type."""

import dataclasses
import difflib
import tomllib
import types
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from jaxdr.untrusted import LARGEST, reason, shortened

Config = TypeVar("Config")


def read_toml(path: Path, overrides: Sequence[str] = ()) -> dict:
    """The tables of a TOML file with `a.b=c` overrides applied; values are TOML, or bare strings where they aren't.

    Raises ValueError for a missing or malformed file and for an override that isn't `key=value` or that runs through
    something that is not a table.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as problem:
        raise ValueError(f"{path}: can't be read ({problem.strerror}); expected a TOML file") from None
    except UnicodeDecodeError as problem:
        raise ValueError(f"{path}: is not valid TOML: {problem}") from None
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as problem:  # Python reads no whole number of more than 4,300 digits
        raise ValueError(f"{path}: is not valid TOML: {reason(problem)}") from None
    return override_table(table, overrides, str(path))


def override_table(table: dict, overrides: Sequence[str], source: str) -> dict:
    """The table, which came from `source`, with `a.b=c` overrides applied. Raises ValueError as `read_toml` does."""
    for override in overrides:
        key, value = split_assignment(override)
        *parents, last = key.split(".")
        inner = table
        for i, parent in enumerate(parents):
            inner = inner.setdefault(parent, {})
            if not isinstance(inner, dict):
                raise ValueError(f"--set {override}: {'.'.join(parents[: i + 1])} is not a table in {source}")
        inner[last] = value
    return table


def split_assignment(text: str) -> tuple[str, Any]:
    """Key and value of `key=value`. The value is read as TOML; what isn't TOML is a string.

    Raises ValueError when the key or the equals sign is missing.
    """
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not all(key.split(".")):
        raise ValueError(f"--set {text}: expected key=value")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (ValueError, RecursionError):
        return key, value
    return key, parsed["value"] if len(parsed) == 1 else value


def build(kind: type[Config], table: dict, source: str) -> Config:
    """A dataclass from a table.

    Fields may be numbers, strings, booleans, `Literal`s, tuples, dicts with free keys, other dataclasses, and unions of
    these. In a union of dataclasses the `Literal` field `kind` tells which one is meant. A ValueError from
    `__post_init__` gets its place in the file.

    Raises ValueError that names `source`, the key, and what was expected there.
    """
    return _convert(kind, table, source, "")


def _convert(kind: Any, value, source: str, key: str) -> Any:
    place = f"{source}: {key}" if key else source
    if dataclasses.is_dataclass(kind):
        return _convert_table(kind, value, source, key)
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        matching = [a for a in arguments if _looks_like(a, value)]
        kinds = [choice for a in arguments for choice in _kinds(a)]
        if isinstance(value, dict) and kinds and not matching:
            raise ValueError(
                f"{place}.kind: expected one of {', '.join(map(repr, kinds))}, got {value['kind']!r}"
                f"{_hint(value['kind'], kinds)}"
            )
        if not matching:
            raise ValueError(f"{place}: expected {_describe(kind)}, got {shortened(value)}")
        return _convert(matching[0], value, source, key)
    if not _looks_like(kind, value):
        raise ValueError(f"{place}: expected {_describe(kind)}, got {shortened(value)}{_hint(value, _choices(kind))}")
    if origin is tuple:
        kinds = [arguments[0]] * len(value) if arguments[-1] is ... else arguments
        return tuple(_convert(k, v, source, f"{key}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))
    if kind in (int, float):
        limit = LARGEST if kind is float else 2**63 - 1
        if not -limit <= value <= limit:
            raise ValueError(
                f"{place}: expected {_describe(kind)} from {-limit:g} to {limit:g}, got {shortened(value)}"
            )
    return float(value) if kind is float else value


def _convert_table(kind, value, source, key):
    place = f"{source}: {key}" if key else source
    if not isinstance(value, dict):
        raise ValueError(f"{place}: expected a table, got {shortened(value)}")
    types_of = typing.get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind)}
    prefix = f"{key}." if key else ""
    for name in value:
        if name not in fields:
            known = ", ".join(fields)
            raise ValueError(f"{source}: {prefix}{name}: unknown key{_hint(name, fields)} (known: {known})")
    for name, field in fields.items():
        optional = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
        if name not in value and not optional:
            raise ValueError(f"{source}: {prefix}{name}: missing; expected {_describe(types_of[name])}")
    converted = {n: _convert(types_of[n], v, source, f"{prefix}{n}") for n, v in value.items()}
    try:
        return kind(**converted)
    except ValueError as problem:
        raise ValueError(f"{source}: {prefix}{problem}") from None


def _looks_like(kind, value) -> bool:
    """Whether a TOML value has the outer form of a type; the parts are checked when they are converted."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) or kind is dict or origin is dict:
        return isinstance(value, dict) and ("kind" not in value or not _kinds(kind) or value["kind"] in _kinds(kind))
    if origin is typing.Literal:
        return value in arguments
    if origin is tuple:
        return isinstance(value, list) and (arguments[-1] is ... or len(value) == len(arguments))
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _kinds(kind) -> tuple:
    """What a dataclass allows as its `kind`: tells the tables of a union apart, the first is the default."""
    return _choices(typing.get_type_hints(kind).get("kind")) if dataclasses.is_dataclass(kind) else ()


def _describe(kind) -> str:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_describe(a) for a in arguments if a is not type(None))
    if origin is typing.Literal:
        return f"one of {', '.join(map(repr, arguments))}"
    if origin is tuple:
        count = "" if arguments[-1] is ... else f"{len(arguments)} "
        plural = {int: "integers", float: "numbers", str: "strings"}.get(arguments[0], "tables")
        return f"a list of {count}{plural}"
    names = {int: "an integer", float: "a number", str: "a string", bool: "true or false"}
    return names.get(kind, "a table")


def _choices(kind) -> tuple:
    return typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()


def _hint(value, choices) -> str:
    close = difflib.get_close_matches(value, choices, n=1) if isinstance(value, str) else []
    return f"; did you mean {close[0]!r}?" if close else ""
