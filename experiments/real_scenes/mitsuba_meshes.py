"""Writes serialized and PLY mesh files for these scenes, from the specifications of the formats."""

import struct
import zlib

import numpy as np

SINGLE, DOUBLE = 0x1000, 0x2000
NORMALS, UVS, COLORS, FACE_NORMALS = 0x1, 0x2, 0x8, 0x10


def serialized(meshes, version=4, kind="<f4"):
    """Bytes of a `serialized` file; each mesh a dictionary: vertices, faces, and maybe normals, uvs, colors, flags."""
    streams = [_stream(mesh, version, np.dtype(kind)) for mesh in meshes]
    offsets = np.cumsum([0, *[len(stream) for stream in streams[:-1]]])
    table = offsets.astype("<u8" if version == 4 else "<u4").tobytes()
    return b"".join(streams) + table + struct.pack("<I", len(streams))


def _stream(mesh, version, kind):
    flags = mesh.get("flags", 0) | (SINGLE if kind.itemsize == 4 else DOUBLE)
    optional = (("normals", NORMALS), ("uvs", UVS), ("colors", COLORS))
    flags |= sum(flag for name, flag in optional if name in mesh)
    body = struct.pack("<I", flags) + (b"a shape\0" if version == 4 else b"")
    body += struct.pack("<QQ", len(mesh["vertices"]), len(mesh["faces"]))
    arrays = [mesh["vertices"], *[mesh[name] for name, _ in optional if name in mesh]]
    body += b"".join(np.asarray(array).astype(kind).tobytes() for array in arrays)
    body += np.asarray(mesh["faces"]).astype("<u4").tobytes()
    return struct.pack("<HH", 0x041C, version) + zlib.compress(body)


def ply(vertices, faces, vertex=None, face=None):
    """Text of a PLY file; `vertex` and `face` are further properties, name -> (type, one number each)."""
    vertex, face = vertex or {}, face or {}
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + [
        f"property {kind} {name}" for name, (kind, _) in vertex.items()
    ]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    lines += [f"property {kind} {name}" for name, (kind, _) in face.items()] + ["end_header"]
    for rows, start, further in ((vertices, "", vertex), (faces, "3 ", face)):
        for i, row in enumerate(np.asarray(rows).tolist()):
            lines.append(start + " ".join(map(str, [*row, *[values[i] for _, values in further.values()]])))
    return "\n".join(lines) + "\n"


def hill(size=9):
    """A bump over [-1, 1]²: vertices, faces, unit normals and UVs, one each a vertex."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(-1, 1, size)]))
    height = 0.6 * np.exp(-3 * (x**2 + y**2))
    index = np.arange(size * size).reshape(size, size)
    corners = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    a, b, c, d = (corner.ravel() for corner in corners)
    normals = np.stack([6 * x * height, 6 * y * height, np.ones_like(x)], axis=1)
    return {
        "vertices": np.stack([x, y, height], axis=1),
        "faces": np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]),
        "normals": normals / np.linalg.norm(normals, axis=1, keepdims=True),
        "uvs": np.stack([(x + 1) / 2, (y + 1) / 2], axis=1),
    }
