"""A glTF file: its JSON, its buffers, and errors that name the place in the file."""

import base64
import binascii
import contextlib
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from jaxdr import untrusted
from jaxdr.callers_line import warn
from jaxdr.geometry.gltf.compression import meshopt_extension, meshopt_view
from jaxdr.geometry.gltf.kinds import TEXT_LISTS, check_kinds
from jaxdr.untrusted import check_memory, finite, json_of, reason, shortened

# Exceptions that NumPy, libraries and look-ups raise for a damaged file.
DAMAGE = (
    *(LookupError, TypeError, ValueError, AttributeError, ArithmeticError, struct.error, RuntimeError, MemoryError),
    *(AssertionError, EOFError),
)
KINDS = (
    *("accessors", "buffers", "bufferViews", "cameras", "images", "materials", "meshes", "nodes", "samplers", "scenes"),
    *("skins", "textures"),
)
SINGULAR = {"meshes": "mesh"}  # the others lose an s
MOST_WITHOUT_DATA = 1 << 20  # values of an accessor for which no bytes are stored, in a small file
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class GltfError(ValueError):
    """A glTF file that can't be read; the message starts with file and place."""


class Document:
    """The JSON of a file (`header`) and its buffers, which are read when they are needed.

    Every property that is read later has its kind, and every number is finite. Raises `GltfError` for a damaged file.
    """

    def __init__(self, path: Path):
        self.path = path
        data = _bytes_of(path)
        text, self._chunk = _glb_chunks(self, data) if data[:4] == b"glTF" else (data, None)
        try:
            self.header: dict = json_of(text, f"{path}: the JSON")
        except ValueError as error:
            raise GltfError(str(error)) from error
        if not isinstance(self.header, dict):
            raise self.error("the JSON", "must be an object")
        with self.at("the JSON"):
            names = self.header.keys() & {*TEXT_LISTS, "asset", "extensions", "scene"}
            check_kinds({name: self.header[name] for name in names})
        with self.at("asset"):
            version = self.header["asset"]["version"]
            if not version.startswith("2."):
                raise self.error("asset", f"glTF version {shortened(version)}; only 2.x is supported")
        for kind in KINDS:
            items = self.items(kind)
            if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
                raise self.error(kind, "must be a list of objects")
            for index, item in enumerate(items):
                with self.at(f"{_singular(kind)} {index}"):
                    check_kinds(item)
        self._buffers: dict[int | str, bytes] = {}
        self._views: dict[int, bytes] = {}
        self._size = len(data)

    def error(self, place: str, message: str) -> GltfError:
        """The error to raise for something at a place in the file."""
        return GltfError(f"{self.path}: {place}: {message}")

    @contextlib.contextmanager
    def at(self, place: str) -> Iterator[None]:
        """Raise errors of the block again as `GltfError` with this place, unless they name a place already."""
        try:
            yield
        except GltfError:
            raise
        except KeyError as error:
            raise self.error(place, f"the property {shortened(error.args[0])} is missing") from error
        except (TypeError, AttributeError) as error:
            raise self.error(place, f"a value is of a wrong kind ({reason(error)})") from error
        except DAMAGE as error:
            raise self.error(place, reason(error)) from error

    def items(self, kind: str) -> list[dict]:
        """All objects of a top-level list such as "meshes"."""
        return self.header.get(kind, [])

    def item(self, kind: str, index: Any, place: str) -> dict:
        """Item `index` of a top-level list. `place`, which refers to it, is for the error if there is no such item."""
        items = self.items(kind)
        if type(index) is not int or not 0 <= index < len(items):
            raise self.error(place, f"refers to {_singular(kind)} {shortened(index)}; there are {len(items)}")
        return items[index]

    def label(self, kind: str, index: int) -> str:
        """The label of an object in messages: its kind, with its name or else its number."""
        name = self.items(kind)[index].get("name")
        return f"{_singular(kind)} {name!r}" if name else f"{_singular(kind)} {index}"

    def bytes_at(self, uri: str, place: str) -> bytes:
        """The data behind a URI: a data URI, or a file in the folder of this one, percent-encoded or not."""
        if uri.startswith("data:"):
            kind, _, data = uri.partition(",")
            try:
                return base64.b64decode(data, validate=True) if kind.endswith(";base64") else unquote_to_bytes(data)
            except (binascii.Error, ValueError) as error:
                raise self.error(place, f"its data URI is damaged or cut off ({error})") from error
        if "://" in uri:
            raise self.error(place, f"{shortened(uri)} is not a local file; download it, and name it in the file")
        return _bytes_of(self._beside(uri, place))

    def _beside(self, uri: str, place: str) -> Path:
        """The path of a file in the folder of this one, or below."""
        folder = self.path.parent
        with self.at(place):
            for name in (unquote(uri), uri):
                found = (folder / name).resolve()
                if not found.is_relative_to(folder.resolve()):
                    raise ValueError(
                        f"{shortened(uri)} is outside the folder of this file; put it there, and change its URI"
                    )
                if os.path.isfile(found):
                    return found
        raise self.error(place, f"there is no file {shortened(unquote(uri))} in {folder}")

    def buffer(self, index: int, place: str) -> bytes:
        """All bytes of a buffer. Buffers of the same file are read once."""
        buffer, label = self.item("buffers", index, place), f"buffer {index}"
        with self.at(label):
            length, key = whole(buffer, "byteLength"), buffer.get("uri", index)
            if key not in self._buffers:
                self._buffers[key] = self._buffer(buffer, index, label)
            data = self._buffers[key]
            if len(data) < length:
                raise self.error(label, f"has {len(data)} of its {length} bytes; the file is cut off")
        return data

    def _buffer(self, buffer: dict, index: int, label: str) -> bytes:
        if "uri" in buffer:
            data = self.bytes_at(buffer["uri"], label)
            self._size += len(data)
            return data
        if index == 0 and self._chunk is not None:
            return self._chunk
        raise self.error(label, "has no data: neither a uri, nor the binary chunk of a .glb")

    def view(self, index: Any, place: str) -> bytes | memoryview:
        """The bytes of a buffer view, decompressed. Views share the bytes of their buffers."""
        view, label = self.item("bufferViews", index, place), f"bufferView {index}"
        if index in self._views:
            return self._views[index]
        with self.at(label):
            compressed = meshopt_extension(view)
            source = view if compressed is None else compressed
            data = self.buffer(source["buffer"], label)
            start, length = whole(source, "byteOffset", 0), whole(source, "byteLength")
            end, there = start + length, whole(self.items("buffers")[source["buffer"]], "byteLength")
            if end > there:
                raise ValueError(f"its bytes {start} to {end} are not in buffer {source['buffer']}, which has {there}")
            found = memoryview(data)[start:end]
            if compressed is None:
                return found
            self._views[index] = meshopt_view(compressed, bytes(found))
        return self._views[index]

    def check_values_without_data(self, count: int) -> None:
        """Raises ValueError for more values than a file of this size can mean, where nothing is stored for each."""
        if count <= MOST_WITHOUT_DATA:
            return
        for index, buffer in enumerate(self.items("buffers")):
            if "uri" in buffer:
                self.buffer(index, "")
        if count > self._size:
            raise ValueError(f"its {count} values have no data; the file and its buffers have {self._size} bytes")


