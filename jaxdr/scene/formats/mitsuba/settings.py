"""Settings of a Mitsuba scene file that say how its image is rendered, and are no part of the scene."""

import os
from pathlib import Path
from typing import NamedTuple

from jaxdr.scene.formats.mitsuba.document import descendants, read_document
from jaxdr.scene.formats.mitsuba.element import Element

DIRECT = ("direct", "direct_projective")  # two segments by definition


class RenderSettings(NamedTuple):
    """Longest path in segments (-1 for no limit, as in Mitsuba) and samples per pixel; None if the file gives none."""

    max_depth: int | None
    spp: int | None


def mitsuba_settings(path: str | os.PathLike, /, **variables: object) -> RenderSettings:
    """The settings of the first integrator, and of the sampler of the first sensor; keywords as in `load_mitsuba`.

    Raises ValueError for malformed XML, a variable without value, and a setting that is no whole number.
    """
    root = read_document(Path(path), variables)
    depth = spp = None
    for _, element in descendants(root):
        if element.tag == "integrator" and element.type not in ("aov", "moment"):  # these have another one inside
            depth = 2 if element.type in DIRECT else _whole(element, "max_depth", -1)
            break
    sensors = [child for child in root.children if child.tag == "sensor"]
    for _, element in descendants(sensors[0]) if sensors else ():
        if element.tag == "sampler":
            spp = _whole(element, "sample_count", None)
    return RenderSettings(depth, spp)


def _whole(element: Element, name: str, default: int | None) -> int | None:
    for child in element.children:
        if child.tag == "integer" and child.attributes.get("name") == name:
            try:
                return int(child.attributes["value"])
            except (KeyError, ValueError):
                raise child.error(f"{name} must be a whole number") from None
    return default
