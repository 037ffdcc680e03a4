"""Elements of a Mitsuba 3 scene file, with their places, and the list of what is wrong with them."""

import contextlib
import dataclasses
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any


class SceneFileError(ValueError):
    """A scene file that can't be loaded; the message starts with file, line and tag."""


@dataclasses.dataclass
class Problems:
    """What is wrong in a scene file, and what is not supported: collected, so that one error lists it all."""

    found: list[tuple[str, int, str, bool]] = dataclasses.field(default_factory=list)

    def add(self, element: "Element", message: str, ignorable: bool = False) -> None:
        """Note a problem, once: an element may be read several times when others refer to it."""
        problem = (str(element.file), element.line, message, ignorable)
        if problem not in self.found:
            self.found.append(problem)

    def check(self, path: Path, ignore_unsupported: bool) -> None:
        """Raise one `SceneFileError` that lists all problems; what is only unsupported may become warnings instead."""
        # A stable sort: by line within a file, the main file first.
        ordered = sorted(self.found, key=lambda problem: (problem[0] != str(path), *problem[:2]))
        if ignore_unsupported:
            for *_, message, ignorable in ordered:
                if ignorable:
                    warnings.warn(message, stacklevel=3)
        remaining = [message for *_, message, ignorable in ordered if not (ignorable and ignore_unsupported)]
        if len(remaining) == 1:
            raise SceneFileError(remaining[0])
        if remaining:
            raise SceneFileError("\n  ".join([f"{path} has {len(remaining)} problems:", *remaining]))


@dataclasses.dataclass
class Element:
    """An XML element and where it stands. All elements of a scene share `problems`; `folders` are searched for files.

    `properties` is what read it last (a `mitsuba_xml.Properties`), so that nothing it left out goes unnoticed.
    `vertex_data` is what the mesh of the shape around it stores at its vertices, by name; None outside of shapes.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list["Element"] = dataclasses.field(default_factory=list)
    problems: Problems = dataclasses.field(default_factory=Problems)
    folders: list[Path] = dataclasses.field(default_factory=list)
    properties: Any = None
    vertex_data: dict[str, Any] | None = None

    @property
    def type(self) -> str:
        """The plugin type; the outermost element has none and counts as `scene`."""
        return self.attributes.get("type", "scene")

    def place(self, message: str) -> str:
        """The message after file, line and tag."""
        return f"{self.file}, line {self.line}, <{self.tag}>: {message}"

    def error(self, message: str) -> SceneFileError:
        """The error to raise for this element."""
        return SceneFileError(self.place(message))

    def unsupported(self, message: str, instead: str) -> None:
        """Note something that has no counterpart here, and what happens `instead` when the user ignores that."""
        self.problems.add(self, self.place(f"{message}; with ignore_unsupported {instead}"), ignorable=True)

    def check_attributes(self, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()) -> None:
        """Raise unless all required attributes and no unknown ones are there."""
        for name in self.attributes:
            if name not in required + optional:
                raise self.error(f"unknown attribute {name!r}; known: {', '.join(required + optional) or 'none'}")
        for name in required:
            if name not in self.attributes:
                raise self.error(f"attribute {name!r} is missing")

    @contextlib.contextmanager
    def located(self) -> Iterator[None]:
        """Give a `ValueError` raised inside this element's place, unless it names a place already."""
        try:
            yield
        except SceneFileError:
            raise
        except ValueError as error:
            raise self.error(str(error)) from error

    def find_file(self, filename: str) -> Path:
        """The first file of this name in `folders`; raises ValueError where there is none."""
        candidates = [folder / filename for folder in dict.fromkeys(self.folders)]
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise ValueError(f"there is no file {' or '.join(map(str, candidates))}")
