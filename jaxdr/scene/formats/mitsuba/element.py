"""Elements of a Mitsuba 3 scene file, with their places in the file, and the list of their problems."""

import contextlib
import dataclasses
import enum
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from jaxdr.callers_line import warn
from jaxdr.untrusted import reason, shortened

MOST_PROBLEMS = 1000  # that are listed
LONGEST_PATH = 4096  # of Linux


class SceneFileError(ValueError):
    """A scene file can't be loaded. The message starts with file, line and tag."""


class Severity(enum.Enum):
    """Mistakes are errors, harmless things are warnings. Unsupported things are errors, or warnings if asked for."""

    MISTAKE = 0
    UNSUPPORTED = 1
    HARMLESS = 2


Problem = tuple[str, int, str, Severity]  # file, line, message, severity


@dataclasses.dataclass
class Problems:
    """The mistakes in a scene file, and what is not supported. They are collected, so that one error lists them all.

    Of each severity the list has `MOST_PROBLEMS` at most. The others are counted.
    """

    found: dict[Problem, None] = dataclasses.field(default_factory=dict)  # in the order in which they were found
    told: set[Problem] = dataclasses.field(default_factory=set)
    count: Counter[Severity] = dataclasses.field(default_factory=Counter)  # with those that are not in the list

    def add(self, element: "Element", message: str, severity: Severity = Severity.MISTAKE) -> None:
        """Note a problem, but only once: an element that others refer to may be read several times."""
        problem = (str(element.file), element.line, message, severity)
        if problem in self.found or problem in self.told:
            return
        self.count[severity] += 1
        if self.count[severity] <= MOST_PROBLEMS:
            self.found[problem] = None

    def check(self, path: Path, ignore_unsupported: bool) -> None:
        """Raise one `SceneFileError` that lists all errors so far. Give warnings for the other problems.

        If there is no error, the list is empty afterwards, and what was told is not noted again.
        """
        # A stable sort: by line within a file, the main file first.
        ordered = sorted(self.found, key=lambda problem: (problem[0] != str(path), *problem[:2]))
        warned = {Severity.HARMLESS, Severity.UNSUPPORTED} if ignore_unsupported else {Severity.HARMLESS}
        for *_, message, severity in ordered:
            if severity in warned:
                warn(message)
        remaining = [message for *_, message, severity in ordered if severity not in warned]
        count = sum(n for severity, n in self.count.items() if severity not in warned)
        if count == 1:
            raise SceneFileError(remaining[0])
        if count:
            rest = [f"and {count - len(remaining)} more"] if count > len(remaining) else []
            raise SceneFileError("\n  ".join([f"{path} has {count} problems:", *remaining, *rest]))
        if self.count.total() > len(ordered):
            warn(f"{path}: and {self.count.total() - len(ordered)} more warnings like these")
        self.told.update(self.found)
        self.found.clear()
        self.count.clear()


@dataclasses.dataclass(eq=False)  # elements that are alike are not the same
class Element:
    """An XML element and its place in the file.

    - `problems`: shared by all elements of a scene; `folders`: where files are looked for.
    - `properties`: the `xml.Properties` that read the element last. They note what was not read.
    - `vertex_data`: attributes of the mesh of the shape around the element, by name. `vertex_…` has a row for each
      vertex (None if there is no single value for each), `face_…` one for each face. None outside of shapes.
    - `referred`: whether some `<ref>` refers to it.
    - `made`: what plugins have made of it, by plugin. All references to an element share it.
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
    made: dict[Any, list[Any]] = dataclasses.field(default_factory=dict)

    @property
    def type(self) -> str:
        """The plugin type. An element without one, such as the outermost, counts as `scene`."""
        return self.attributes.get("type", "scene")

    @property
    def needs_mesh(self) -> bool:
        """Whether it is or contains a texture whose values are attributes of a mesh."""
        return self.type == "mesh_attribute" or any(child.needs_mesh for child in self.children)

    def place(self, message: str) -> str:
        """The message after file, line and tag."""
        return f"{self.file}, line {self.line}, <{self.tag}>: {message}"

    def error(self, message: str) -> SceneFileError:
        """The error to raise for this element."""
        return SceneFileError(self.place(message))

    def unsupported(self, message: str, instead: str) -> None:
        """Note something that is not supported here, and what happens `instead` with `ignore_unsupported`."""
        message = self.place(f"{message}; with ignore_unsupported {instead}")
        self.problems.add(self, message, Severity.UNSUPPORTED)

    def harmless(self, message: str) -> None:
        """Note something to warn of that is not read, and changes little or nothing in the expected image."""
        self.problems.add(self, self.place(message), Severity.HARMLESS)

    def check_attributes(self, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()) -> None:
        """Raises `SceneFileError` unless the element has all required attributes and no unknown ones."""
        for name in self.attributes:
            if name not in required + optional:
                raise self.error(f"unknown attribute {name!r}; known: {', '.join(required + optional) or 'none'}")
        for name in required:
            if name not in self.attributes:
                raise self.error(f"attribute {name!r} is missing")

    @contextlib.contextmanager
    def located(self) -> Iterator[None]:
        """Add the place of this element to an error raised inside the block, unless it names a place already."""
        try:
            yield
        except SceneFileError:
            raise
        except ValueError as error:
            raise self.error(str(error)) from error
        except OSError as error:
            raise self.error(f"can't read {error.filename}: {reason(error)}") from error

    def find_file(self, filename: str) -> Path:
        """The first file of this name in `folders` or the working directory. Raises ValueError if there is none.

        Folders, pipes and devices don't count: reading them may never end.
        """
        candidates = self._candidates(filename)
        for candidate in candidates:
            if _is(candidate.is_file):
                return candidate
        raise ValueError(f"there is no file {' or '.join(str(path) for path in candidates) or shortened(filename)}")

    def find_folder(self, name: str) -> Path:
        """The first folder of this name in `folders` or the working directory. Raises ValueError if there is none."""
        for candidate in self._candidates(name):
            if _is(candidate.is_dir):
                return candidate
        raise ValueError(f"there is no folder {shortened(name)}")

    def _candidates(self, name: str) -> list[Path]:
        if len(name) > LONGEST_PATH:
            return []
        return list(dict.fromkeys(folder / name for folder in (*self.folders, Path.cwd())))


def _is(test: Callable[[], bool]) -> bool:
    """Whether a path passes a test. A name that is too long and a folder that must not be read do not."""
    try:
        return test()
    except OSError:
        return False
