"""The syntax of Mitsuba 3 scene files: elements with line numbers, `$variables`, includes and typed values.

What the elements mean is in `jaxdr.scene.mitsuba`. Every error is a `SceneFileError` that names file, line and tag.
"""

import contextlib
import dataclasses
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from jaxtyping import Float

from jaxdr.scene.camera import look_at

OBJECT_TAGS = ("bsdf", "emitter", "film", "integrator", "ref", "rfilter", "sampler", "sensor", "shape")


class SceneFileError(ValueError):
    """A scene file that can't be loaded; the message starts with file, line and tag."""


@dataclasses.dataclass
class Element:
    """An XML element and where it stands."""

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list["Element"] = dataclasses.field(default_factory=list)

    def error(self, message: str) -> SceneFileError:
        """The error to raise for this element."""
        return SceneFileError(f"{self.file}, line {self.line}, <{self.tag}>: {message}")

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


class Variables:
    """Values of `$name`: those the caller gave, and the `<default>`s read so far, which don't override them."""

    def __init__(self, given: dict[str, object]):
        self.values = {name: str(v).lower() if isinstance(v, bool) else str(v) for name, v in given.items()}
        self.unknown = set(given)  # given, but met neither as $name nor in a <default>

    def declare(self, name: str, value: str) -> None:
        """Read a `<default>`."""
        self.values.setdefault(name, value)
        self.unknown.discard(name)

    def substitute(self, text: str, element: Element) -> str:
        """`text` with every `$name` replaced; the longest name known is taken, as in Mitsuba."""

        def value(match: re.Match) -> str:
            word = match[1]
            for end in range(len(word), 0, -1):
                if word[:end] in self.values:
                    self.unknown.discard(word[:end])
                    return self.values[word[:end]] + word[end:]
            raise element.error(f"variable ${word} has no value; give it as a keyword ({word}=...) or by a <default>")

        return re.sub(r"\$(\w*)", value, text)


def read_xml(path: Path, variables: Variables, root: Path | None = None, parents: tuple[Path, ...] = ()) -> Element:
    """The root element of a file, with variables substituted and includes replaced by what they include.

    Included files are looked up from `root`, the folder of the main scene file. Raises `SceneFileError` for a missing
    file, malformed XML, text between elements, a variable without value, and a file that includes itself.
    """
    root = path.parent if root is None else root
    parser = expat.ParserCreate()
    top = Element("xml", {}, path, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, {}, path, parser.CurrentLineNumber)
        element.attributes = {name: variables.substitute(text, element) for name, text in attributes.items()}
        outermost = len(stack) == 1
        if tag == "default" and not outermost:
            element.check_attributes(("name", "value"))
            variables.declare(**element.attributes)
        elif tag == "include" and not outermost:
            element.check_attributes(("filename",))
            included = root / element.attributes["filename"]
            if not included.is_file():
                raise element.error(f"included file {included} does not exist")
            if any(included.samefile(other) for other in (*parents, path)):
                raise element.error(f"{included} includes itself")
            content = read_xml(included, variables, root, (*parents, path))
            stack[-1].children += content.children if content.tag == "scene" else [content]
        else:
            stack[-1].children.append(element)
        stack.append(element)

    def end(tag: str) -> None:
        element = stack.pop()
        if tag in ("default", "include") and element.children:
            raise element.children[0].error(f"unexpected inside <{tag}>")

    def text(data: str) -> None:
        if data.strip():
            place = dataclasses.replace(stack[-1], line=parser.CurrentLineNumber)
            raise place.error(f"unexpected text {data.strip()!r}")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    try:
        parser.Parse(path.read_bytes(), True)
    except (expat.ExpatError, LookupError) as error:  # LookupError: an encoding Python does not know
        place = dataclasses.replace(stack[-1], line=parser.CurrentLineNumber)
        raise place.error(f"malformed XML: {error}") from error
    except OSError as error:
        raise SceneFileError(f"{path}: can't read this scene file: {error.strerror}") from error
    content = top.children[0]
    if "version" not in content.attributes:
        raise content.error("attribute 'version' is missing; the files of Mitsuba 3 say version=\"3.0.0\"")
    version = content.attributes.pop("version")
    if not re.fullmatch(r"[23]\.\d+\.\d+", version):
        raise content.error(f"version {version!r} is not one of Mitsuba 2 or 3 (such as 3.0.0)")
    return content


