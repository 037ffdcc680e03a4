"""How a Mitsuba scene file wants its image to be made: what is no part of the scene."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxdr.scene.mitsuba_document import read_document
from jaxdr.scene.mitsuba_element import Element

DIRECT = ("direct", "direct_projective")  # two segments by definition


class RenderSettings(NamedTuple):
    """Longest path in segments (-1 for no end, as Mitsuba counts) and samples per pixel; None where nothing is said."""

    max_depth: int | None
    spp: int | None


def mitsuba_settings(path: str | os.PathLike, /, **variables: object) -> RenderSettings:
    """The settings of the first integrator and of the first sensor's sampler; keywords as in `load_mitsuba`.

    Raises ValueError for malformed XML, a variable without value, a number that is none.
    """
    root = read_document(Path(path), variables)
    depth = spp = None
    for integrator in _nested(root, "integrator"):
        if integrator.type not in ("aov", "moment"):  # these have another one inside
            depth = 2 if integrator.type in DIRECT else _whole(integrator, "max_depth", -1)
            break
    for sensor in _nested(root, "sensor"):
        for sampler in _nested(sensor, "sampler"):
            spp = _whole(sampler, "sample_count", None)
        break
    return RenderSettings(depth, spp)


def _nested(element: Element, tag: str) -> Iterator[Element]:
    for child in element.children:
        if child.tag == tag:
            yield child
            yield from _nested(child, tag)


def _whole(element: Element, name: str, default: int | None) -> int | None:
    for child in element.children:
        if child.tag == "integer" and child.attributes.get("name") == name:
            try:
                return int(child.attributes["value"])
            except (KeyError, ValueError):
                raise child.error(f"{name} must be a whole number") from None
    return default
