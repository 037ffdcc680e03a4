"""Elements of a Mitsuba 3 scene file, with their places, and the list of what is wrong with them."""

import contextlib
import dataclasses
import enum
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxdr.callers_line import warn


class SceneFileError(ValueError):
    """A scene file that can't be loaded; the message starts with file, line and tag."""


class Severity(enum.Enum):
    """A mistake is always an error; what is unsupported is one unless it may be left out; the harmless is a warning."""

    MISTAKE = 0
    UNSUPPORTED = 1
    HARMLESS = 2


@dataclasses.dataclass
class Problems:
    """What is wrong in a scene file, and what is not supported: collected, so that one error lists it all."""

    found: list[tuple[str, int, str, Severity]] = dataclasses.field(default_factory=list)

    def add(self, element: "Element", message: str, severity: Severity = Severity.MISTAKE) -> None:
        """Note a problem, once: an element may be read several times when others refer to it."""
        problem = (str(element.file), element.line, message, severity)
        if problem not in self.found:
            self.found.append(problem)

    def check(self, path: Path, ignore_unsupported: bool) -> None:
        """Raise one `SceneFileError` that lists all problems so far; warn of those that are none, and forget them."""
        # A stable sort: by line within a file, the main file first.
        ordered = sorted(self.found, key=lambda problem: (problem[0] != str(path), *problem[:2]))
        warned = {Severity.HARMLESS, Severity.UNSUPPORTED} if ignore_unsupported else {Severity.HARMLESS}
        for *_, message, severity in ordered:
            if severity in warned:
                warn(message)
        remaining = [message for *_, message, severity in ordered if severity not in warned]
        if len(remaining) == 1:
            raise SceneFileError(remaining[0])
        if remaining:
            raise SceneFileError("\n  ".join([f"{path} has {len(remaining)} problems:", *remaining]))
        self.found.clear()


@dataclasses.dataclass
class Element:
    """An XML element and where it stands. All elements of a scene share `problems`; `folders` are searched for files.

    `properties` is what read it last (an `xml.Properties`), so that nothing it left out goes unnoticed. `vertex_data`
    are the attributes of the mesh of the shape around it, by name: `vertex_…` one row a vertex (None where it can't be
    had), `face_…` one row a face; None outside of shapes. `referred`: some `<ref>` stands for it.
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
    referred: bool = False

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
        message = self.place(f"{message}; with ignore_unsupported {instead}")
        self.problems.add(self, message, Severity.UNSUPPORTED)

    def harmless(self, message: str) -> None:
        """Note something that is not read, and changes nothing in the expected image or next to nothing: a warning."""
        self.problems.add(self, self.place(message), Severity.HARMLESS)

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
        """The first file of this name in `folders` or the working directory; raises ValueError where there is none."""
        candidates = list(dict.fromkeys(folder / filename for folder in (*self.folders, Path.cwd())))
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise ValueError(f"there is no file {' or '.join(map(str, candidates))}")
