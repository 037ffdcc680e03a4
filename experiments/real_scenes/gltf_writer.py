"""Writes glTF 2.0 files from JSON and arrays, exactly as specified. It shares no code with the loader."""

import base64
import json
import struct
from pathlib import Path

import numpy as np

COMPONENT_TYPES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

# The unit cube: eight corners that its faces share, counter-clockwise from outside.
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
CUBE = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),  # x = 0, x = 1
        *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),  # y = 0, y = 1
        *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),  # z = 0, z = 1
    ],
    np.uint16,
)
# The square [0, 1]² in the plane z = 0 that faces +z; v goes down in glTF.
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
SQUARE_UVS = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)


class File:
    """A file in the making: `json` may be changed at will, arrays go into one buffer."""

    def __init__(self, **header):
        self.json = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": []}
        self.json |= header
        self.data = bytearray()

    def add(self, kind: str, item: dict) -> int:
        """Append to a top-level list; the item's number."""
        self.json.setdefault(kind, []).append(item)
        return len(self.json[kind]) - 1

    def view(self, data: bytes, **more) -> int:
        """Bytes in the buffer, aligned to four."""
        self.data += bytes(-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more}
        self.data += data
        return self.add("bufferViews", view)

    def accessor(self, values, normalized: bool = False, stride: int | None = None, **more) -> int:
        """An array [n] or [n, k]; rows padded to `stride` bytes where it is given."""
        values = np.asarray(values)
        rows = values.reshape(len(values), -1)
        rows = rows.astype(rows.dtype.newbyteorder("<"))
        if stride is None:
            view = self.view(rows.tobytes())
        else:
            padding = bytes(stride - rows.dtype.itemsize * rows.shape[1])
            view = self.view(b"".join(row.tobytes() + padding for row in rows), byteStride=stride)
        accessor = self.described(values, normalized) | {"bufferView": view} | more
        return self.add("accessors", accessor)

    def described(self, values, normalized: bool = False) -> dict:
        """What an accessor says of an array, without its data."""
        rows = np.asarray(values).reshape(len(values), -1)
        accessor = {
            "componentType": COMPONENT_TYPES[rows.dtype.name],
            "count": len(rows),
            "type": TYPES[rows.shape[1]],
            "min": rows.min(0).tolist(),
            "max": rows.max(0).tolist(),
        }
        return accessor | ({"normalized": True} if normalized else {})

    def primitive(self, vertices=CORNERS, faces=CUBE, **more) -> dict:
        """Triangles; None for faces leaves the indices out. Arrays among `attributes` become accessors."""
        attributes = {
            name: values if isinstance(values, int) else self.accessor(values)
            for name, values in more.pop("attributes", {}).items()
        }
        primitive = {"attributes": {"POSITION": self.accessor(vertices), **attributes}}
        if faces is not None:
            primitive["indices"] = self.accessor(np.asarray(faces).reshape(-1))
        return primitive | more

    def mesh(self, *primitives: dict, **more) -> int:
        """A mesh of these primitives (default: the unit cube)."""
        return self.add("meshes", {"primitives": list(primitives) or [self.primitive()], **more})

    def node(self, root: bool = True, **node) -> int:
        """A node, in the scene unless it is another one's child."""
        index = self.add("nodes", node)
        if root:
            self.json["scenes"][0]["nodes"].append(index)
        return index

    def square(self, material: dict, **more) -> int:
        """A node with a textured square of this material."""
        number = self.add("materials", material)
        attributes = {"TEXCOORD_0": SQUARE_UVS} | more.pop("attributes", {})
        primitive = self.primitive(SQUARE, SQUARE_FACES, attributes=attributes, material=number)
        return self.node(mesh=self.mesh(primitive), **more)

    def texture(self, png: bytes, sampler: dict | None = None, mime: str = "image/png") -> int:
        """A texture of an image's bytes."""
        image = self.add("images", {"bufferView": self.view(png), "mimeType": mime})
        texture = {"source": image}
        if sampler is not None:
            texture["sampler"] = self.add("samplers", sampler)
        return self.add("textures", texture)

    def uses(self, *names: str, required: bool = False) -> None:
        """Declare extensions."""
        for key in ("extensionsUsed", "extensionsRequired")[: 1 + required]:
            self.json[key] = [*self.json.get(key, []), *names]

    def save(self, path: Path, embed: bool = False, buffer: str | None = None) -> Path:
        """Write a .glb; or a .gltf with its buffer in a file beside it, whose URI is `buffer`, or embedded in it."""
        header, data = dict(self.json), bytes(self.data + bytes(-len(self.data) % 4))
        others = header.get("buffers", [])[1:]
        if path.suffix == ".glb":
            header["buffers"] = [{"byteLength": len(data)}, *others]
            text = json.dumps(header).encode()
            text += b" " * (-len(text) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
            return path
        uri = buffer or f"{path.stem}.bin"
        if embed:
            uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        else:
            (path.parent / uri.replace("%20", " ")).write_bytes(data)
        header["buffers"] = [{"byteLength": len(data), "uri": uri}, *others]
        path.write_text(json.dumps(header))
        return path