def floats(text: str, *counts: int) -> list[float]:
    """Finite numbers separated by spaces or commas, as many as one of `counts`."""
    try:
        values = [float(word) for word in re.split(r"\s*,\s*|\s+", text.strip())]
    except ValueError:
        raise ValueError(f"expected numbers, got {text!r}") from None
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{text!r} is not finite")
    if len(values) not in counts:
        raise ValueError(f"expected {' or '.join(map(str, counts))} numbers, got {text!r}")
    return values


def _integer(element: Element) -> int:
    text = element.attributes["value"]
    if not re.fullmatch(r"\s*[+-]?\d+\s*", text):
        raise ValueError(f"expected an integer, got {text!r}")
    return int(text)


def _boolean(element: Element) -> bool:
    text = element.attributes["value"]
    if text not in ("true", "false"):
        raise ValueError(f"expected true or false, got {text!r}")
    return text == "true"


def _triple(element: Element, default: float | None = None, extra: tuple[str, ...] = ()) -> Float[np.ndarray, "3"]:
    """Three numbers, from value="x, y, z" (or one number for all) or from x=, y=, z= (missing ones are `default`)."""
    if "value" in element.attributes:
        element.check_attributes((*extra, "value"))
        return np.array(floats(element.attributes["value"], 1, 3)) * np.ones(3)
    element.check_attributes(extra if default is not None else (*extra, "x", "y", "z"), ("x", "y", "z"))
    return np.array([floats(element.attributes[k], 1)[0] if k in element.attributes else default for k in "xyz"])


def _rgb(element: Element) -> Float[np.ndarray, "3"]:
    if element.attributes["value"].startswith("#"):
        raise ValueError("hexadecimal colours are not part of Mitsuba 3 files; give linear RGB, such as 0.2, 0.5, 0.1")
    return np.array(floats(element.attributes["value"], 1, 3)) * np.ones(3)


def _translate(element: Element) -> Float[np.ndarray, "4 4"]:
    matrix = np.eye(4)
    matrix[:3, 3] = _triple(element, 0.0)
    return matrix


def _scale(element: Element) -> Float[np.ndarray, "4 4"]:
    return np.diag([*_triple(element, 1.0), 1.0])


def _rotate(element: Element) -> Float[np.ndarray, "4 4"]:
    """Rotation about a unit axis, angle in degrees (Rodrigues' formula)."""
    axis = _triple(element, 0.0, extra=("angle",))
    if abs(np.linalg.norm(axis) - 1) > 1e-3:
        raise ValueError(f"the rotation axis must have length 1, got {axis.tolist()}")
    x, y, z = axis / np.linalg.norm(axis)
    angle = math.radians(floats(element.attributes["angle"], 1)[0])
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    return matrix


def _matrix(element: Element) -> Float[np.ndarray, "4 4"]:
    element.check_attributes(("value",))
    values = np.array(floats(element.attributes["value"], 9, 16))
    matrix = np.eye(4)
    size = 3 if len(values) == 9 else 4
    matrix[:size, :size] = values.reshape(size, size)
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        raise ValueError(f"the last row of a matrix must be 0 0 0 1, got {matrix[3].tolist()}")
    return matrix


def _lookat(element: Element) -> Float[np.ndarray, "4 4"]:
    element.check_attributes(("origin", "target", "up"))
    return look_at(*(floats(element.attributes[name], 3) for name in ("origin", "target", "up")))


TRANSFORMS: dict[str, Callable[[Element], Float[np.ndarray, "4 4"]]] = {
    "translate": _translate,
    "scale": _scale,
    "rotate": _rotate,
    "matrix": _matrix,
    "lookat": _lookat,
}


