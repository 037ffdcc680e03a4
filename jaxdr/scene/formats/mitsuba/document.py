"""Mitsuba 3 scene files as trees of elements, in which `<alias>` and `<ref>` are replaced by what they stand for."""

import dataclasses
import difflib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxdr.scene.formats.mitsuba.element import Element, SceneFileError
from jaxdr.scene.formats.mitsuba.parse import read_xml
from jaxdr.scene.formats.mitsuba.variables import Variables
from jaxdr.untrusted import DEEPEST, shortened

MOST_REFERRED = 1_000_000  # elements of a scene, with what references stand for as often as they do
SUGGESTIONS = 100  # problems with a guess of what was meant, from as many names: it takes time


class Extent(NamedTuple):
    """How large an element is, with everything inside, and what it refers to as often as it refers to it."""

    elements: int
    levels: int


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
    if _resolve(root, _by_id(root), [], {}).levels > DEEPEST:
        raise root.error(f"elements are nested more than {DEEPEST} levels deep, with those that they refer to")
    return root


def _by_id(root: Element) -> dict[str, Element]:
    """All elements by id and alias. Aliases are removed from the tree."""
    found: dict[str, Element] = {}
    with_alias: dict[int, Element] = {}
    for parent, element in descendants(root):
        if element.tag == "alias":
            with_alias[id(parent)] = parent
            element.check_attributes(("id", "as"))
            if element.attributes["id"] not in found:
                raise element.error(
                    f"there is no object with id {shortened(element.attributes['id'])} before this alias"
                )
            name, element = element.attributes["as"], found[element.attributes["id"]]
        else:
            name = None if element.tag == "ref" else element.attributes.get("id")
        if name in found:
            first = found[name]
            message = f"id {shortened(name)} is taken by <{first.tag}> in {first.file}, line {first.line}"
            element.problems.add(element, element.place(message))
        elif name is not None:
            found[name] = element
    for parent in with_alias.values():
        parent.children[:] = [child for child in parent.children if child.tag != "alias"]
    return found


def descendants(element: Element) -> Iterator[tuple[Element, Element]]:
    """(parent, child) for every element inside, each before its own children."""
    for child in element.children:
        yield element, child
        yield from descendants(child)


def _resolve(element: Element, by_id: dict[str, Element], parents: list[Element], done: dict[int, Extent]) -> Extent:
    """Replace every `<ref>` inside by its target. A `<ref>` without one is noted as a problem and left out.

    Few references that refer to others are a tree of any size, so its size is counted. `done` are sizes by the `id` of
    the element.
    """
    if id(element) in done:
        return done[id(element)]
    resolved, extents = [], [Extent(1, 0)]
    for child in element.children:
        if child.tag != "ref":
            extents.append(_resolve(child, by_id, [*parents, element], done))
            resolved.append(child)
            continue
        try:
            child.check_attributes(("id",), ("name",))
            target, extent = _target(child, by_id, [*parents, element], done)
        except SceneFileError as error:
            child.problems.add(child, str(error))
        else:
            resolved.append(target)
            extents.append(extent)
    element.children[:] = resolved
    done[id(element)] = extent = Extent(sum(e.elements for e in extents), 1 + max(e.levels for e in extents))
    if extent.elements > MOST_REFERRED:
        raise element.error(f"more than {MOST_REFERRED} elements, with those that it refers to")
    return extent


def _target(
    reference: Element, by_id: dict[str, Element], parents: list[Element], done: dict[int, Extent]
) -> tuple[Element, Extent]:
    name = reference.attributes["id"]
    if name not in by_id:
        raise reference.error(f"there is no object with id {shortened(name)}{_guess(reference, by_id)}")
    target = by_id[name]
    if any(target is parent for parent in parents):
        raise reference.error(f"refers to {shortened(name)}, which contains it")
    if len(parents) > DEEPEST:
        raise reference.error(f"refers to {shortened(name)}: elements are nested more than {DEEPEST} levels deep")
    extent = _resolve(target, by_id, parents, done)
    target.referred = True
    attributes = {k: v for k, v in target.attributes.items() if k != "name"}
    if "name" in reference.attributes:
        attributes["name"] = reference.attributes["name"]
    return dataclasses.replace(target, attributes=attributes), extent


def _guess(reference: Element, by_id: dict[str, Element]) -> str:
    """What may have been meant, for the message."""
    if len(reference.problems.found) > SUGGESTIONS:
        return ""
    near = itertools.islice((name for name in by_id if len(name) < SUGGESTIONS), SUGGESTIONS)
    close = difflib.get_close_matches(reference.attributes["id"][:SUGGESTIONS], near, 1)
    return f"; did you mean {close[0]!r}?" if close else ""
