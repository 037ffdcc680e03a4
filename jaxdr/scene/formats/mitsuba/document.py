"""Mitsuba 3 scene files as trees of elements: `$variables`, `<default>`, `<include>`, `<path>`, `<alias>`, `<ref>`."""

import dataclasses
import difflib
import re
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from jaxdr.scene.formats.mitsuba.element import Element, Problems, SceneFileError
from jaxdr.scene.formats.mitsuba.upgrade import upgrade


class Variables:
    """Values of `$name`: those that the caller gave, and the `<default>`s read so far, which don't override those."""

    def __init__(self, given: dict[str, object]):
        self.values = {name: str(v).lower() if isinstance(v, bool) else str(v) for name, v in given.items()}
        self.unknown = set(given)  # given, but met neither as $name nor in a <default>

    def declare(self, name: str, value: str) -> None:
        """Take the value of a `<default>`, unless the variable has one already."""
        self.values.setdefault(name, value)
        self.unknown.discard(name)

    def substitute(self, text: str, element: Element) -> str:
        """`text` with every `$name` replaced. The longest known name counts, as in Mitsuba."""

        def value(match: re.Match) -> str:
            word = match[1]
            for end in range(len(word), 0, -1):
                if word[:end] in self.values:
                    self.unknown.discard(word[:end])
                    return self.values[word[:end]] + word[end:]
            raise element.error(f"variable ${word} has no value; give it as a keyword ({word}=...) or by a <default>")

        return re.sub(r"\$(\w*)", value, text)


def read_document(path: Path, variables: dict[str, object]) -> Element:
    """The `<scene>` of a file. Variables are substituted; includes and references are replaced by their elements.

    Raises `SceneFileError` for a file that is missing or malformed. Wrong references are added to the element's
    `problems`.
    """
    given = Variables(variables)
    root = read_xml(path, given)
    if root.tag != "scene":
        raise root.error("the outermost element must be <scene>")
    if given.unknown:
        raise root.error(f"nothing in this scene uses the variable {', '.join(sorted(given.unknown))}")
    _resolve(root, _by_id(root), [], set())
    return root


def read_xml(
    path: Path,
    variables: Variables,
    problems: Problems | None = None,
    folders: tuple[Path, ...] = (),
    parents: tuple[Path, ...] = (),
) -> Element:
    """The root element of a file, with variables substituted, and includes replaced by the elements of their files.

    Files are looked for in the folders of `<path>` elements, then in the folder of the file itself, then in `folders`.
    Raises `SceneFileError` for a missing file, malformed XML, text between elements, a variable without value, and a
    file that includes itself.
    """
    problems = Problems() if problems is None else problems
    try:
        content, encoding = _readable(path.read_bytes())
    except OSError as error:
        raise SceneFileError(f"{path}: can't read this scene file: {error.strerror}") from error
    parser = expat.ParserCreate(encoding)
    search = [path.parent, *folders]  # shared by all elements of the file: a <path> counts for those before it, too
    top = Element("xml", {}, path, 0, problems=problems, folders=search)
    stack = [top]

    def include(element: Element) -> None:
        element.check_attributes(("filename",))
        with element.located():
            included = element.find_file(element.attributes["filename"])
        if any(included.samefile(other) for other in (*parents, path)):
            raise element.error(f"{included} includes itself")
        root = read_xml(included, variables, problems, tuple(search), (*parents, path))
        stack[-1].children += root.children if root.tag == "scene" else [root]

    def add_folder(element: Element) -> None:
        element.check_attributes(("value",))
        if len(stack) != 2:
            raise element.error("only allowed directly inside <scene>")
        value = element.attributes["value"]
        folder = next((f / value for f in (*search, Path.cwd()) if (f / value).is_dir()), None)
        if folder is None:
            raise element.error(f"there is no folder {element.attributes['value']}")
        search.insert(0, folder)

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, {}, path, parser.CurrentLineNumber, problems=problems, folders=search)
        element.attributes = {name: variables.substitute(text, element) for name, text in attributes.items()}
        outermost = len(stack) == 1
        if tag == "default" and not outermost:
            element.check_attributes(("name", "value"))
            variables.declare(**element.attributes)
        elif tag == "include" and not outermost:
            include(element)
        elif tag == "path" and not outermost:
            add_folder(element)
        else:
            stack[-1].children.append(element)
        stack.append(element)

    def end(tag: str) -> None:
        element = stack.pop()
        if tag in ("default", "include", "path") and element.children:
            raise element.children[0].error(f"unexpected inside <{tag}>")

    def text(data: str) -> None:
        if data.strip():
            place = dataclasses.replace(stack[-1], line=parser.CurrentLineNumber)
            raise place.error(f"unexpected text {data.strip()!r}")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError) as error:  # LookupError: an encoding Python does not know
        place = dataclasses.replace(stack[-1], line=parser.CurrentLineNumber)
        raise place.error(f"malformed XML: {error}") from error
    root = top.children[0]
    if "version" not in root.attributes:
        raise root.error("attribute 'version' is missing; the files of Mitsuba 3 say version=\"3.0.0\"")
    version = root.attributes.pop("version")
    if not re.fullmatch(r"[0-3]\.\d+\.\d+", version):
        raise root.error(f"version {version!r} is not one of Mitsuba (such as 3.0.0)")
    if version[0] in "01":
        upgrade(root)
    return root


