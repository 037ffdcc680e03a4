"""Sensors of Mitsuba 3 scene files, and the elements inside them: films, reconstruction filters and samplers."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxdr.scene.camera import Camera, Orthographic, Perspective, ThinLens
from jaxdr.scene.camera.base import FAR_CLIP, NEAR_CLIP
from jaxdr.scene.film import Box, Film, Gaussian, ReconstructionFilter, Tent
from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.formats.mitsuba.number import floats
from jaxdr.scene.formats.mitsuba.xml import NUMBER, Properties, read_plugin
from jaxdr.untrusted import check_pixels, finite

SAMPLER_SETTINGS = ("sample_count", "seed", "jitter", "strength")
# They say how Mitsuba stores the image. Our pixels at the border always see beyond the film, as with `sample_border`.
FILM_SETTINGS = (
    *("file_format", "component_format", "sample_border", "compensate", "banner", "high_quality_edges", "attach_log"),
    *("gamma", "exposure", "tonemap_method", "key", "burn"),  # of Mitsuba 0.x; our images are linear
)
PIXEL_FORMATS = ("rgb", "rgba")  # there is no alpha channel here; the colours are the same
SENSOR_SETTINGS = ("shutter_open", "shutter_close")  # nothing moves in time
NARROWEST, WIDEST = 1e-3, 1e3  # pixels, of a filter
LISTED = 20  # sensors in a message
FULL_FRAME_DIAGONAL = math.hypot(36.0, 24.0)  # mm; `focal_length` is meant for this film format


def _perspective(element: Element) -> Perspective:
    properties = Properties(element)
    offset = [properties.value(f"principal_point_offset_{axis}", NUMBER, 0.0) for axis in "xy"]
    properties.ignore("focus_distance")  # a pinhole camera has no lens
    return Perspective(**_common(properties, scales=False), **field_of_view(properties), principal_point=offset)


def _thin_lens(element: Element) -> ThinLens:
    properties = Properties(element)
    common = _common(properties, scales=False)
    radius = properties.value("aperture_radius", NUMBER)
    if radius is None:
        raise ValueError("aperture_radius is missing")
    focus = properties.value("focus_distance", NUMBER, common["far_clip"])
    return ThinLens(**common, **field_of_view(properties), aperture_radius=radius, focus_distance=focus)


def _orthographic(element: Element) -> Orthographic:
    properties = Properties(element)
    properties.ignore("focus_distance")
    return Orthographic(**_common(properties, scales=True))


def _common(properties: Properties, scales: bool) -> dict[str, Any]:
    """The parameters that all cameras share."""
    to_world = properties.value("to_world", "transform", np.eye(4))
    if not scales and not np.allclose(to_world[:3, :3].T @ to_world[:3, :3], np.eye(3), atol=1e-3):
        raise ValueError("to_world must not scale or shear")
    near, far = properties.value("near_clip", NUMBER, NEAR_CLIP), properties.value("far_clip", NUMBER, FAR_CLIP)
    sampler, film = properties.at_most_one("sampler"), properties.at_most_one("film")
    if sampler is not None:
        read_sampler(sampler)
    properties.ignore(*SENSOR_SETTINGS)
    return {"to_world": to_world, "film": read_film(film), "near_clip": near, "far_clip": far}


def field_of_view(properties: Properties) -> dict[str, Any]:
    """`fov` (degrees) and `fov_axis`, from `fov` or `focal_length` (default 50mm)."""
    fov = properties.value("fov", NUMBER)
    axis = properties.value("fov_axis", "string", "x")
    focal_length = properties.value("focal_length", "string")
    if fov is not None:
        if focal_length is not None:
            raise ValueError("give either fov or focal_length, not both")
        if not 0 < fov < 180:
            raise ValueError(f"fov must be between 0 and 180 degrees, got {fov}")
        return {"fov": fov, "fov_axis": axis}
    millimetres = floats((focal_length or "50mm").removesuffix("mm"), 1)[0]
    if millimetres <= 0:
        raise ValueError(f"focal_length must be positive, got {focal_length}")
    return {"fov": math.degrees(2 * math.atan(0.5 * FULL_FRAME_DIAGONAL / millimetres)), "fov_axis": "diagonal"}


def _hdr_film(element: Element) -> Film:
    properties = Properties(element)
    width, height = properties.value("width", "integer", 768), properties.value("height", "integer", 576)
    check_pixels(width, height, "width and height")
    names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
    defaults = (0, 0, width, height)
    crop = tuple(properties.value(n, "integer", d) for n, d in zip(names, defaults, strict=True))
    pixel_format = properties.value("pixel_format", "string", "rgb").lower()
    if pixel_format not in PIXEL_FORMATS:
        element.unsupported(f"pixel_format must be {' or '.join(PIXEL_FORMATS)}, got {pixel_format!r}", "it is rgb")
    rfilter = properties.at_most_one("rfilter")
    properties.ignore(*FILM_SETTINGS)
    return Film(width, height, read_filter(rfilter), None if crop == defaults else crop)


def _gaussian(element: Element) -> Gaussian:
    return Gaussian(_pixels(element, "stddev", 0.5))


def _box(element: Element) -> Box:
    return Box()


def _tent(element: Element) -> Tent:
    return Tent(_pixels(element, "radius", 1.0))


def _pixels(element: Element, name: str, default: float) -> float:
    return finite(float(Properties(element).value(name, NUMBER, default)), name, NARROWEST, WIDEST)


def _sampler(element: Element) -> None:
    """A sampler does not change the expected image. `jaxdr.render` draws its own random numbers."""
    Properties(element).ignore(*SAMPLER_SETTINGS)


def _low_dynamic_range_film(element: Element) -> Film:
    """The film of Mitsuba 0.x that stores tone-mapped images for screens."""
    element.harmless("the image is linear, as of an hdrfilm: it is not tone mapped")
    return _hdr_film(element)


SENSORS: dict[str, Callable[[Element], Camera]] = {
    "perspective": _perspective,
    "thinlens": _thin_lens,
    "orthographic": _orthographic,
}
FILMS: dict[str, Callable[[Element], Film]] = {"hdrfilm": _hdr_film, "ldrfilm": _low_dynamic_range_film}
# Mitsuba's other filters (mitchell, catmullrom, lanczos) have negative lobes, so film points can't be drawn from them.
FILTERS: dict[str, Callable[[Element], ReconstructionFilter]] = {"box": _box, "gaussian": _gaussian, "tent": _tent}
SAMPLERS: dict[str, Callable[[Element], None]] = dict.fromkeys(
    ("independent", "stratified", "multijitter", "orthogonal", "ldsampler"), _sampler
)


def read_sensor(element: Element) -> Camera | None:
    """The camera of a `<sensor>`. If it can't be read, it is None, and that is noted as a problem."""
    return read_plugin(element, SENSORS, "it is left out")


