"""Accessors of glTF files: typed arrays in buffers, with strides, normalised integers and sparse changes."""

from typing import Any

import numpy as np

from jaxdr.geometry.gltf.document import Document, whole

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
INDEX_TYPES = (5121, 5123, 5125)


def read_accessor(document: Document, index: Any, place: str, *types: str) -> np.ndarray:
    """The values [n, size] of an accessor of one of the `types` ("VEC3", ...). Normalised integers become floats."""
    accessor = document.item("accessors", index, place)
    with document.at(f"{place}: accessor {index}"):
        _check(accessor, types)
        return normalized(accessor, _stored(document, accessor, f"{place}: accessor {index}"))


def read_indices(document: Document, index: Any, place: str) -> np.ndarray:
    """The vertex numbers [n] of an accessor."""
    accessor = document.item("accessors", index, place)
    with document.at(f"{place}: accessor {index}"):
        _check(accessor, ("SCALAR",))
        if not {"bufferView", "sparse"} & accessor.keys():
            raise ValueError("has no data; an extension that is not read may hold it")
        if accessor["componentType"] not in INDEX_TYPES:
            raise ValueError(f"indices must be unsigned integers, not of componentType {accessor['componentType']}")
        return _stored(document, accessor, f"{place}: accessor {index}")[:, 0].astype(np.int64)


def normalized(accessor: dict, values: np.ndarray) -> np.ndarray:
    """Floats for integers that an accessor declares to be shares of their type's range; other values unchanged."""
    if not accessor.get("normalized", False) or values.dtype.kind == "f":
        return values
    return np.maximum(values / np.iinfo(values.dtype).max, -1.0)


def _check(accessor: dict, types: tuple[str, ...]) -> None:
    if accessor["type"] not in types:
        raise ValueError(f"must be of type {' or '.join(types)}, not {accessor['type']!r}")
    if whole(accessor, "componentType") not in COMPONENTS:
        raise ValueError(f"has an unknown componentType {accessor['componentType']}")
    if whole(accessor, "count") < 1:
        raise ValueError("count must be at least 1")


def _stored(document: Document, accessor: dict, place: str) -> np.ndarray:
    dtype, size, count = np.dtype(COMPONENTS[accessor["componentType"]]), SIZES[accessor["type"]], accessor["count"]
    if "bufferView" in accessor:
        view = document.item("bufferViews", accessor["bufferView"], place)
        data = document.view(accessor["bufferView"], place)
        values = _array(data, dtype, (count, size), whole(accessor, "byteOffset", 0), view.get("byteStride"))
    else:
        document.check_values_without_data(count)
        values = np.zeros((count, size), dtype)
    if "sparse" in accessor:
        values = _with_sparse(document, accessor["sparse"], values, f"{place}: sparse")
    return values


def _with_sparse(document: Document, sparse: dict, values: np.ndarray, place: str) -> np.ndarray:
    """The values, with the rows replaced that a sparse accessor stores separately."""
    count, rows, new = whole(sparse, "count"), sparse["indices"], sparse["values"]
    if whole(rows, "componentType") not in INDEX_TYPES:
        raise ValueError(f"sparse indices must be unsigned integers, not of componentType {rows['componentType']}")
    if count < 1:
        raise ValueError("the count of sparse values must be at least 1")
    data, dtype = document.view(rows["bufferView"], place), np.dtype(COMPONENTS[rows["componentType"]])
    indices = _array(data, dtype, (count, 1), whole(rows, "byteOffset", 0), None)[:, 0]
    if indices.max() >= len(values):
        raise ValueError(f"sparse indices go up to {indices.max()}; there are {len(values)} values")
    data = document.view(new["bufferView"], place)
    values = values.copy()
    values[indices] = _array(data, values.dtype, (count, values.shape[1]), whole(new, "byteOffset", 0), None)
    return values


def _array(
    data: bytes | memoryview, dtype: np.dtype, shape: tuple[int, int], offset: int, stride: int | None
) -> np.ndarray:
    """Rows of a table in bytes. Raises ValueError if bytes are missing."""
    row = dtype.itemsize * shape[1]
    step = row if stride is None else stride
    end = offset + step * (shape[0] - 1) + row
    if offset < 0 or step < row or end > len(data):
        raise ValueError(f"its {shape[0]} values need {end} bytes, and the bufferView has {len(data)}")
    return np.ndarray(shape, dtype, data, offset, (step, dtype.itemsize))
