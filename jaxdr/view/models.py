"""Meshes as the bytes of GLB files, for the viewer in a page."""

import json
import struct
from pathlib import Path

from jaxdr.geometry.load import is_triangles

MAGIC, VERSION, JSON = b"glTF", 2, 0x4E4F534A
# glTF's own default is a white metal, on which the shape is hard to see.
PLAIN = {
    "name": "plain",
    "doubleSided": True,
    "pbrMetallicRoughness": {"baseColorFactor": [0.25, 0.26, 0.28, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8},
}


def glb_bytes(path: Path) -> bytes:
    """The mesh of a file as GLB, grey if it has no material. Raises ValueError for a file that can't be read."""
    data = path.read_bytes() if path.suffix.lower() == ".glb" else _converted(path)
    try:
        return _with_material(data)
    except (ValueError, KeyError, struct.error) as problem:
        raise ValueError(f"{path}: is not a readable .glb file ({problem})") from None


def _converted(path: Path) -> bytes:
    import trimesh

    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as problem:  # the readers of trimesh raise many kinds
        raise ValueError(f"{path}: is not a readable {path.suffix} file ({problem})") from None
    if not any(is_triangles(geometry) for geometry in scene.geometry.values()):
        raise ValueError(f"{path}: has no triangles")
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def _with_material(data: bytes) -> bytes:
    """The same GLB. If it has no materials, all primitives get a grey one."""
    magic, version, length = struct.unpack_from("<4sII", data)
    size, kind = struct.unpack_from("<II", data, 12)
    if (magic, version, kind) != (MAGIC, VERSION, JSON) or length > len(data):
        raise ValueError("damaged header")
    document = json.loads(data[20 : 20 + size])
    if document.get("materials"):
        return data
    document["materials"] = [PLAIN]
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size : length]
    return struct.pack("<4sIIII", magic, version, 20 + len(text) + len(rest), len(text), kind) + text + rest