def chosen_sensor(root: Element, sensors: list[Element], chosen: str | int | None) -> Element | None:
    """The sensor of a scene with an id or a number, from 0. Without a choice it is the first; None if there is none.

    Several sensors without a choice are noted as not supported. Raises ValueError for a choice that is none of them.
    """
    ids = [sensor.attributes.get("id") for sensor in sensors]
    known = [f"{i}: " + ("without id" if name is None else repr(name)) for i, name in enumerate(ids)]
    listed = ", ".join(known[:LISTED]) + (", …" if len(known) > LISTED else "")
    if chosen is None:
        for further in sensors[1:2]:
            example = next((name for name in ids if name is not None), 0)
            further.unsupported(
                f"the scene has several sensors ({listed}); choose one by its id or its number: sensor={example!r} "
                f"(--set sensor={example})",
                "the first one counts",
            )
        return sensors[0] if sensors else None
    if isinstance(chosen, int) and not isinstance(chosen, bool) and 0 <= chosen < len(sensors):
        return sensors[chosen]
    if chosen not in ids:
        raise root.error(f"there is no sensor {chosen!r}; the scene has {listed or 'none'}")
    return sensors[ids.index(str(chosen))]


def read_sampler(element: Element) -> None:
    """Check a `<sampler>`. It has no effect; an unknown one gives a warning."""
    if element.type in SAMPLERS or "type" not in element.attributes:
        read_plugin(element, SAMPLERS, "it has no effect")
    else:
        element.harmless(f"unknown type {element.type!r}: it has no effect, samples are drawn independently")


def read_film(element: Element | None) -> Film:
    """A `<film>`, or Mitsuba's default."""
    film = None if element is None else read_plugin(element, FILMS, "a film of 768 x 576 pixels takes its place")
    return Film(768, 576) if film is None else film


def read_filter(element: Element | None) -> ReconstructionFilter:
    """An `<rfilter>`, or Mitsuba's default."""
    rfilter = None if element is None else read_plugin(element, FILTERS, "a Gaussian filter takes its place")
    return Gaussian() if rfilter is None else rfilter
