"""How much memory the triangles of a glTF file take. Nodes and instances may repeat a mesh of few bytes very often.

Only the JSON is read. What its accessors promise is compared with the bytes that are there when they are read.
"""

from jaxdr.geometry.gltf.compression import DRACO
from jaxdr.geometry.gltf.document import Document, whole
from jaxdr.geometry.gltf.nodes import INSTANCING, Node, check_instances, named
from jaxdr.geometry.gltf.primitives import TRIANGLES, is_triangles
from jaxdr.untrusted import check_memory

MAKING, KEEPING = 200, 30  # bytes for a corner of a triangle: while a mesh is made (measured), and afterwards


def check_size(document: Document, nodes: list[Node]) -> None:
    """Raises ValueError if the triangles of these nodes and their instances take more memory than there is."""
    corners: dict[int, int] = {}
    total = largest = 0
    for node, index in named(nodes, "mesh"):
        if index not in corners:
            mesh, label = document.item("meshes", index, node.label), document.label("meshes", index)
            with document.at(label):
                corners[index] = sum(_corners(document, primitive, label) for primitive in mesh["primitives"])
        found = corners[index] * _instances(document, node)
        total, largest = total + found, max(largest, found)
    with document.at("the triangles of all nodes and instances"):
        check_memory(MAKING * largest + KEEPING * total, f"{total} corners")


def _corners(document: Document, primitive: dict, label: str) -> int:
    if not is_triangles(primitive):
        return 0
    accessor = document.item("accessors", primitive.get("indices", primitive["attributes"]["POSITION"]), label)
    count = whole(accessor, "count")
    if "bufferView" not in accessor and DRACO not in primitive.get("extensions", {}):
        with document.at(f"{label}: its positions or indices"):
            document.check_values_without_data(count)
    return count * (1 if primitive.get("mode", TRIANGLES) == TRIANGLES else 3)


def _instances(document: Document, node: Node) -> int:
    extension = node.header.get("extensions", {}).get(INSTANCING)
    if extension is None:
        return 1
    with document.at(f"{node.label}: {INSTANCING}"):
        return check_instances(document, extension["attributes"])
