"""All triangles of a glTF file in world space, in the file's default pose."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.gltf.compression import DRACO, MESHOPT
from jaxdr.geometry.gltf.document import Document
from jaxdr.geometry.gltf.nodes import INSTANCING, VISIBILITY, instance_matrices, named, scene_nodes, world_matrices
from jaxdr.geometry.gltf.primitives import is_triangles, joint_matrices, read_primitive, skinned
from jaxdr.geometry.gltf.sizes import check_size
from jaxdr.untrusted import LARGEST

QUANTIZATION = "KHR_mesh_quantization"  # needs no code: accessors of any type are read
READ = (DRACO, *MESHOPT, INSTANCING, VISIBILITY, QUANTIZATION)
NOT_OF_MESHES = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_")


class StoredPart(NamedTuple):
    """A primitive at a node: world positions, faces, UVs with v upwards, and stored world normals of any length.

    `colored`: whether its material or its vertices have a colour.
    """

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "V 2"] | None
    normals: Float[np.ndarray, "V 3"] | None
    colored: bool


def read_stored_parts(path: Path) -> Iterator[StoredPart]:
    """The triangles of all primitives of all nodes and their instances; points and lines are left out.

    Raises ValueError for a damaged file, with the place in it, and for unknown extensions that the file requires.
    """
    document = Document(path)
    with document.at("the JSON"):
        for name in document.header.get("extensionsRequired", []):
            if name not in READ and not name.startswith(NOT_OF_MESHES):
                raise ValueError(f"extension {name} is required, and not supported")
        places = world_matrices(document)
        nodes = scene_nodes(document, places)
        check_size(document, nodes)
        for node, index in named(nodes, "mesh"):
            mesh = document.item("meshes", index, node.label)
            weights = node.header.get("weights", mesh.get("weights"))
            instances = instance_matrices(document, node)
            for number, primitive in enumerate(mesh["primitives"]):
                label = f"{document.label('meshes', index)}, primitive {number}"
                with document.at(label):
                    if not is_triangles(primitive):
                        continue
                    stored = read_primitive(document, primitive, label, weights)
                    positions, matrices = stored.attributes["POSITION"].astype(float), instances
                    if "skin" in node.header:
                        joints = joint_matrices(document, node.header["skin"], places, node.label)
                        positions, matrices = skinned(document, stored, joints), np.eye(4)[None]
                    for matrix in matrices if len(stored.faces) else ():
                        yield _placed(stored.attributes, positions, stored.faces, matrix, _colored(document, primitive))


def _colored(document: Document, primitive: dict) -> bool:
    if "COLOR_0" in primitive["attributes"]:
        return True
    material = document.item("materials", primitive["material"], "a primitive") if "material" in primitive else {}
    surface = material.get("pbrMetallicRoughness", {})
    white = surface.get("baseColorFactor", [1, 1, 1])[:3] == [1, 1, 1]
    return not white or "baseColorTexture" in surface or any(material.get("emissiveFactor", []))


def _placed(
    attributes: dict, positions: np.ndarray, faces: np.ndarray, matrix: np.ndarray, colored: bool
) -> StoredPart:
    """The primitive in world space, with the vertices that its faces use. A matrix that mirrors reverses the faces."""
    used, faces = np.unique(faces, return_inverse=True)
    faces, linear, positions = faces.reshape(-1, 3), matrix[:3, :3], positions[used]
    uvs, normals = (None if name not in attributes else attributes[name][used] for name in ("TEXCOORD_0", "NORMAL"))
    placed = positions @ linear.T + matrix[:3, 3]
    if not (np.abs(placed) <= LARGEST).all():
        raise ValueError(f"its vertices go beyond {LARGEST:g} where its node puts them")
    return StoredPart(
        placed,
        faces[:, ::-1] if np.linalg.det(linear) < 0 else faces,
        None if uvs is None else uvs.astype(float) * (1, -1) + (0, 1),
        None if normals is None else normals.astype(float) @ np.linalg.pinv(linear),
        colored,
    )
