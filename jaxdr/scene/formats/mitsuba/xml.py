"""Reading one element of a Mitsuba 3 scene file: its named values, its nested objects, and its plugin.

A plugin is a function from an element to its object. Plugins are in dictionaries by type, one in each file (`SHAPES`,
`BSDFS`, `EMITTERS`, `SENSORS`, …). `read_plugin` looks a plugin up, and makes sure that nothing is ignored silently.
"""

import difflib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from jaxdr.scene.formats.mitsuba.element import Element, SceneFileError
from jaxdr.scene.formats.mitsuba.values import VALUES

T = TypeVar("T")

OBJECT_TAGS = (
    *("bsdf", "emitter", "film", "integrator", "medium", "phase", "rfilter", "sampler", "sensor", "shape"),
    *("texture", "volume"),
)
TEXTURE_TAGS = ("texture", "spectrum")  # a <spectrum> with a type is a texture

NO_PICTURE = ("film", "integrator", "sampler")  # unknown parameters of these don't change what the image shows
NUMBER = "float integer"
COLORS = ("rgb", "spectrum")
COLOR = f"rgb spectrum {NUMBER}"


# For some types that are not supported, the reason and a remedy.
REASONS = {
    "null": "a surface that rays pass through is the border of a medium, and media are not supported",
    **dict.fromkeys(
        ("sunsky", "sky", "sun"),
        "models of the sky are not supported; write the sky into an image and give that as an 'envmap'",
    ),
    **dict.fromkeys(("homogeneous", "heterogeneous"), "participating media are not supported"),
    **dict.fromkeys(("bsplinecurve", "linearcurve"), "curves are not supported; convert them to meshes"),
    **dict.fromkeys(("sdfgrid", "ellipsoids", "ellipsoidsmesh"), "only meshes are supported; convert it to one"),
    **dict.fromkeys(
        ("pplastic", "polarizer", "retarder", "circular", "measured_polarized"),
        "polarisation is not supported, and without it this is none of the other BSDFs",
    ),
}


def read_plugin(element: Element, plugins: Mapping[str, Callable[[Element], T]], instead: str) -> T | None:
    """The object that the plugin of the element's type makes.

    It is None if the type is unknown, a value is wrong, or the plugin raises ValueError. That is added to the element's
    problems, and so is everything that the plugin did not read. `instead` says what happens if an unknown type is
    ignored.

    An element is read once, however many refer to it, so that they share the object. Only what depends on the
    attributes of a mesh is made for each mesh.
    """
    try:
        if "type" not in element.attributes:
            raise element.error("attribute 'type' is missing")
        if element.type not in plugins:
            known = REASONS.get(element.type, f"known: {', '.join(plugins) or 'none'}")
            element.unsupported(f"unknown type {element.type!r}; {known}", instead)
            return None
        plugin = plugins[element.type]
        if element.made.get(plugin) and not element.needs_mesh:
            return element.made[plugin][0]
        element.properties = None
        with element.located():
            result = plugin(element)
        (element.properties or Properties(element)).finish()
    except SceneFileError as error:
        element.problems.add(element, str(error))
        return None
    if element.vertex_data is not None or not element.needs_mesh:  # outside of a mesh its attributes are stand-ins
        element.made.setdefault(plugin, []).append(result)
    return result


