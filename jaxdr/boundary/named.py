"""Boundary estimators by name: those of this library, and classes in other files and modules."""

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxdr.boundary import ESTIMATORS

OUTSIDE = "FILE.py:CLASS or MODULE:CLASS"
METHODS = ("prepare", "draw", "image")
_PREFIX = "jaxdr_estimators_in_"  # of the names of modules that were read from files


def estimator_class(name: str, others: tuple[str, ...] = ()) -> Callable[..., Any]:
    """The class or function for an estimator's name: one of `ESTIMATORS`, "FILE.py:CLASS" or "MODULE:CLASS".

    Files are relative to the current folder. A file is read once, so that its classes stay the same. `others`: more
    names for the error message. Raises ValueError for unknown names, for what can't be imported, and for classes that
    are no `Term`.
    """
    if name in ESTIMATORS:
        return ESTIMATORS[name]
    place, colon, kind = name.rpartition(":")
    if not (colon and place and kind):
        raise ValueError(f"expected one of {', '.join((*ESTIMATORS, *others))}, got {name!r} (or {OUTSIDE})")
    found = getattr(_module(place, name), kind, None)
    if not isinstance(found, type):
        raise ValueError(f"{name}: there is no class {kind} in {place}")
    missing = [method for method in METHODS if not callable(getattr(found, method, None))]
    if missing:
        raise ValueError(f"{name}: {kind} is no jaxdr.Term: it has no {', '.join(missing)}")
    return found


def estimator_name(kind: type) -> str:
    """The name by which `estimator_class` finds a class. Raises ValueError for one that it does not find."""
    module = kind.__module__
    name = kind.__name__ if ESTIMATORS.get(kind.__name__) is kind else f"{module}:{kind.__qualname__}"
    if module.startswith(_PREFIX):
        file = Path(str(sys.modules[module].__file__))
        here = Path.cwd()
        name = f"{file.relative_to(here) if file.is_relative_to(here) else file}:{kind.__qualname__}"
    try:
        if estimator_class(name) is kind:
            return name
    except ValueError:
        pass
    known = ", ".join(ESTIMATORS)
    raise ValueError(f"no name finds the boundary estimator {kind.__name__}: it is none of {known}, nor {OUTSIDE}")


def _module(place: str, name: str) -> ModuleType:
    try:
        return _file(Path(place).resolve()) if place.endswith(".py") else importlib.import_module(place)
    except Exception as problem:  # other people's code may raise anything
        raise ValueError(f"{name}: can't import {place} ({type(problem).__name__}: {problem})") from problem


def _file(path: Path) -> ModuleType:
    """The module in a file, read once."""
    name = _PREFIX + "".join(c if c.isalnum() else f"_{ord(c):x}_" for c in os.fspath(path))
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # there for every name that ends with .py
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # before it runs, because dataclasses look there
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
