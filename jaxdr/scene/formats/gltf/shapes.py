"""Shapes of glTF files: the primitives of meshes, where nodes place them."""

import itertools
from collections.abc import Iterable

import numpy as np

from jaxdr.geometry.gltf.accessors import read_accessor
from jaxdr.geometry.gltf.compression import DRACO
from jaxdr.geometry.gltf.document import Document
from jaxdr.geometry.gltf.nodes import Matrix, Node, instance_matrices, named
from jaxdr.geometry.gltf.primitives import is_triangles, joint_matrices, read_primitive, skinned
from jaxdr.geometry.mesh import Mesh
from jaxdr.scene.formats.gltf.materials import Materials
from jaxdr.scene.formats.gltf.meshes import Geometry, Placer, mirrored_uvs, welded
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.formats.gltf.textures import chosen_uv_set, usable_textures
from jaxdr.scene.scene import RESERVED, Shape


class Shapes:
    """Reads the shapes of a file. A primitive that several nodes show is read once."""

    def __init__(self, document: Document, problems: Problems, places: list[Matrix]):
        self.document, self.problems = document, problems
        self.materials, self.placer = Materials(document, problems), Placer()
        self._places = places
        self._geometries: dict[tuple, Geometry] = {}

    def read(self, nodes: list[Node]) -> dict[str, Shape]:
        """The shapes of all nodes by name."""
        names, found = Names(RESERVED), {}
        for node, index in named(nodes, "mesh"):
            mesh = self.document.item("meshes", index, node.label)
            wanted = node.header.get("name") or mesh.get("name") or f"mesh_{index}"
            places = instance_matrices(self.document, node)
            for number, primitive in enumerate(mesh["primitives"]):
                label = f"{self.document.label('meshes', index)}, primitive {number}"
                if is_triangles(primitive):
                    with self.document.at(label):
                        shape = self._shape(node, mesh, (index, number), places, label)
                    if shape is not None:
                        found[names.free(wanted)] = shape
        return found

    def _shape(self, node: Node, mesh: dict, key: tuple[int, int], places: np.ndarray, label: str) -> Shape | None:
        """The shape of a primitive at the places of a node; None if there is nothing to see."""
        primitive = mesh["primitives"][key[1]]
        geometry = self._geometry(node, mesh, key, label)
        placed = (
            None if geometry is None else self._mesh(geometry, np.eye(4)[None] if "skin" in node.header else places)
        )
        if geometry is None or placed is None:
            self.problems.note(f"{label}: none of its faces has an area; it is left out")
            return None
        colors = geometry.colors
        if colors is None and "COLOR_0" in primitive["attributes"]:
            colors = shared_color(self.document, primitive, label)
        elif colors is not None and len(places) > 1:
            colors = np.tile(colors, (len(places), 1))
        flip = self._mirrors(primitive, placed, label)
        bsdf, emitter = self.materials.make(primitive.get("material"), primitive["attributes"], colors, flip)
        return None if bsdf is None else Shape(placed, bsdf, emitter)

    def _geometry(self, node: Node, mesh: dict, key: tuple[int, int], label: str) -> Geometry | None:
        """The triangles of a primitive in the pose that a node gives it; None if it has none."""
        primitive, skin = mesh["primitives"][key[1]], node.header.get("skin")
        weights = node.header.get("weights", mesh.get("weights"))
        whole_key = (*key, tuple(weights or ()), skin)
        if whole_key not in self._geometries:
            stored = read_primitive(self.document, primitive, label, weights)
            if not len(stored.faces):
                return None
            positions = stored.attributes["POSITION"]
            if skin is not None:
                joints = joint_matrices(self.document, skin, self._places, node.label)
                positions = skinned(self.document, stored, joints)
            material = material_of(self.document, primitive)
            uv_set = chosen_uv_set(self.document, material, primitive["attributes"])
            channels = _color_channels(self.document, primitive, material, label)
            self._geometries[whole_key] = welded(stored, positions, uv_set, channels)
        return self._geometries[whole_key]

    def _mesh(self, geometry: Geometry, places: np.ndarray) -> Mesh | None:
        """The mesh at these places; None if none of its faces has an area."""
        try:
            return self.placer.mesh(geometry, places)
        except ValueError as error:
            if "has an area" in str(error):
                return None
            raise

    def _mirrors(self, primitive: dict, placed: Mesh, label: str) -> bool:
        """Whether the normal map of a primitive is mirrored on more than half of its faces."""
        material = material_of(self.document, primitive)
        if "normalTexture" not in usable_textures(self.document, material, primitive["attributes"]):
            return False
        mirrored = mirrored_uvs(placed)
        if 0 < mirrored < 1:
            share = min(mirrored, 1 - mirrored)
            self.problems.note(
                f"{label}: its normal map is mirrored on {share:.0%} of the faces, where y is turned over"
            )
        return mirrored > 0.5


class Names:
    """Names of shapes and lights. Each is given once; a number makes a repeated name unique."""

    def __init__(self, taken: Iterable[str]):
        self._taken: set[str] = set(taken)
        self._next: dict[str, itertools.count] = {}

    def free(self, wanted: str) -> str:
        """The wanted name, or one with a number if that is taken. The name is taken from now on."""
        stem = wanted.replace(".", "_")  # a dot separates the parts of a parameter's name
        if stem not in self._taken:
            self._taken.add(stem)
            return stem
        counter = self._next.setdefault(stem, itertools.count(1))
        name = next(name for number in counter if (name := f"{stem}_{number}") not in self._taken)
        self._taken.add(name)
        return name


def material_of(document: Document, primitive: dict) -> dict:
    """The material of a primitive; an empty dictionary is the default material."""
    return document.item("materials", primitive["material"], "a primitive") if "material" in primitive else {}


def _color_channels(document: Document, primitive: dict, material: dict, label: str) -> int:
    """How many channels of COLOR_0 the mesh of a primitive needs at its vertices."""
    attributes = primitive["attributes"]
    if "COLOR_0" not in attributes:
        return 0
    if shared_color(document, primitive, label) is not None:
        return 0
    has_alpha = document.item("accessors", attributes["COLOR_0"], label)["type"] == "VEC4"
    return 4 if has_alpha and material.get("alphaMode", "OPAQUE") != "OPAQUE" else 3


def shared_color(document: Document, primitive: dict, label: str) -> np.ndarray | None:
    """The colour that all vertices share; None if they differ, or if they would have to be decompressed to tell."""
    if DRACO in primitive.get("extensions", {}):
        return None
    colors = read_accessor(document, primitive["attributes"]["COLOR_0"], f"{label}: COLOR_0", "VEC3", "VEC4")
    return colors[0] if (colors == colors[0]).all() else None