class Properties:
    """The named values and the nested objects of an object element, such as `<shape type="ply" id="spot">`.

    Both are taken one by one. `finish` notes those that nothing took, so that nothing is ignored silently.
    """

    def __init__(self, element: Element):
        self.element = element
        element.properties = self
        element.check_attributes((() if element.tag == "scene" else ("type",)), ("id", "name"))
        self.type = element.type
        self._values: dict[str, Element] = {}
        self._objects: list[Element] = []
        self._asked: set[str] = set()
        for child in element.children:
            if child.tag in OBJECT_TAGS or (child.tag in TEXTURE_TAGS and "type" in child.attributes):
                self._objects.append(child)
            elif child.tag not in VALUES:
                child.unsupported("unknown element", "it is left out")
            elif child.attributes.get("name") in self._values:
                raise child.error(f"a second parameter {child.attributes['name']!r} in one <{element.tag}>")
            else:
                child.check_attributes(("name",), tuple(child.attributes))
                self._values[child.attributes["name"]] = child

    def value(self, name: str, tags: str, default: Any = None, read: Callable[[Element], Any] | None = None) -> Any:
        """Take a value whose element has one of the space-separated `tags`; the `default` if there is none.

        `read` converts the element, in place of the function in `VALUES`.
        """
        self._asked.add(name)
        texture = self.texture(name)
        if texture is not None:
            texture.unsupported(f"a texture can't give {name!r} here; give a constant", "the default is used")
        if name not in self._values:
            return default
        element = self._values.pop(name)
        if element.tag in COLORS and tags == NUMBER and read is None:
            return float(np.mean(self._read(element, COLOR, None)))  # as Mitsuba does
        return self._read(element, tags, read)

    def _read(self, element: Element, tags: str, read: Callable[[Element], Any] | None) -> Any:
        name = element.attributes["name"]
        if element.tag not in tags.split():
            raise element.error(f"parameter {name!r} must be given by <{'> or <'.join(tags.split())}>")
        if element.tag == "spectrum" and "filename" in element.attributes:
            element.check_attributes(("name", "filename"))
        elif element.tag not in ("point", "vector"):
            element.check_attributes(("name",) if element.tag == "transform" else ("name", "value"))
        if element.tag != "transform" and element.children:
            raise element.children[0].error(f"unexpected inside <{element.tag}>")
        with element.located():
            return (read or VALUES[element.tag])(element)

    def tag(self, name: str) -> str | None:
        """The tag of a value that is not taken yet; None if there is none."""
        return self._values[name].tag if name in self._values else None

    def ignore(self, *names: str) -> None:
        """Take values that don't change the expected image."""
        self._asked.update(names)
        for name in names:
            self._values.pop(name, None)

    def texture(self, name: str) -> Element | None:
        """Take the nested texture of this name, if there is one."""
        self._asked.add(name)
        for child in self._objects:
            if child.tag in TEXTURE_TAGS and child.attributes.get("name") == name:
                self._objects.remove(child)
                child.vertex_data = self.element.vertex_data
                return child
        return None

    def objects(self, *tags: str) -> list[Element]:
        """Take all nested objects with one of these tags."""
        taken = [child for child in self._objects if child.tag in tags]
        self._objects = [child for child in self._objects if child.tag not in tags]
        for child in taken:
            child.vertex_data = self.element.vertex_data
        return taken

    def at_most_one(self, *tags: str) -> Element | None:
        """Take the nested object with one of these tags, if there is one. A second one is not supported."""
        taken = self.objects(*tags)
        for further in taken[1:]:
            further.unsupported(f"a second one in one <{self.element.tag}>", "the first one counts")
        return taken[0] if taken else None

    def finish(self) -> None:
        """Note every value and object that nothing took."""
        owner = f"{self.element.tag} {self.type!r}"
        for name, element in self._values.items():
            close = difflib.get_close_matches(name, self._asked, 1, 0.8)
            if self.element.tag in NO_PICTURE and not close:
                element.harmless(f"unknown parameter {name!r} of {owner}: it has no effect")
                continue
            known = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(sorted(self._asked)) or 'none'}"
            element.unsupported(f"unknown parameter {name!r} of {owner}; {known}", "it has no effect")
        for element in self._objects:
            if element.tag in ("medium", "phase", "volume"):
                element.unsupported("participating media are not supported", "it is left out: space is empty")
            else:
                element.unsupported(f"not supported inside {owner}", "it is left out")
        self._values, self._objects = {}, []
