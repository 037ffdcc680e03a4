"""Primitives of glTF meshes: triangles and attributes of their vertices, in the file's default pose."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxdr.geometry.gltf.accessors import SIZES, normalized, read_accessor, read_indices
from jaxdr.geometry.gltf.compression import DRACO, draco_mesh, has_draco
from jaxdr.geometry.gltf.document import Document
from jaxdr.untrusted import LARGEST, damage, whole

TRIANGLES, STRIP, FAN = 4, 5, 6  # lower modes are points and lines
# The types of attributes, by name without its number.
TYPES = {
    "POSITION": ("VEC3",),
    "NORMAL": ("VEC3",),
    "TEXCOORD": ("VEC2",),
    "COLOR": ("VEC3", "VEC4"),
    "JOINTS": ("VEC4",),
    "WEIGHTS": ("VEC4",),
}


@dataclasses.dataclass
class Primitive:
    """A primitive: its `attributes` [V, k] by name, and its `faces`; `label` is its name in messages."""

    header: dict
    attributes: dict[str, np.ndarray]
    faces: Int[np.ndarray, "F 3"]
    label: str


def is_triangles(primitive: dict) -> bool:
    """Whether a primitive has triangles, rather than points or lines. Raises ValueError for an unknown mode."""
    return whole(primitive.get("mode", TRIANGLES), "mode", 0, FAN) in (TRIANGLES, STRIP, FAN)


def read_primitive(
    document: Document, primitive: dict, label: str, weights: Sequence[float | int] | None = None
) -> Primitive:
    """The attributes and triangles of a primitive; `weights` are those of its morph targets."""
    names = [name for name in primitive["attributes"] if name.partition("_")[0] in TYPES]
    if "POSITION" not in names:
        raise document.error(label, "it has no POSITION")
    found, faces = _draco(document, primitive, label) or ({}, None)
    for name in names:
        if name not in found:
            found[name] = _attribute(document, primitive["attributes"][name], name, f"{label}: {name}")
    count = len(found["POSITION"])
    for name, values in found.items():
        if len(values) != count:
            raise document.error(label, f"{name} has {len(values)} values for {count} vertices")
        if not np.isfinite(values).all():
            raise document.error(label, f"{name} has values that are not finite")
    found["POSITION"] = np.asarray(found["POSITION"], np.result_type(found["POSITION"], np.float32))
    _morph(document, primitive, found, label, weights)
    if not (np.abs(found["POSITION"]) <= LARGEST).all():
        raise document.error(label, f"POSITION has values beyond {LARGEST:g}")
    if faces is None:
        with document.at(label):
            rows = primitive.get("indices")
            indices = np.arange(count) if rows is None else read_indices(document, rows, f"{label}: indices")
            faces = triangles(indices, primitive.get("mode", TRIANGLES))
    if len(faces) and faces.max() >= count:
        raise document.error(label, f"its indices go up to {faces.max()}; there are {count} vertices")
    return Primitive(primitive, found, faces, label)


def triangles(indices: Int[np.ndarray, " n"], mode: int) -> Int[np.ndarray, "F 3"]:
    """The faces of a list, a strip or a fan. Degenerate faces, which only connect parts of a strip, are left out."""
    if mode == TRIANGLES:
        if len(indices) % 3:
            raise ValueError(f"has {len(indices)} corners of triangles, which is not a multiple of 3")
        return indices.reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == FAN:
        faces = np.stack([indices[1:-1], indices[2:], np.full(len(indices) - 2, indices[0])], 1)
    else:
        faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], 1)
        faces[1::2, 1:] = faces[1::2, :0:-1]  # every second face has the opposite orientation
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return faces[distinct]


def _attribute(document: Document, index: Any, name: str, place: str) -> np.ndarray:
    accessor = document.item("accessors", index, place)
    if name == "POSITION" and not {"bufferView", "sparse"} & accessor.keys():
        raise document.error(place, f"accessor {index} has no data; an extension that is not read may hold it")
    return read_accessor(document, index, place, *TYPES[name.partition("_")[0]])


def _draco(document: Document, primitive: dict, label: str) -> tuple[dict, np.ndarray] | None:
    """(attributes, faces) of a primitive's Draco data; None without it.

    Also None without DracoPy if the file has the same data uncompressed.
    """
    extension = primitive.get("extensions", {}).get(DRACO)
    if extension is None:
        return None
    with document.at(f"{label}: {DRACO}"):
        if not has_draco():
            if "bufferView" in document.items("accessors")[primitive["attributes"]["POSITION"]]:
                return None
            raise ValueError(
                'it is compressed, and the package DracoPy is missing; pip install -e ".[gltf]", or decompress the '
                "file with another tool"
            )
        data = bytes(document.view(extension["bufferView"], label))
        with damage("its data can't be decoded"):  # DracoPy has its own exceptions
            attributes, faces = draco_mesh(extension, data)
        accessors = {name: document.item("accessors", primitive["attributes"][name], label) for name in attributes}
        for name, values in attributes.items():
            if values.ndim != 2 or values.shape[1] not in _sizes(name):
                raise ValueError(f"its {name} has a shape of {list(values.shape)}")
        return {name: normalized(accessors[name], values) for name, values in attributes.items()}, faces


def _sizes(name: str) -> tuple[int, ...]:
    """How many numbers a value of this attribute may have."""
    return tuple(SIZES[kind] for kind in TYPES.get(name.partition("_")[0], tuple(SIZES)))


def _morph(document: Document, primitive: dict, found: dict, label: str, weights: Sequence[float | int] | None) -> None:
    """Add the weighted offsets of the morph targets. Normals have none: they are computed from the vertices."""
    targets = primitive.get("targets", [])
    if not targets or weights is None or not any(weights):
        return
    if len(weights) != len(targets):
        raise document.error(label, f"there are {len(weights)} weights for {len(targets)} morph targets")
    for number, (target, weight) in enumerate(zip(targets, weights, strict=True)):
        for name, index in target.items():
            kind = name.partition("_")[0]
            if not weight or name not in found or kind not in ("POSITION", "TEXCOORD", "COLOR"):
                continue
            offsets = read_accessor(document, index, f"{label}: target {number}: {name}", *TYPES[kind])
            if offsets.shape != found[name].shape:
                raise document.error(label, f"target {number}: {name} does not fit the primitive's own")
            found[name] = found[name] + weight * offsets.astype(float)


def skinned(document: Document, primitive: Primitive, joints: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "V 3"]:
    """World positions of a skinned primitive; `joints` are its joint matrices: joint to world times inverse bind."""
    attributes = primitive.attributes
    sets = [name.removeprefix("JOINTS_") for name in attributes if name.startswith("JOINTS_")]
    if not sets or any(f"WEIGHTS_{number}" not in attributes for number in sets):
        raise document.error(primitive.label, "it has a skin, and no JOINTS_0 and WEIGHTS_0")
    rows = np.concatenate([attributes[f"JOINTS_{number}"] for number in sets], 1).astype(np.int64)
    weights = np.concatenate([attributes[f"WEIGHTS_{number}"] for number in sets], 1).astype(float)
    if rows.max() >= len(joints):
        raise document.error(primitive.label, f"JOINTS go up to {rows.max()}; its skin has {len(joints)} joints")
    total = weights.sum(1, keepdims=True)
    if not (total > 0).all():
        raise document.error(primitive.label, "WEIGHTS are all zero at a vertex")
    blended = np.einsum("vj,vjkl->vkl", weights / total, joints[rows][:, :, :3])
    return np.einsum("vkl,vl->vk", blended[:, :, :3], attributes["POSITION"].astype(float)) + blended[:, :, 3]


def joint_matrices(document: Document, skin_index: Any, places: list, label: str) -> Float[np.ndarray, "n 4 4"]:
    """The joint matrices of a skin, with the joints at their nodes; `places` are the matrices of all nodes."""
    skin = document.item("skins", skin_index, label)
    place = document.label("skins", skin_index)
    with document.at(place):
        for joint in skin["joints"]:
            document.item("nodes", joint, place)
        joints = np.stack([places[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" not in skin:
            return joints
        stored = read_accessor(document, skin["inverseBindMatrices"], f"{place}: inverseBindMatrices", "MAT4")
        if len(stored) < len(joints):
            raise ValueError(f"has {len(stored)} inverse bind matrices for {len(joints)} joints")
        return joints @ stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(float)
