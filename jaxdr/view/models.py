"""Meshes as the bytes of GLB files, for the viewer in a page."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from jaxdr.geometry.formats.triangles import Triangles
from jaxdr.geometry.load import read_parts

# glTF's own default is a white metal, on which the shape is hard to see.
PLAIN = {
    "name": "plain",
    "doubleSided": True,
    "pbrMetallicRoughness": {"baseColorFactor": [0.25, 0.26, 0.28, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8},
}
COLORS = (("red", "green", "blue"), ("r", "g", "b"))  # names that programs give them


def glb_bytes(path: Path) -> bytes:
    """The mesh of a file as GLB, grey if it has no colours. Raises ValueError for a file that can't be read.

    Only the file itself is read: materials and pictures that it names in other files are left out.
    """
    parts = read_parts(path, "jaxdr view")
    return _with_material(path.read_bytes() if path.suffix.lower() == ".glb" else _converted(path, parts))


def _converted(path: Path, parts: Sequence[Triangles]) -> bytes:
    import trimesh

    scene = trimesh.Scene()
    for part in parts:
        mesh = trimesh.Trimesh(
            part.vertices,
            part.faces,
            vertex_normals=part.normals,
            face_colors=_colors(path, part.stored.get("face", {})),
            vertex_colors=_colors(path, part.stored.get("vertex", {})),
            process=False,
        )
        scene.add_geometry(mesh)
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def _colors(path: Path, stored: dict[str, np.ndarray]) -> UInt8[np.ndarray, "n 3"] | None:
    """The colours of vertices or faces; None if there are none."""
    names = next((names for names in COLORS if all(name in stored for name in names)), None)
    if names is None:
        return None
    columns = [stored[name] for name in names]
    scales = [np.iinfo(column.dtype).max if column.dtype.kind in "iu" else 1 for column in columns]
    values = np.stack([column / scale for column, scale in zip(columns, scales, strict=True)], axis=1)
    if not ((values >= 0) & (values <= 1)).all():
        raise ValueError(
            f"{path}: its colours go from {values.min():g} to {values.max():g}; give bytes, or floats in [0, 1]"
        )
    return np.round(255 * values).astype(np.uint8)


def _with_material(data: bytes) -> bytes:
    """The same GLB, which is known to be sound. If it has no materials, all primitives get a grey one."""
    magic, version, length = struct.unpack_from("<4sII", data)
    size, kind = struct.unpack_from("<II", data, 12)
    document = json.loads(data[20 : 20 + size])
    if document.get("materials"):
        return data[:length]
    document["materials"] = [PLAIN]
    for mesh in document["meshes"]:
        for primitive in mesh.get("primitives", []):
            primitive["material"] = 0
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size : length]
    return struct.pack("<4sIIII", magic, version, 20 + len(text) + len(rest), len(text), kind) + text + rest
