"""The kinds of the properties in the JSON of a glTF file: whole numbers, texts, objects and lists of these.

A property has the same kind wherever its name stands in the specification. The few names with two kinds are checked
where they are read, and so are ranges.
"""

from collections.abc import Callable
from typing import Any

from jaxdr.untrusted import finite, shortened, whole

NUMBERS = (
    *("buffer", "bufferView", "byteOffset", "byteLength", "byteStride", "componentType", "count", "camera", "mesh"),
    *(
        "skin",
        "scene",
        "material",
        "source",
        "sampler",
        "index",
        "texCoord",
        "magFilter",
        "minFilter",
        "wrapS",
        "wrapT",
    ),
    *("inverseBindMatrices", "light"),
)
TEXTS = ("name", "uri", "mimeType", "type", "alphaMode", "filter", "version")
SWITCHES = ("doubleSided", "normalized", "visible")
OBJECTS = (
    *("perspective", "orthographic", "spot", "pbrMetallicRoughness", "sparse", "baseColorTexture", "normalTexture"),
    *("metallicRoughnessTexture", "emissiveTexture", "occlusionTexture", "transmissionTexture", "values", "asset"),
)
OBJECT_LISTS = ("primitives", "lights")
NUMBER_LISTS = ("nodes", "children", "joints")
FLOAT_LISTS = ("weights", "baseColorFactor", "emissiveFactor")
TEXT_LISTS = ("extensionsUsed", "extensionsRequired")
# Extensions that are read. Others may use the same names for other kinds.
READ = (
    *("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "EXT_mesh_gpu_instancing"),
    *("KHR_node_visibility", "KHR_lights_punctual", "KHR_texture_transform", "EXT_texture_webp", "EXT_texture_avif"),
    *("MSFT_texture_dds", "KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular"),
    *("KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_unlit"),
)


def check_kinds(owner: dict, where: str = "") -> None:
    """Raises ValueError, with the way to the property, for a property of a wrong kind, here or further inside."""
    for name, value in owner.items():
        place = f"{where}{name}"
        if name in CHECKS:
            CHECKS[name](value, place)


def _number(value: Any, place: str) -> None:
    if type(value) is not int or value < 0:  # quick, since most are fine
        whole(value, place)


def _indices(value: Any, place: str) -> None:
    """An accessor of a primitive; or an object, in a sparse accessor."""
    (_object if place.startswith("sparse: ") else _number)(value, place)


def _text(value: Any, place: str) -> None:
    if not isinstance(value, str):
        raise ValueError(f"{place} must be a string, not {shortened(value)}")


def _switch(value: Any, place: str) -> None:
    if not isinstance(value, bool):
        raise ValueError(f"{place} must be true or false, not {shortened(value)}")


def _object(value: Any, place: str) -> None:
    if not isinstance(value, dict):
        raise ValueError(f"{place} must be an object, not {shortened(value)}")
    check_kinds(value, f"{place}: ")


def _list(value: Any, place: str, check: Callable[[Any, str], object]) -> None:
    if not isinstance(value, list):
        raise ValueError(f"{place} must be a list, not {shortened(value)}")
    for number, item in enumerate(value):
        check(item, f"{place} {number}")


def _numbers_by_name(value: Any, place: str) -> None:
    if not isinstance(value, dict):
        raise ValueError(f"{place} must be an object, not {shortened(value)}")
    for name, item in value.items():
        _number(item, f"{place}: {name}")


def _extensions(value: Any, place: str) -> None:
    if not isinstance(value, dict):
        raise ValueError(f"{place} must be an object, not {shortened(value)}")
    for name, item in value.items():
        if name in READ:
            _object(item, name)


CHECKS: dict[str, Callable[[Any, str], None]] = {
    **dict.fromkeys(NUMBERS, _number),
    **dict.fromkeys(TEXTS, _text),
    **dict.fromkeys(SWITCHES, _switch),
    **dict.fromkeys(OBJECTS, _object),
    **dict.fromkeys(OBJECT_LISTS, lambda value, place: _list(value, place, _object)),
    **dict.fromkeys(TEXT_LISTS, lambda value, place: _list(value, place, _text)),
    **dict.fromkeys(NUMBER_LISTS, lambda value, place: _list(value, place, _number)),
    **dict.fromkeys(FLOAT_LISTS, lambda value, place: _list(value, place, finite)),
    "indices": _indices,
    "attributes": _numbers_by_name,
    "targets": lambda value, place: _list(value, place, _numbers_by_name),
    "extensions": _extensions,
}
