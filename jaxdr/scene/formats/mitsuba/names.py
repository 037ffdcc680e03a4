"""Names of the shapes and lights of a Mitsuba 3 scene file. Names of parameters begin with them."""

import itertools
from collections.abc import Collection

from jaxdr.scene.formats.mitsuba.element import Element
from jaxdr.scene.scene import RESERVED


def object_names(elements: list[Element], others: Collection[str] = ()) -> list[str]:
    """Ids of elements; without an id, the type and the first free number (`cube`, `cube_1`, …). `others` are taken."""
    taken = {element.attributes.get("id") for element in elements} | set(others)
    following: dict[str, int] = {}  # the next number to try, by type
    names = []
    for element in elements:
        name = element.attributes.get("id")
        if name is None:
            tried = itertools.count(following.get(element.type, 0))
            i, name = next((i, n) for i in tried if (n := f"{element.type}_{i}" if i else element.type) not in taken)
            following[element.type] = i + 1
            taken.add(name)
        names.append(name)
    return names


def parameter_name(element: Element, name: str) -> str:
    """The name, if names of parameters may begin with it. Otherwise another one, which is noted as a problem."""
    if name and "." not in name and name not in RESERVED:
        return name
    kind = "shape" if element.tag == "shape" else "light"
    other = name.replace(".", "_") + ("" if "." in name else f"_{kind}")
    rule = f"not empty, no dots, not {' or '.join(RESERVED)}"
    element.unsupported(f"id {name!r} can't name a {kind} ({rule}); give it another", f"it is called {other!r}")
    return other