def whole(owner: dict, name: str, default: int | None = None) -> int:
    """A property that is a whole number of at least zero."""
    return untrusted.whole(owner[name] if default is None else owner.get(name, default), name)


def number(
    owner: dict, name: str, low: float, high: float = untrusted.LARGEST, *, default: float | None = None
) -> float:
    """A property that is a number from `low` to `high`. It must be there if there is no default."""
    return finite(owner[name] if default is None else owner.get(name, default), name, low, high)


def numbers(owner: dict, name: str, default: tuple[float | int, ...]) -> np.ndarray:
    """A property that is as many finite numbers as its default value."""
    value = owner.get(name, default)
    if not isinstance(value, list | tuple) or len(value) != len(default):
        raise ValueError(f"{name} must be {len(default)} numbers, not {shortened(value)}")
    return np.array([finite(part, name) for part in value] if name in owner else default, float)


def _singular(kind: str) -> str:
    return SINGULAR.get(kind, kind[:-1])


def _bytes_of(path: Path) -> bytes:
    check_memory(path.stat().st_size, f"{path}")
    return path.read_bytes()


def _glb_chunks(document: Document, data: bytes) -> tuple[bytes, bytes | None]:
    """(JSON, binary chunk or None) of a .glb."""
    if len(data) < 20:
        raise document.error("the GLB header", f"the file is cut off after {len(data)} bytes")
    version, total, length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2:
        raise document.error("the GLB header", f"GLB version {version}; only 2 is supported")
    if len(data) < total:
        raise document.error("the GLB header", f"the file has {len(data)} of its {total} bytes; it is cut off")
    if kind != JSON_CHUNK or 20 + length > total:
        raise document.error("the GLB header", "the first chunk is not the JSON")
    if len(data) > total:
        warn(f"{document.path}: the {len(data) - total} bytes after the {total} of the GLB are left out")
    text, start = data[20 : 20 + length], 20 + length
    while start + 8 <= total:
        length, kind = struct.unpack_from("<II", data, start)
        if start + 8 + length > total:
            name = "the binary chunk" if kind == BINARY_CHUNK else f"the chunk at byte {start}"
            raise document.error(name, f"has {total - start - 8} of its {length} bytes")
        if kind == BINARY_CHUNK:
            return text, data[start + 8 : start + 8 + length]
        start += 8 + length
    return text, None