def _readable(content: bytes) -> tuple[bytes, str | None]:
    """(XML that expat can read, its encoding; None if expat finds the encoding itself).

    Mitsuba is less strict than expat. Comments may contain `--`, so they are emptied. Line numbers stay the same. A
    file that is not in the encoding that it declares counts as Latin-1.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):  # UTF-16
        return content, None
    content = re.sub(rb"<!--.*?-->", lambda comment: b"<!---->" + b"\n" * comment[0].count(b"\n"), content, flags=re.S)
    declared = re.match(rb"(?:\xef\xbb\xbf)?<\?xml[^>]*encoding=[\"']([\w.:-]+)[\"']", content)
    encoding = declared[1].decode() if declared else "utf-8"
    try:
        return content.decode(encoding).encode(), "utf-8"
    except UnicodeDecodeError:
        return content, "iso-8859-1"
    except LookupError:  # expat says which encoding that is
        return content, None


def _by_id(root: Element) -> dict[str, Element]:
    """All elements by id and alias. Aliases are removed from the tree."""
    found: dict[str, Element] = {}
    for parent, element in list(descendants(root)):
        if element.tag == "alias":
            parent.children.remove(element)
            element.check_attributes(("id", "as"))
            if element.attributes["id"] not in found:
                raise element.error(f"there is no object with id {element.attributes['id']!r} before this alias")
            name, element = element.attributes["as"], found[element.attributes["id"]]
        else:
            name = None if element.tag == "ref" else element.attributes.get("id")
        if name in found:
            first = found[name]
            message = f"id {name!r} is taken by <{first.tag}> in {first.file}, line {first.line}"
            element.problems.add(element, element.place(message))
        elif name is not None:
            found[name] = element
    return found


def descendants(element: Element) -> Iterator[tuple[Element, Element]]:
    """(parent, child) for every element inside, each before its own children."""
    for child in element.children:
        yield element, child
        yield from descendants(child)


def _resolve(element: Element, by_id: dict[str, Element], parents: list[Element], done: set[int]) -> None:
    """Replace every `<ref>` inside by its target. A `<ref>` without one is noted as a problem and left out."""
    if id(element) in done:
        return
    resolved = []
    for child in element.children:
        if child.tag != "ref":
            _resolve(child, by_id, [*parents, element], done)
            resolved.append(child)
            continue
        try:
            child.check_attributes(("id",), ("name",))
            resolved.append(_target(child, by_id, [*parents, element], done))
        except SceneFileError as error:
            child.problems.add(child, str(error))
    element.children[:] = resolved
    done.add(id(element))


def _target(reference: Element, by_id: dict[str, Element], parents: list[Element], done: set[int]) -> Element:
    name = reference.attributes["id"]
    if name not in by_id:
        close = difflib.get_close_matches(name, by_id, 1)
        raise reference.error(
            f"there is no object with id {name!r}" + (f"; did you mean {close[0]!r}?" if close else "")
        )
    target = by_id[name]
    if any(target is parent for parent in parents):
        raise reference.error(f"refers to {name!r}, which contains it")
    _resolve(target, by_id, parents, done)
    target.referred = True
    attributes = {k: v for k, v in target.attributes.items() if k != "name"}
    if "name" in reference.attributes:
        attributes["name"] = reference.attributes["name"]
    return dataclasses.replace(target, attributes=attributes)
