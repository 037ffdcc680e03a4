"""Scene files of Mitsuba 0.x as those of Mitsuba 3: the changes that Mitsuba 3 itself makes when it reads them."""

import re

from jaxdr.scene.mitsuba_element import Element

UV_SETTINGS = {"uoffset": 0.0, "voffset": 0.0, "uscale": 1.0, "vscale": 1.0}


def upgrade(element: Element) -> None:
    """Rewrite an element and all of the same file inside it, in place.

    Names become snake_case (`maxDepth`, `intIOR`); a diffuse BSDF's colour `reflectance`; `uscale`, … a transform;
    `<lookAt>` is `<lookat>`.
    """
    if "name" in element.attributes:
        element.attributes["name"] = snake_case(element.attributes["name"])
    if element.tag == "lookAt":
        element.tag = "lookat"
    for child in element.children:
        if child.file == element.file:
            upgrade(child)
    if element.tag == "bsdf" and element.attributes.get("type") == "diffuse":
        for child in element.children:
            if child.attributes.get("name") == "diffuse_reflectance":
                child.attributes["name"] = "reflectance"
    if element.tag == "texture":
        _upgrade_uvs(element)


def snake_case(name: str) -> str:
    """`intIOR` -> `int_ior`; capitals in a row are one word."""
    return re.sub(r"(?<=[a-z])[A-Z]+", lambda capitals: "_" + capitals[0].lower(), name)


def _upgrade_uvs(texture: Element) -> None:
    given = {child.attributes.get("name"): child for child in texture.children if child.tag == "float"}
    given = {name: child for name, child in given.items() if name in UV_SETTINGS}
    if not given:
        return
    texture.children[:] = [child for child in texture.children if child not in given.values()]
    text = {name: str(default) for name, default in UV_SETTINGS.items()}
    text |= {name: child.attributes.get("value", "") for name, child in given.items()}
    place = next(iter(given.values()))

    def made(tag: str, attributes: dict[str, str], children: list[Element]) -> Element:
        return Element(tag, attributes, place.file, place.line, children, texture.problems, texture.folders)

    steps = [
        made("translate", {"x": text["uoffset"], "y": text["voffset"]}, []),
        made("scale", {"x": text["uscale"], "y": text["vscale"]}, []),
    ]
    texture.children.append(made("transform", {"name": "to_uv"}, steps))
