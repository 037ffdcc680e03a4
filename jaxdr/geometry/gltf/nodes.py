"""The tree of nodes of a glTF file: their matrices to the world, and their instances."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.gltf.accessors import read_accessor
from jaxdr.geometry.gltf.document import Document, numbers, whole
from jaxdr.untrusted import LARGEST

INSTANCING = "EXT_mesh_gpu_instancing"
PARTS = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}  # of the transform of an instance
VISIBILITY = "KHR_node_visibility"
Matrix = Float[np.ndarray, "4 4"]


@dataclasses.dataclass
class Node:
    """A node of the scene, with its node-to-world matrix; `label` is its name in messages."""

    header: dict
    to_world: Matrix
    label: str


def scene_nodes(document: Document, places: list[Matrix]) -> list[Node]:
    """The visible nodes of the file's default scene, parents first; `places` is the result of `world_matrices`."""
    nodes = document.items("nodes")
    if "scenes" in document.header:
        scene = document.item("scenes", document.header.get("scene", 0), "scene")
        roots = scene.get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [index for index in range(len(nodes)) if index not in children]
    found, waiting, seen = [], list(reversed(roots)), set()
    while waiting:
        index = waiting.pop()
        header = document.item("nodes", index, "scene")
        if index in seen:
            raise document.error("scene", f"{document.label('nodes', index)} is in it twice")
        seen.add(index)
        if not header.get("extensions", {}).get(VISIBILITY, {}).get("visible", True):
            continue  # leave out the nodes below it as well
        found.append(Node(header, places[index], document.label("nodes", index)))
        waiting += reversed(header.get("children", []))
    return found


def world_matrices(document: Document) -> list[Matrix]:
    """The node-to-world matrices of all nodes. Raises `GltfError` for a node with two parents, or below itself."""
    nodes = document.items("nodes")
    parent: dict[int, int] = {}
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            document.item("nodes", child, document.label("nodes", index))
            if child in parent:
                raise document.error(document.label("nodes", child), "it has two parents")
            parent[child] = index
    order, below = [], [index for index in range(len(nodes)) if index not in parent]
    while below:
        order.append(below.pop())
        below += nodes[order[-1]].get("children", [])
    if len(order) < len(nodes):
        stuck = min(set(range(len(nodes))) - set(order))
        raise document.error(document.label("nodes", stuck), "it is below itself: its parents form a cycle")
    own, places = _own_matrices(document), [np.eye(4)] * len(nodes)
    with np.errstate(all="ignore"):  # what is too large is told below
        for index in order:
            places[index] = places[parent[index]] @ own[index] if index in parent else own[index]
    if places:
        _check_sizes(document, np.stack(places))
    return places


def _check_sizes(document: Document, places: Float[np.ndarray, "n 4 4"]) -> None:
    wrong = np.flatnonzero(~(np.abs(places) <= LARGEST).all((1, 2)))  # NaN, too
    if len(wrong):
        label = document.label("nodes", int(wrong[0]))
        raise document.error(label, f"its transform has numbers beyond {LARGEST:g}, with those of its parents")


def instance_matrices(document: Document, node: Node) -> Float[np.ndarray, "n 4 4"]:
    """The mesh-to-world matrices of a node: one matrix, or one for each instance (EXT_mesh_gpu_instancing)."""
    extension = node.header.get("extensions", {}).get(INSTANCING)
    if extension is None:
        return node.to_world[None]
    place = f"{node.label}: {INSTANCING}"
    with document.at(place):
        check_instances(document, extension["attributes"])
        found = {
            name: read_accessor(document, extension["attributes"][name], f"{place}: {name}", kind).astype(float)
            for name, kind in PARTS.items()
            if name in extension["attributes"]
        }
        if not all((np.abs(values) <= LARGEST).all() for values in found.values()):
            raise ValueError(f"has numbers that are not finite, or beyond {LARGEST:g}")
        count = len(next(iter(found.values())))
        still, upright, full = np.zeros((count, 3)), np.tile([0, 0, 0, 1.0], (count, 1)), np.ones((count, 3))
        return node.to_world @ placements(
            found.get("TRANSLATION", still), found.get("ROTATION", upright), found.get("SCALE", full)
        )


def check_instances(document: Document, attributes: dict) -> int:
    """The number of instances; only the JSON is read. Raises ValueError unless the attributes agree, and have data."""
    found = [document.item("accessors", attributes[name], name) for name in PARTS if name in attributes]
    counts = {whole(accessor, "count") for accessor in found}
    if len(counts) != 1:
        raise ValueError("TRANSLATION, ROTATION and SCALE must be there for the same number of instances")
    if not any("bufferView" in accessor for accessor in found):
        raise ValueError(f"its {counts.pop()} instances have no data: no accessor has a bufferView")
    return counts.pop()


def placements(
    translation: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "n 4"], scale: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 4 4"]:
    """Matrices translation · rotation (quaternions x, y, z, w) · scale. Raises ValueError for zero quaternions."""
    length = np.linalg.norm(rotation, axis=1, keepdims=True)
    if not (length > 0).all():
        raise ValueError("a rotation is the zero quaternion")
    x, y, z, w = (rotation / length).T
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrices = np.tile(np.eye(4), (len(x), 1, 1))
    matrices[:, :3, :3] = np.moveaxis(turned, 2, 0) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    return matrices


def _own_matrices(document: Document) -> list[Matrix]:
    """The matrix of every node: its `matrix` (stored by columns), or its translation, rotation and scale."""
    nodes, parts = (
        document.items("nodes"),
        {"translation": (0.0, 0, 0), "rotation": (0.0, 0, 0, 1), "scale": (1.0, 1, 1)},
    )
    found = {name: np.empty((len(nodes), len(default))) for name, default in parts.items()}
    matrices: dict[int, Matrix] = {}
    for index, node in enumerate(nodes):
        with document.at(document.label("nodes", index)):
            for name, default in parts.items():
                found[name][index] = numbers(node, name, default)
            if not any(found["rotation"][index]):
                raise ValueError("its rotation is the zero quaternion")
            if "matrix" in node:
                matrices[index] = numbers(node, "matrix", (0.0,) * 16).reshape(4, 4).T
    return list((dict(enumerate(placements(**found))) | matrices).values())


def named(nodes: list[Node], key: str) -> Iterator[tuple[Node, int]]:
    """The nodes that refer to something, such as a "mesh", with its number."""
    return ((node, node.header[key]) for node in nodes if key in node.header)
