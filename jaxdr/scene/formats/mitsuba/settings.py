"""Settings of a Mitsuba scene file that say how its image is rendered, and are no part of the scene."""

import os
from pathlib import Path
from typing import NamedTuple

from jaxdr.scene.formats.mitsuba.document import descendants, read_document
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.number import integer
from jaxdr.scene.formats.mitsuba.sensors import chosen_sensor

DIRECT = ("direct", "direct_projective")  # two segments by definition
MOST = 2**31 - 1  # samples and segments


class RenderSettings(NamedTuple):
    """Longest path in segments (-1 for no limit, as in Mitsuba) and samples per pixel; None if the file gives none."""

    max_depth: int | None
    spp: int | None


def mitsuba_settings(
    path: str | os.PathLike, /, *, sensor: str | int | None = None, **variables: object
) -> RenderSettings:
    """The settings of the first integrator, and of the sampler of the sensor; keywords as in `load_mitsuba`.

    Raises ValueError for malformed XML, a variable without value, a sensor that is not there, and a setting that is no
    whole number or beyond 32 bits.
    """
    root = read_document(Path(path), variables)
    depth = spp = None
    for _, element in descendants(root):
        if element.tag == "integrator" and element.type not in ("aov", "moment"):  # these have another one inside
            depth = 2 if element.type in DIRECT else _whole(element, "max_depth", -1, -1)
            break
    seen_by = chosen_sensor(root, [child for child in root.children if child.tag == "sensor"], sensor)
    for _, element in descendants(seen_by) if seen_by is not None else ():
        if element.tag == "sampler":
            spp = _whole(element, "sample_count", None, 1)
    return RenderSettings(depth, spp)


def _whole(element: Element, name: str, default: int | None, low: int) -> int | None:
    for child in element.children:
        if child.tag == "integer" and child.attributes.get("name") == name:
            child.check_attributes(("name", "value"))
            with child.located():
                return integer(child.attributes["value"], low, MOST)
    return default
