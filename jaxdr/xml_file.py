"""XML that comes from elsewhere: what all of its readers refuse, and a reader of small trees."""

import codecs
import dataclasses
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.parsers import expat

from jaxdr.untrusted import DEEPEST, damage, shortened

MOST_ELEMENTS = 200_000  # of a document
PROBE = rb"\x41\u0041" + bytes(code for code in range(32, 127) if code != ord("\\"))


@dataclasses.dataclass
class Node:
    """An element, with the text in it, but not in its children."""

    tag: str
    attributes: dict[str, str]
    text: str = ""
    children: list["Node"] = dataclasses.field(default_factory=list)

    def all(self, tag: str) -> Iterator["Node"]:
        """Its children of a name."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> "Node | None":
        """Its first child of a name; None if there is none."""
        return next(self.all(tag), None)


def read_tree(path: Path) -> Node:
    """The root of a file. Raises ValueError, with file and line, for malformed XML, entities, and too many elements."""
    with damage(f"{path}: can't be read"):
        content = path.read_bytes()
    with damage(f"{path}: is not readable XML"):
        content = readable(content)
    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    top = Node("", {})
    stack, parts, count = [top], [[""]], 0

    def error(words: str) -> ValueError:
        return ValueError(f"{path}: line {parser.CurrentLineNumber}: {words}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS:
            raise error(f"the document has more than {MOST_ELEMENTS} elements; export the cameras alone")
        if len(stack) > DEEPEST:
            raise error(f"elements are nested more than {DEEPEST} levels deep; export it anew")
        stack[-1].children.append(Node(tag, attributes))
        stack.append(stack[-1].children[-1])
        parts.append([])

    def end(tag: str) -> None:
        stack.pop().text = "".join(parts.pop())

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda text: parts[-1].append(text)
    refuse_entities(parser, error)
    try:
        parser.Parse(content, True)
    except expat.ExpatError as problem:
        raise ValueError(f"{path}: is not readable XML ({problem}); export it anew") from problem
    return top.children[0]


def refuse_entities(parser: expat.XMLParserType, error: Callable[[str], Exception]) -> None:
    """Let a parser raise `error` with its words for entities: they stand for other files, or for many of each other."""

    def document_type(name: str, system: str | None, public: str | None, subset: int) -> None:
        if system or public or subset:
            raise error("<!DOCTYPE> with entities or an address is not supported; remove it")

    parser.StartDoctypeDeclHandler = document_type


def readable(content: bytes) -> bytes:
    """XML in UTF-8 that expat can read. Raises ValueError for an encoding that is not supported.

    Mitsuba is less strict than expat. Comments may contain `--`, so they are emptied. Line numbers stay the same. A
    file that is not in the encoding that it declares counts as Latin-1.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        try:
            text = content.decode("utf-16")
        except UnicodeDecodeError as error:
            raise ValueError(f"malformed XML: not in UTF-16 as its first bytes say ({error.reason})") from error
    else:
        content = content.removeprefix(codecs.BOM_UTF8)
        declared = re.match(rb"<\?xml[^>]*encoding=[\"']([\w.:-]+)[\"']", content)
        text = _decoded(content, declared[1].decode() if declared else "utf-8")
    # Only up to the last end of a comment, as the search for an end that is not there is long.
    before, end, rest = text.rpartition("-->")
    emptied = re.sub("<!--.*?-->", lambda comment: "<!---->" + "\n" * comment[0].count("\n"), before + end, flags=re.S)
    return (emptied + rest).encode()


def _decoded(content: bytes, encoding: str) -> str:
    """Text in an encoding that has ASCII in it: the declaration itself is ASCII. Others hide elements, or take long."""
    try:
        has_ascii = PROBE.decode(encoding) == PROBE.decode("ascii")
    except (LookupError, ValueError):  # Python does not know it, or it is none of text
        has_ascii = False
    if not has_ascii:
        raise ValueError(f"malformed XML: unknown encoding {shortened(encoding)}; save the file in UTF-8")
    try:
        return content.decode(encoding)
    except ValueError:
        return content.decode("latin-1")
