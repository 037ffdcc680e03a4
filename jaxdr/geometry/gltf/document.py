"""A glTF file: its JSON, its buffers, and errors that name the place in the file."""

import base64
import binascii
import contextlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from jaxdr.geometry.gltf.compression import meshopt_extension, meshopt_view

# Exceptions that NumPy, JSON and look-ups raise for a damaged file.
DAMAGE = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, struct.error, RuntimeError)
KINDS = (
    *("accessors", "buffers", "bufferViews", "cameras", "images", "materials", "meshes", "nodes", "samplers", "scenes"),
    *("skins", "textures"),
)
SINGULAR = {"meshes": "mesh"}  # the others lose an s
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class GltfError(ValueError):
    """A glTF file that can't be read; the message starts with file and place."""


class Document:
    """The JSON of a file (`header`) and its buffers, which are read when they are needed."""

    def __init__(self, path: Path):
        self.path = path
        data = path.read_bytes()
        text, self._chunk = _glb_chunks(self, data) if data[:4] == b"glTF" else (data, None)
        try:
            self.header: dict = json.loads(text)
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise self.error("the JSON", f"is damaged or cut off ({error})") from error
        if not isinstance(self.header, dict):
            raise self.error("the JSON", "must be an object")
        with self.at("asset"):
            version = self.header["asset"]["version"]
            if not str(version).startswith("2."):
                raise self.error("asset", f"glTF version {version!r}; only 2.x is supported")
        for kind in KINDS:
            items = self.items(kind)
            if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
                raise self.error(kind, "must be a list of objects")
            for index, item in enumerate(items):
                if not isinstance(item.get("name", ""), str):
                    raise self.error(f"{_singular(kind)} {index}", f"its name must be a string, not {item['name']!r}")
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

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
            raise self.error(place, f"the property {error.args[0]!r} is missing") from error
        except (TypeError, AttributeError) as error:
            raise self.error(place, f"a value is of a wrong kind ({error})") from error
        except DAMAGE as error:
            raise self.error(place, str(error) or type(error).__name__) from error

    def items(self, kind: str) -> list[dict]:
        """All objects of a top-level list such as "meshes"."""
        return self.header.get(kind, [])

    def item(self, kind: str, index: Any, place: str) -> dict:
        """Item `index` of a top-level list. `place`, which refers to it, is for the error if there is no such item."""
        items = self.items(kind)
        if not isinstance(index, int) or not 0 <= index < len(items):
            raise self.error(place, f"refers to {_singular(kind)} {index}; there are {len(items)}")
        return items[index]

    def label(self, kind: str, index: int) -> str:
        """The label of an object in messages: its kind, with its name or else its number."""
        name = self.items(kind)[index].get("name")
        return f"{_singular(kind)} {name!r}" if name else f"{_singular(kind)} {index}"

    def bytes_at(self, uri: str, place: str) -> bytes:
        """The data behind a URI: a data URI, or a file beside this one, percent-encoded or not."""
        if uri.startswith("data:"):
            kind, _, data = uri.partition(",")
            try:
                return base64.b64decode(data, validate=True) if kind.endswith(";base64") else unquote_to_bytes(data)
            except binascii.Error as error:
                raise self.error(place, f"its data URI is damaged or cut off ({error})") from error
        if "://" in uri:
            raise self.error(place, f"{uri} is not a local file; download it, and name it in the file")
        for name in (unquote(uri), uri):
            if (file := self.path.parent / name).is_file():
                return file.read_bytes()
        raise self.error(place, f"there is no file {self.path.parent / unquote(uri)}")

    def buffer(self, index: int, place: str) -> bytes:
        """All bytes of a buffer."""
        if index not in self._buffers:
            buffer, label = self.item("buffers", index, place), f"buffer {index}"
            with self.at(label):
                length = whole(buffer, "byteLength")
                if "uri" in buffer:
                    data = self.bytes_at(buffer["uri"], label)
                elif index == 0 and self._chunk is not None:
                    data = self._chunk
                else:
                    raise self.error(label, "has no data: neither a uri, nor the binary chunk of a .glb")
                if len(data) < length:
                    raise self.error(label, f"has {len(data)} of its {length} bytes; the file is cut off")
                self._buffers[index] = data[:length]
        return self._buffers[index]

    def view(self, index: Any, place: str) -> bytes:
        """The bytes of a buffer view, decompressed."""
        view, label = self.item("bufferViews", index, place), f"bufferView {index}"
        if index not in self._views:
            with self.at(label):
                compressed = meshopt_extension(view)
                source = view if compressed is None else compressed
                data = self.buffer(source["buffer"], label)
                start, length = whole(source, "byteOffset", 0), whole(source, "byteLength")
                if start + length > len(data):
                    end = start + length
                    raise ValueError(
                        f"its bytes {start} to {end} are not in buffer {source['buffer']}, which has {len(data)}"
                    )
                found = data[start : start + length]
                self._views[index] = found if compressed is None else meshopt_view(compressed, found)
        return self._views[index]


def whole(owner: dict, name: str, default: int | None = None) -> int:
    """A property that is a whole number of at least zero."""
    value = owner[name] if default is None else owner.get(name, default)
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"{name} must be a whole number of at least 0, not {value!r}")
    return value


def numbers(owner: dict, name: str, default: tuple[float | int, ...]) -> np.ndarray:
    """A property that is as many finite numbers as its default value."""
    value = owner.get(name, default)
    if not isinstance(value, list | tuple) or len(value) != len(default):
        raise ValueError(f"{name} must be {len(default)} numbers, not {value!r}")
    found = np.asarray(value, float)
    if not np.isfinite(found).all():
        raise ValueError(f"{name} is not finite: {value!r}")
    return found


def _singular(kind: str) -> str:
    return SINGULAR.get(kind, kind[:-1])


def _glb_chunks(document: Document, data: bytes) -> tuple[bytes, bytes | None]:
    """(JSON, binary chunk or None) of a .glb."""
    if len(data) < 20:
        raise document.error("the GLB header", f"the file is cut off after {len(data)} bytes")
    version, total, length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2:
        raise document.error("the GLB header", f"GLB version {version}; only 2 is supported")
    if len(data) < total:
        raise document.error("the GLB header", f"the file has {len(data)} of its {total} bytes; it is cut off")
    if kind != JSON_CHUNK or 20 + length > len(data):
        raise document.error("the GLB header", "the first chunk is not the JSON")
    text, start = data[20 : 20 + length], 20 + length
    while start + 8 <= len(data):
        length, kind = struct.unpack_from("<II", data, start)
        if kind == BINARY_CHUNK:
            if start + 8 + length > len(data):
                raise document.error("the binary chunk", f"has {len(data) - start - 8} of its {length} bytes")
            return text, data[start + 8 : start + 8 + length]
        start += 8 + length
    return text, None
