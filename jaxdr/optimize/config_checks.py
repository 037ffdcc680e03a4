"""What all configs check alike. Each message starts with the key, and says what was expected there."""

import dataclasses
import inspect
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any


def require(condition: bool, key: str, rule: str, value) -> None:
    """Raises ValueError that starts with the key unless the condition holds."""
    if not condition:
        raise ValueError(f"{key}: {rule}, got {value!r}")


def at_least(least: int, of: Any, *keys: str) -> None:
    """Raises ValueError for the first field of a dataclass that is less, of those in `keys`; of all without `keys`."""
    for key, value in _values(of, keys):
        require(value >= least, key, f"must be at least {least}", value)


def positive(of: Any, *keys: str) -> None:
    """Raises ValueError for the first field that is not positive, as `at_least` does; None is left alone."""
    for key, value in _values(of, keys):
        require(value is None or value > 0, key, "must be positive", value)


def not_negative(of: Any, *keys: str) -> None:
    """Raises ValueError for the first field that is negative, as `at_least` does; None is left alone."""
    for key, value in _values(of, keys):
        require(value is None or value >= 0, key, "must not be negative", value)


def check_run(config: Any) -> None:
    """Raises ValueError for a `seed` out of range, and without an `output` folder."""
    require(0 <= config.seed < 2**32, "seed", "must be between 0 and 2^32 - 1", config.seed)
    require(bool(config.output.strip()), "output", "must name the folder for the results", config.output)


def check_choice(key: str, value: str, known: Collection[str]) -> None:
    """Raises ValueError unless a name is one of those that are known."""
    if not isinstance(value, str) or value not in known:  # values of tables may be of any kind
        raise ValueError(f"{key}: expected one of {', '.join(known)}, got {value!r}")


def check_options(key: str, function: Callable, options: dict, name: str, kind: str = "option") -> None:
    """Raises ValueError for options that a function, known to users by its `name`, does not take."""
    known = inspect.signature(function).parameters
    for option in options:
        if option not in known:
            raise ValueError(f"{key}.{option}: {name} has no such {kind} (known: {', '.join(known)})")


def found_file(config: Path, key: str, name: str, kind: str = "a file") -> str:
    """Where a file is that a config names: beside the config, or relative to the current folder.

    Raises ValueError that names config, key and the places tried.
    """
    candidates = [config.parent / name, Path(name)]
    found = [candidate for candidate in candidates if candidate.is_file()]
    if not found:
        tried = " or ".join(dict.fromkeys(str(candidate) for candidate in candidates))
        raise ValueError(f"{config}: {key}: expected {kind}, found none at {tried}")
    return str(found[0])


def _values(of: Any, keys: tuple[str, ...]) -> list[tuple[str, Any]]:
    return [(key, getattr(of, key)) for key in keys or [field.name for field in dataclasses.fields(of)]]
