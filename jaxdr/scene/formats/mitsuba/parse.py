"""Files of a Mitsuba 3 scene as trees of elements: `$variables`, `<default>`, `<include>` and `<path>` are done.

Files that include each other grow without bound, so what all of them hold together is counted.
"""

import dataclasses
import re
from pathlib import Path
from xml.parsers import expat

from jaxdr.scene.formats.mitsuba.element import Element, Problems, SceneFileError
from jaxdr.scene.formats.mitsuba.upgrade import upgrade
from jaxdr.scene.formats.mitsuba.variables import Variables
from jaxdr.untrusted import DEEPEST, shortened
from jaxdr.xml_file import readable, refuse_entities

MOST_ELEMENTS = 200_000  # of a scene, with those of its included files
MOST_FILES = 1000  # includes of a scene, each as often as it is included
MOST_FOLDERS = 64  # where files are looked for


@dataclasses.dataclass
class Reading:
    """What all files of a scene share while they are read."""

    variables: Variables
    problems: Problems = dataclasses.field(default_factory=Problems)
    elements: int = 0
    files: int = 0


def read_xml(path: Path, variables: Variables) -> Element:
    """The root element of a file, with variables substituted, and includes replaced by the elements of their files.

    Files are looked for in the folders of `<path>` elements, then in the folder of the file itself, then in those of
    the file that includes it. Raises `SceneFileError` for a missing file, malformed XML, text between elements, a
    variable without value, a file that includes itself, and for more files, elements and levels than the limits.
    """
    return _File(path, Reading(variables)).read()


class _File:
    """One file that is being read. `folders`, `parents`: of the files that include it; `depth`: levels around it."""

    def __init__(
        self,
        path: Path,
        reading: Reading,
        folders: tuple[Path, ...] = (),
        parents: tuple[Path, ...] = (),
        depth: int = 0,
    ):
        self.path, self.reading, self.parents, self.depth = path, reading, parents, depth
        # Shared by all elements of the file: a <path> counts for those before it, too.
        self.folders = [path.parent, *folders]
        self.top = Element("xml", {}, path, 1, problems=reading.problems, folders=self.folders)
        self.stack = [self.top]
        self.parser = expat.ParserCreate("utf-8")

    def read(self) -> Element:
        """The root element."""
        content = self._content()
        parser = self.parser
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler = self._text
        # Mitsuba does not read entities either.
        refuse_entities(parser, lambda words: self._here().error(words))
        try:
            parser.Parse(content, True)
        except expat.ExpatError as error:
            raise self._here().error(f"malformed XML: {error}") from error
        root = self.top.children[0]
        if "version" not in root.attributes:
            raise root.error("attribute 'version' is missing; the files of Mitsuba 3 say version=\"3.0.0\"")
        version = root.attributes.pop("version")
        if not re.fullmatch(r"[0-3]\.\d+\.\d+", version):
            raise root.error(f"version {shortened(version)} is not one of Mitsuba (such as 3.0.0)")
        if version[0] in "01":
            upgrade(root)
        return root

    def _content(self) -> bytes:
        try:
            if self.path.exists() and not self.path.is_file():  # reading a pipe or a device may never end
                raise SceneFileError(f"{self.path}: can't read this scene file: it is no regular file")
            content = self.path.read_bytes()
        except OSError as error:
            raise SceneFileError(f"{self.path}: can't read this scene file: {error.strerror}") from error
        with self.top.located():
            return readable(content)

    def _here(self) -> Element:
        """The element that is open, for an error at this line."""
        return dataclasses.replace(self.stack[-1], line=self.parser.CurrentLineNumber)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        reading, outermost = self.reading, len(self.stack) == 1
        line = self.parser.CurrentLineNumber
        element = Element(tag, {}, self.path, line, problems=reading.problems, folders=self.folders)
        reading.elements += 1
        if reading.elements > MOST_ELEMENTS:
            raise element.error(f"the scene has more than {MOST_ELEMENTS} elements, with those of its included files")
        if self.depth + len(self.stack) > DEEPEST:
            raise element.error(f"elements are nested more than {DEEPEST} levels deep")
        element.attributes = {name: reading.variables.substitute(text, element) for name, text in attributes.items()}
        if tag == "default" and not outermost:
            element.check_attributes(("name", "value"))
            reading.variables.declare(**element.attributes)
        elif tag == "include" and not outermost:
            self._include(element)
        elif tag == "path" and not outermost:
            self._add_folder(element)
        else:
            self.stack[-1].children.append(element)
        self.stack.append(element)

    def _end(self, tag: str) -> None:
        element = self.stack.pop()
        if tag in ("default", "include", "path") and element.children:
            raise element.children[0].error(f"unexpected inside <{tag}>")

    def _text(self, data: str) -> None:
        if data.strip():
            raise self._here().error(f"unexpected text {shortened(data.strip())}")

    def _include(self, element: Element) -> None:
        element.check_attributes(("filename",))
        self.reading.files += 1
        if self.reading.files > MOST_FILES:
            raise element.error(f"the scene includes more than {MOST_FILES} files")
        with element.located():
            included = element.find_file(element.attributes["filename"])
        if any(included.samefile(other) for other in (*self.parents, self.path)):
            raise element.error(f"{included} includes itself")
        depth = self.depth + len(self.stack)
        root = _File(included, self.reading, tuple(self.folders), (*self.parents, self.path), depth).read()
        self.stack[-1].children += root.children if root.tag == "scene" else [root]

    def _add_folder(self, element: Element) -> None:
        element.check_attributes(("value",))
        if len(self.stack) != 2:
            raise element.error("only allowed directly inside <scene>")
        with element.located():
            self.folders.insert(0, element.find_folder(element.attributes["value"]))
        if len(self.folders) > MOST_FOLDERS:
            raise element.error(f"files are looked for in more than {MOST_FOLDERS} folders")