def _transform(element: Element) -> Float[np.ndarray, "4 4"]:
    """The product of the steps inside; the first one is applied first."""
    matrix = np.eye(4)
    for step in element.children:
        if step.tag not in TRANSFORMS:
            raise step.error(f"unknown transform; known: {', '.join(TRANSFORMS)}")
        with step.located():
            matrix = TRANSFORMS[step.tag](step) @ matrix
    return matrix


VALUES: dict[str, Callable[[Element], Any]] = {
    "boolean": _boolean,
    "integer": _integer,
    "float": lambda element: floats(element.attributes["value"], 1)[0],
    "string": lambda element: element.attributes["value"],
    "point": lambda element: _triple(element, extra=("name",)),
    "vector": lambda element: _triple(element, extra=("name",)),
    "rgb": _rgb,
    "spectrum": lambda element: np.ones(3) * floats(element.attributes["value"], 1)[0],
    "transform": _transform,
}


class Properties:
    """The named values and the nested objects of an object element, such as `<shape type="ply" id="spot">`.

    Both are taken one by one, and `finish` raises for the first that nobody took, so nothing is ignored silently.
    """

    def __init__(self, element: Element):
        self.element = element
        element.check_attributes((() if element.tag == "scene" else ("type",)), ("id", "name"))
        self.type = element.attributes.get("type", "scene")
        self._values: dict[str, Element] = {}
        self._objects: list[Element] = []
        for child in element.children:
            if child.tag in OBJECT_TAGS:
                self._objects.append(child)
            elif child.tag not in VALUES:
                raise child.error("unknown element")
            elif child.attributes.get("name") in self._values:
                raise child.error(f"a second parameter {child.attributes['name']!r} in one <{element.tag}>")
            else:
                child.check_attributes(("name",), tuple(child.attributes))
                self._values[child.attributes["name"]] = child

    def value(self, name: str, tags: str, default: Any = None) -> Any:
        """Take a value whose element is one of the space-separated `tags`; `default` when it is absent."""
        if name not in self._values:
            return default
        element = self._values.pop(name)
        if element.tag not in tags.split():
            raise element.error(f"parameter {name!r} must be given by <{'> or <'.join(tags.split())}>")
        if element.tag not in ("point", "vector"):
            element.check_attributes(("name",) if element.tag == "transform" else ("name", "value"))
        if element.tag != "transform" and element.children:
            raise element.children[0].error(f"unexpected inside <{element.tag}>")
        with element.located():
            return VALUES[element.tag](element)

    def tag(self, name: str) -> str | None:
        """The tag that gives a value which is not taken yet."""
        return self._values[name].tag if name in self._values else None

    def ignore(self, *names: str) -> None:
        """Take values whose meaning has no part in the expected image."""
        for name in names:
            self._values.pop(name, None)

    def objects(self, *tags: str) -> list[Element]:
        """Take all nested objects with one of these tags."""
        taken = [child for child in self._objects if child.tag in tags]
        self._objects = [child for child in self._objects if child.tag not in tags]
        return taken

    def at_most_one(self, *tags: str) -> Element | None:
        """Take the nested object with one of these tags, if there is one; a second is an error."""
        taken = self.objects(*tags)
        if len(taken) > 1:
            raise taken[1].error(f"a second one in one <{self.element.tag}>; only one is allowed")
        return taken[0] if taken else None

    def choose(self, known: dict[str, Any]) -> Any:
        """The entry for this plugin type; raises for an unknown type."""
        if self.type not in known:
            raise self.element.error(f"unknown type {self.type!r}; known: {', '.join(known)}")
        return known[self.type]

    def finish(self) -> None:
        """Raise for the first value or object nobody took."""
        for name, element in self._values.items():
            raise element.error(f"unknown parameter {name!r} of {self.element.tag} {self.type!r}")
        for element in self._objects:
            raise element.error(f"not supported inside {self.element.tag} {self.type!r}")
