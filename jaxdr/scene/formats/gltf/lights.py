"""Lights of glTF files (KHR_lights_punctual)."""

import numpy as np

from jaxdr.geometry.gltf.document import Document, number, numbers
from jaxdr.geometry.gltf.nodes import Node
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.lights import DeltaLight, DirectionalLight, PointLight, SpotLight

LIGHTS = "KHR_lights_punctual"
QUARTER = 1.5708  # of a turn: the angles of the specification end at pi / 2, which files round


def light_at(document: Document, node: Node) -> dict | None:
    """The light of a node, if it has one."""
    if LIGHTS not in node.header.get("extensions", {}):
        return None
    with document.at(f"{node.label}: {LIGHTS}"):
        index = node.header["extensions"][LIGHTS]["light"]
        lights = document.header.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
        if not index < len(lights):
            raise ValueError(f"refers to light {index}; there are {len(lights)}")
        return lights[index]


def read_light(document: Document, node: Node, light: dict, problems: Problems) -> DeltaLight:
    """A light at its node. It shines along -z of the node, and the node's scale has no effect on it.

    The file's numbers are kept: candela become W / sr, lux W / m^2, and nits W / m^2 sr. So images are in nits.
    """
    place = f"{node.label}: {LIGHTS}"
    with document.at(place):
        power = numbers(light, "color", (1.0, 1.0, 1.0)) * number(light, "intensity", 0.0, default=1.0)
        position, along = node.to_world[:3, 3], -node.to_world[:3, 2]
        if "range" in light:
            problems.note(f"{place}: range has no effect; its light falls off only with the squared distance")
        if light["type"] == "point":
            return PointLight(position, power)
        if light["type"] == "directional":
            return DirectionalLight(along, power)
        if light["type"] == "spot":
            cone = light.get("spot", {})
            inner = number(cone, "innerConeAngle", 0.0, QUARTER, default=0.0)
            outer = number(cone, "outerConeAngle", 0.0, QUARTER, default=np.pi / 4)
            return SpotLight(position, along, power, np.degrees(outer), np.degrees(inner))
        raise ValueError(f"a light must be of type point, directional or spot, not {light['type']!r}")
