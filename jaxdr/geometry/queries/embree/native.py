"""Handlers that XLA calls to trace rays, and the table of trees in which they look.

A handler finds the tree of a mesh by the mesh's content, without Python. Only if it is missing, Python builds it.
"""

import contextlib
import ctypes
import hashlib
import threading
import traceback
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import jax
import numpy as np

from jaxdr.geometry.queries.bvh_cache import BVHCache, HostArrays
from jaxdr.geometry.queries.embree import scene
from jaxdr.geometry.queries.embree.scene import EmbreeScene, library
from jaxdr.kernels import machine

HANDLERS = ("jaxdr_closest_hit", "jaxdr_occluded")
OTHERS = ("jaxdr_set_functions", "jaxdr_set_trees", "jaxdr_writing", "jaxdr_written")


class _Tree(ctypes.Structure):
    """The structure `Tree` of trace.h."""

    _fields_ = (
        ("vertices", ctypes.c_void_p),
        ("faces", ctypes.c_void_p),
        ("vertex_count", ctypes.c_int64),
        ("face_count", ctypes.c_int64),
        ("scene", ctypes.c_void_p),
        ("used", ctypes.c_int64),
    )


class _Trees:
    """Trees of meshes, for handlers and Python. `names`: what XLA calls the handlers, by their symbols."""

    def __init__(self, addresses: dict[str, int], names: dict[str, str]):
        self.names = names

        def function(name, result, *arguments):
            return ctypes.CFUNCTYPE(result, *arguments)(addresses[name])

        address, count = ctypes.c_void_p, ctypes.c_int64
        self.writing, self.written = (function(name, None) for name in ("jaxdr_writing", "jaxdr_written"))
        self.set_trees = function("jaxdr_set_trees", None, address, count)
        self.cache = BVHCache(
            lambda moving, topology: EmbreeScene(moving[0], topology[0]),
            lambda scene, moving: scene.refit(moving[0]),
            _Locked(self),
        )
        self.table = (_Tree * (self.cache.capacity + self.cache.per_topology))()
        self.listed: list = []
        self.built = ctypes.CFUNCTYPE(ctypes.c_int, address, count, address, count)(self._built)
        functions = library().intersect, library().occluded
        function("jaxdr_set_functions", None, address, address, address)(ctypes.cast(self.built, address), *functions)

    def _built(self, vertices, vertex_count, faces, face_count) -> int:
        """Called by a handler: build the tree of a mesh; 0 if it is there now."""
        try:
            with self.cache.lock:
                # Handlers use trees without telling the cache.
                used = self._used()
                self.cache.entries.sort(key=lambda entry: used.get(id(entry), 0))
                moving = _array(vertices, ctypes.c_float, vertex_count)
                self.cache.find([moving], [_array(faces, ctypes.c_int32, face_count)])
                with self._changing():  # the new entry is listed after it was made
                    pass
        except Exception:
            traceback.print_exc()
            return 1
        return 0

    def _used(self) -> dict[int, int]:
        """The last use of every listed entry, by its identity; a later use has a larger number."""
        return {id(entry): tree.used for entry, tree in zip(self.listed, self.table, strict=False)}

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """A context in which no tree is in use; after it, handlers see the cache's trees."""
        self.writing()
        try:
            try:
                yield
            finally:
                used = self._used()
                latest = max(used.values(), default=0) + 1  # a new tree is about to be used
                self.listed = list(self.cache.entries)
                for i, entry in enumerate(self.listed):
                    vertices, faces = entry.moving[0], entry.topology[0]
                    sizes = len(vertices), len(faces), entry.structure.handle, used.get(id(entry), latest)
                    self.table[i] = _Tree(vertices.ctypes.data, faces.ctypes.data, *sizes)
                self.set_trees(ctypes.addressof(self.table), len(self.listed))
        finally:
            self.written()


class _Locked(HostArrays):
    """Host arrays, whose structures handlers use without Python."""

    def __init__(self, trees: _Trees):
        self.trees = trees

    def changes(self):
        return self.trees._changing()


def _array(address: int, kind, count: int) -> np.ndarray:
    """The rows of three numbers at an address."""
    if count == 0:  # XLA has no address for an empty array
        return np.empty((0, 3), np.dtype(kind))
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (count, 3))


def handlers() -> _Trees:
    """Register the handlers with XLA, once in a process. Raises `machine.CompilerError` if they can't be compiled."""
    with _registering:
        return _registered()


def available() -> bool:
    """Whether rays can be traced by Embree. Warns if only the compiler of the handlers is missing."""
    if not scene.available():
        return False
    try:
        handlers()
    except machine.CompilerError as error:
        warnings.warn(f"jaxdr: Warp traces rays in place of Embree, which is faster: {error}", stacklevel=2)
        return False
    return True


_registering = threading.Lock()


@cache
def _registered() -> _Trees:
    library()
    text = machine.declarations() + Path(__file__).with_name("trace.h").read_text()
    addresses = machine.addresses(text, (*HANDLERS, *OTHERS))
    # XLA keeps programs by the names that they call: those of another version must not meet these handlers.
    version = hashlib.sha256(text.encode()).hexdigest()[:12]
    trees = _Trees(addresses, {symbol: f"{symbol}_{version}" for symbol in HANDLERS})
    for symbol, name in trees.names.items():
        machine.register(name, addresses[symbol])
    return trees


def call(symbol: str, results, *arrays):
    """The results of a handler."""
    return jax.ffi.ffi_call(handlers().names[symbol], results)(*arrays)
