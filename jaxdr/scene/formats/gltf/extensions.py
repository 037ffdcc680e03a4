"""Warnings and errors for the glTF extensions that a file uses and that are not supported here."""

from collections.abc import Iterator
from typing import Any

from jaxdr.geometry.gltf import parts
from jaxdr.geometry.gltf.document import Document
from jaxdr.scene.formats.gltf import materials
from jaxdr.scene.formats.gltf.lights import LIGHTS
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.formats.gltf.textures import IMAGES, TRANSFORM

READ = (*materials.READ, *IMAGES, TRANSFORM, LIGHTS, *parts.READ)
# Extensions that don't change the picture which a viewer shows at first.
NO_EFFECT = {
    "KHR_materials_variants": "the default materials count",
    "MSFT_lod": "the finest level counts",
    **dict.fromkeys(
        (
            *("KHR_xmp", "KHR_xmp_json_ld", "KHR_animation_pointer", "KHR_interactivity", "KHR_physics_rigid_bodies"),
            *("EXT_mesh_features", "EXT_instance_features", "EXT_structural_metadata", "EXT_feature_metadata"),
            *("KHR_implicit_shapes", "AGI_articulations", "AGI_stk_metadata", "CESIUM_primitive_outline"),
        ),
        "it has no effect",
    ),
}
# A texture whose only image has such a format is reported with its material.
NAMED_ELSEWHERE = ("KHR_texture_basisu",)


def name_unread(document: Document, problems: Problems) -> None:
    """Note every extension that is not read, with its first place. The module `materials` notes those of materials."""
    places: dict[str, list[str]] = {}
    for name, place in _used(document):
        places.setdefault(name, []).append(place)
    in_materials = {name for material in document.items("materials") for name in material.get("extensions", {})}
    known = {*READ, *NAMED_ELSEWHERE, *materials.LOBES, *in_materials}
    required = dict.fromkeys(document.header.get("extensionsRequired", []))
    for name, where in places.items():
        if name in known:
            continue
        place = where[0] + (f" and {len(where) - 1} more" if len(where) > 1 else "")
        if name in NO_EFFECT:
            problems.note(f"{place}: extension {name} is not supported; {NO_EFFECT[name]}")
        else:
            problems.leave_out(f"{place}: extension {name} is not supported; it has no effect")
    told = known | places.keys()
    for name in required:
        if name not in told and name not in NO_EFFECT:
            problems.leave_out(f"extension {name} is required; what it changes is left out")
    for name in document.header.get("extensionsUsed", []):
        if name not in told and name not in required:
            problems.note(f"extension {name} is used (extensionsUsed), and not supported")


def _used(document: Document) -> Iterator[tuple[str, str]]:
    """(extension, place) of all uses, except those directly in a material."""
    for name in document.header.get("extensions", {}):
        yield name, "the file"
    for kind, items in document.header.items():
        if not isinstance(items, list):
            continue
        for index, item in enumerate(items):
            if isinstance(item, dict):
                content = {k: v for k, v in item.items() if k != "extensions"} if kind == "materials" else item
                yield from ((name, document.label(kind, index)) for name in _inside(content))


def _inside(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        yield from value.get("extensions", {})
        for key, child in value.items():
            if key != "extras":
                yield from _inside(child)
    elif isinstance(value, list):
        for child in value:
            if isinstance(child, dict | list):
                yield from _inside(child)
