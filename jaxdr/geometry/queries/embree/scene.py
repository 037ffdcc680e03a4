"""Triangle meshes in Embree, by its library in the package `embreex` (the C interface, through ctypes).

`embreex` itself holds Python's lock while it traces. Instead, our own handlers (`native`) call the library's functions
at the addresses given here.
"""

import ctypes
import functools
import importlib

import numpy as np

TRIANGLES, INDICES, VERTICES = 0, 0, 1  # RTCGeometryType, RTCBufferType
UINT3, FLOAT3 = 0x5003, 0x9003  # RTCFormat
# RTCSceneFlags: with this flag rays don't slip between neighbouring faces, except very few that go exactly through a
# vertex.
ROBUST = 4
MEDIUM, REFIT = 1, 3  # RTCBuildQuality
MAJOR = 1  # RTCDeviceProperty: the version's first number
VERSION = 4  # the layout of rays in memory is that of this version


class _Library:
    """The functions that Python calls, the addresses of functions that kernels call, and a device."""

    def __init__(self):
        try:
            module = importlib.import_module("embreex.rtcore")  # its handle also finds the functions of Embree
        except ImportError as error:
            raise ImportError('rays="embree" needs the package embreex: pip install "embreex>=4.4"') from error

        self.functions = ctypes.CDLL(module.__file__)
        for name in ("rtcNewDevice", "rtcNewScene", "rtcNewGeometry", "rtcSetNewGeometryBuffer"):
            getattr(self.functions, name).restype = ctypes.c_void_p
        self.functions.rtcGetDeviceProperty.restype = ctypes.c_ssize_t
        self.device = ctypes.c_void_p(self.functions.rtcNewDevice(b"threads=1"))
        version = self.functions.rtcGetDeviceProperty(self.device, ctypes.c_int(MAJOR))
        if version != VERSION:
            raise ImportError(f"jaxdr needs Embree {VERSION}, and embreex has {version}: pip install -U embreex")
        self.intersect, self.occluded = (self._address(name) for name in ("rtcIntersect1", "rtcOccluded1"))

    def _address(self, name: str) -> int:
        address = ctypes.cast(getattr(self.functions, name), ctypes.c_void_p).value
        assert address is not None
        return address


@functools.cache
def library() -> _Library:
    """Embree's library. Raises ImportError if the package `embreex` is missing or has another version of Embree."""
    return _Library()


def available() -> bool:
    """Whether the package is installed in the right version."""
    try:
        library()
    except ImportError:
        return False
    return True


class EmbreeScene:
    """A BVH over triangles, refitted in place when they move.

    `handle` is the RTCScene. Committed scenes may be traced by several threads at once.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        self.functions, device = library().functions, library().device
        self.handle = self.functions.rtcNewScene(device)
        self.scene = ctypes.c_void_p(self.handle)
        self.functions.rtcSetSceneFlags(self.scene, ctypes.c_int(ROBUST))
        self.geometry = ctypes.c_void_p(self.functions.rtcNewGeometry(device, ctypes.c_int(TRIANGLES)))
        self.vertices = self._buffer(VERTICES, FLOAT3, len(vertices))
        self.size = 12 * len(vertices)
        faces = np.ascontiguousarray(faces, np.uint32)
        ctypes.memmove(self._buffer(INDICES, UINT3, len(faces)), faces.ctypes.data, faces.nbytes)
        self._commit(vertices, MEDIUM)
        self.functions.rtcAttachGeometry(self.scene, self.geometry)
        self.functions.rtcCommitScene(self.scene)

    def _buffer(self, kind: int, form: int, count: int) -> int:
        function, size = self.functions.rtcSetNewGeometryBuffer, ctypes.c_size_t
        return function(self.geometry, ctypes.c_int(kind), ctypes.c_uint(0), ctypes.c_int(form), size(12), size(count))

    def _commit(self, vertices: np.ndarray, quality: int) -> None:
        vertices = np.ascontiguousarray(vertices, np.float32)
        ctypes.memmove(self.vertices, vertices.ctypes.data, self.size)
        self.functions.rtcSetGeometryBuildQuality(self.geometry, ctypes.c_int(quality))
        self.functions.rtcUpdateGeometryBuffer(self.geometry, ctypes.c_int(VERTICES), ctypes.c_uint(0))
        self.functions.rtcCommitGeometry(self.geometry)

    def refit(self, vertices: np.ndarray) -> None:
        """Move the vertices; the tree keeps its shape."""
        self._commit(vertices, REFIT)
        self.functions.rtcCommitScene(self.scene)

    def __del__(self):
        if hasattr(self, "geometry"):
            self.functions.rtcReleaseGeometry(self.geometry)
        if hasattr(self, "scene"):
            self.functions.rtcReleaseScene(self.scene)
