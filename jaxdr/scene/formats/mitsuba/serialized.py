"""Mitsuba's `serialized` meshes, versions 3 and 4: triangles as zlib streams, several in a file.

All numbers are little endian. A file has these parts, in this order:

- the meshes;
- the offset of every mesh (64 bits; 32 in version 3);
- the number of meshes (32 bits).

A mesh has the number 0x041C and the version (16 bits each), and then a zlib stream of

- flags (32 bits);
- the name (UTF-8, ended by a zero; version 4 only);
- the numbers of vertices and of triangles (64 bits each);
- positions, then normals, texture coordinates and colours as far as the flags say so, all floats or all doubles;
- three 32-bit indices for every triangle.
"""

import struct
import zlib
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from jaxdr.geometry.load import Triangles

MAGIC = 0x041C
OFFSET = {3: np.dtype("<u4"), 4: np.dtype("<u8")}  # type of the offsets, by version
NORMALS, UVS, COLORS, FACE_NORMALS, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x2000
CHUNK = 1 << 20
LONGEST_NAME = 1 << 16


class SerializedMesh(NamedTuple):
    """Triangles, with the v of UVs as in the file. `face_normals`: whether the file asks for flat shading."""

    triangles: Triangles
    face_normals: bool


def read_serialized(path: Path, index: int) -> SerializedMesh:
    """One mesh of a file. Raises `ValueError` for an index out of range, a damaged file, and one of another kind."""
    with path.open("rb") as file:
        try:
            version = _version(file)
            if index:
                file.seek(_offset(file, version, index))
                version = _version(file)
            return _mesh(memoryview(_decompressed(file)), version)
        except (struct.error, zlib.error, OverflowError, UnicodeDecodeError, OSError) as error:
            raise ValueError(f"{path}: not a readable serialized mesh ({error})") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _version(file: BinaryIO) -> int:
    magic, version = struct.unpack("<HH", file.read(4))
    if magic != MAGIC or version not in OFFSET:
        raise ValueError(f"not a serialized mesh of version 3 or 4 (starts with {magic:#06x}, version {version})")
    return version


def _offset(file: BinaryIO, version: int, index: int) -> int:
    """The byte where a mesh starts, from the table at the end of the file."""
    file.seek(-4, 2)
    (count,) = struct.unpack("<I", file.read(4))
    if not 0 <= index < count:
        raise ValueError(f"shape_index must be from 0 to {count - 1}, got {index}")
    kind = OFFSET[version]
    file.seek(-4 - kind.itemsize * (count - index), 2)
    return int(np.frombuffer(file.read(kind.itemsize), kind)[0])


def _decompressed(file: BinaryIO) -> bytes:
    """The content of the zlib stream that starts at the current position."""
    stream, parts = zlib.decompressobj(), []
    while not stream.eof:
        chunk = file.read(CHUNK)
        if not chunk:
            raise ValueError("the file ends inside of a mesh")
        parts.append(stream.decompress(chunk))
    return b"".join(parts)


def _mesh(content: memoryview, version: int) -> SerializedMesh:
    (flags,) = struct.unpack_from("<I", content)
    position = 4
    if version == 4:
        position += bytes(content[position : position + LONGEST_NAME]).index(b"\0") + 1
    vertex_count, face_count = struct.unpack_from("<QQ", content, position)
    position += 16
    number = np.dtype("<f8" if flags & DOUBLE else "<f4")

    def take(kind: np.dtype, rows: int, columns: int) -> np.ndarray:
        nonlocal position
        size = rows * columns * kind.itemsize
        if position + size > len(content):
            raise ValueError("a mesh is shorter than its numbers of vertices and triangles say")
        taken = np.frombuffer(content, kind, rows * columns, position).reshape(rows, columns)
        position += size
        return taken

    vertices = take(number, vertex_count, 3).astype(np.float64)
    normals = take(number, vertex_count, 3) if flags & NORMALS else None
    uvs = take(number, vertex_count, 2).astype(np.float64) if flags & UVS else None
    colors = take(number, vertex_count, 3) if flags & COLORS else None
    faces = take(np.dtype("<u4"), face_count, 3).astype(np.int64)
    if faces.size and faces.max() >= vertex_count:
        raise ValueError(f"a triangle has vertex {faces.max()}, and there are {vertex_count}")
    if normals is not None:
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = normals / np.where(length > 0, length, 1)
    stored = {} if colors is None else {"vertex": dict(zip("rgb", colors.T, strict=True))}
    return SerializedMesh(Triangles(vertices, faces, uvs, normals, stored), bool(flags & FACE_NORMALS))
