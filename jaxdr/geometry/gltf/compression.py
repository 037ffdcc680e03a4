"""Compressed meshes: Draco through DracoPy (the extra `gltf`), meshopt through meshoptimizer (the extra `meshopt`)."""

from typing import Any

import numpy as np

from jaxdr.untrusted import damage, whole

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
FILTERS = {"OCTAHEDRAL": "decode_filter_oct", "QUATERNION": "decode_filter_quat", "EXPONENTIAL": "decode_filter_exp"}
LONGEST_ROW = 256  # bytes of a value that meshopt compresses
MOST_VALUES = {"TRIANGLES": 3, "INDICES": 1}  # that meshopt makes from a byte
MOST_BYTES = 1024  # that meshopt makes from a byte in its other mode, where rows repeat


def meshopt_extension(view: dict) -> dict | None:
    """The meshopt extension of a buffer view; None if the view is not compressed."""
    extensions = view.get("extensions", {})
    return next((extensions[name] for name in MESHOPT if name in extensions), None)


def meshopt_view(extension: dict, data: bytes) -> bytes:
    """The decompressed bytes of a buffer view that meshopt compressed. Raises ValueError if that is impossible."""
    try:
        import meshoptimizer  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ValueError(
            f'it is compressed ({MESHOPT[0]}), and the package meshoptimizer is missing; pip install -e ".[meshopt]" '
            "(it needs a C++ compiler), or decompress the file with another tool"
        ) from error
    mode, filtered = extension["mode"], extension.get("filter", "NONE")
    if mode not in ("ATTRIBUTES", *MOST_VALUES) or filtered not in ("NONE", *FILTERS):
        raise ValueError(f"{MESHOPT[0]}: mode {mode!r} with filter {filtered!r} is not supported")
    count = whole(extension["count"], "count", 1)
    stride = whole(extension["byteStride"], "byteStride", 2, LONGEST_ROW)
    needed, most = (count, MOST_VALUES[mode]) if mode in MOST_VALUES else (count * stride, MOST_BYTES)
    if needed > most * len(data):
        raise ValueError(f"its {len(data)} compressed bytes can't hold {count} values of {stride} bytes")
    with damage(f"{MESHOPT[0]}: its data can't be decoded"):
        return _meshopt_bytes(meshoptimizer, mode, filtered, count, stride, data)


def _meshopt_bytes(library: Any, mode: str, filtered: str, count: int, stride: int, data: bytes) -> bytes:
    if mode in MOST_VALUES:
        decode = library.decode_index_buffer if mode == "TRIANGLES" else library.decode_index_sequence
        return decode(count, 4, data).astype(f"<u{stride}").tobytes()
    decoded = library.decode_vertex_buffer(count, stride, data, np.dtype((np.void, stride)))
    if filtered != "NONE":
        decoded = getattr(library, FILTERS[filtered])(decoded, count, stride)
    return decoded.tobytes()


def has_draco() -> bool:
    """Whether Draco meshes can be read."""
    try:
        import DracoPy  # noqa: F401
    except ImportError:
        return False
    return True


def draco_mesh(extension: dict, data: bytes) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """(attributes by name [n, size], faces [F, 3]) of a primitive's Draco data; integers are not normalised."""
    import DracoPy

    mesh: Any = DracoPy.decode(data)
    attributes = {
        name: np.asarray(mesh.get_attribute_by_unique_id(number)["data"])
        for name, number in extension["attributes"].items()
    }
    return attributes, np.asarray(mesh.faces, np.int64).reshape(-1, 3)
