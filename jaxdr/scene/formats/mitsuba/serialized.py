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

from jaxdr.geometry.formats.triangles import Triangles, check_corners, check_numbers, unit
from jaxdr.untrusted import check_memory, reason

MAGIC = 0x041C
OFFSET = {3: np.dtype("<u4"), 4: np.dtype("<u8")}  # type of the offsets, by version
NORMALS, UVS, COLORS, FACE_NORMALS, DOUBLE = 0x1, 0x2, 0x8, 0x10, 0x2000
CHUNK = 1 << 14
LONGEST_NAME = 1 << 16
SMALLEST = 1032  # zlib makes data no smaller than by this factor


class SerializedMesh(NamedTuple):
    """Triangles, with the v of UVs as in the file. `face_normals`: whether the file asks for flat shading."""

    triangles: Triangles
    face_normals: bool


class Stream:
    """The zlib stream of a file from the current position on. Memory is taken for what is asked for, and no more."""

    def __init__(self, file: BinaryIO):
        self.file, self.inflate, self.waiting = file, zlib.decompressobj(), b""
        start = file.tell()
        self.most = SMALLEST * (file.seek(0, 2) - start)
        file.seek(start)

    def read(self, size: int) -> bytearray:
        """The next bytes, fewer at the end of the stream. Raises ValueError where the file ends before."""
        found = bytearray()
        while len(found) < size and not self.inflate.eof:
            self.waiting = self.waiting or self.file.read(CHUNK)
            if not self.waiting:
                raise ValueError("the file ends inside of a mesh")
            found += self.inflate.decompress(self.waiting, size - len(found))
            self.waiting = self.inflate.unconsumed_tail
        return found

    def numbers(self, kind: np.dtype, rows: int, columns: int) -> np.ndarray:
        """A table of numbers."""
        size = rows * columns * kind.itemsize
        content = self.read(size)
        if len(content) < size:
            raise ValueError("a mesh is shorter than its numbers of vertices and triangles say")
        return np.frombuffer(content, kind).reshape(rows, columns)


def read_serialized(path: Path, index: int) -> SerializedMesh:
    """One mesh of a file. Raises `ValueError` for an index out of range, a damaged file, and one of another kind."""
    with path.open("rb") as file:
        try:
            version = _version(file)
            if index:
                file.seek(_offset(file, version, index))
                version = _version(file)
            return _mesh(Stream(file), version)
        except (struct.error, zlib.error, OverflowError, UnicodeDecodeError, OSError, MemoryError) as error:
            raise ValueError(f"{path}: not a readable serialized mesh ({reason(error)})") from error
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


def _mesh(stream: Stream, version: int) -> SerializedMesh:
    (flags,) = struct.unpack("<I", stream.read(4))
    if version == 4:
        _skip_name(stream)
    vertex_count, face_count = struct.unpack("<QQ", stream.read(16))
    number = np.dtype("<f8" if flags & DOUBLE else "<f4")
    columns = 3 + 3 * bool(flags & NORMALS) + 2 * bool(flags & UVS) + 3 * bool(flags & COLORS)
    size = vertex_count * columns * number.itemsize + 12 * face_count
    if size > stream.most:
        raise ValueError(f"{vertex_count} vertices and {face_count} triangles take more bytes than the file can have")
    check_memory(2 * size, "a mesh")
    if not vertex_count or not face_count:
        raise ValueError("a mesh has no triangles")
    vertices = stream.numbers(number, vertex_count, 3).astype(np.float64)
    normals = stream.numbers(number, vertex_count, 3) if flags & NORMALS else None
    uvs = stream.numbers(number, vertex_count, 2).astype(np.float64) if flags & UVS else None
    colors = stream.numbers(number, vertex_count, 3) if flags & COLORS else None
    faces = stream.numbers(np.dtype("<u4"), face_count, 3).astype(np.int64)
    if stream.read(1):
        raise ValueError(f"a mesh is longer than its numbers of vertices and triangles say (flags {flags:#x})")
    for name, values in (("vertices", vertices), ("normals", normals), ("uvs", uvs), ("colours", colors)):
        if values is not None:
            check_numbers(name, values)
    check_corners(faces.reshape(-1), np.full(face_count, 3), vertex_count)
    stored = {} if colors is None else {"vertex": dict(zip("rgb", colors.T, strict=True))}
    triangles = Triangles(vertices, faces, uvs, None if normals is None else unit(normals), stored)
    return SerializedMesh(triangles, bool(flags & FACE_NORMALS))


def _skip_name(stream: Stream) -> None:
    for _ in range(LONGEST_NAME):
        if stream.read(1) in (b"\0", b""):
            return
    raise ValueError(f"the name of a mesh is longer than {LONGEST_NAME} bytes")
