"""Triangle meshes: positions, UVs and shading normals, each with its own indices."""

import dataclasses
import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_array, on_host, traced
from jaxdr.callers_line import warn
from jaxdr.geometry.edges import INTERIOR, Edges, build_edges
from jaxdr.geometry.vector import cross, dot, normalize, scale


class EmptyMesh(ValueError):
    """A mesh without triangles, or whose triangles have no area."""


class MeshArrays(NamedTuple):
    """The arrays of a `Mesh`, not checked yet: positions, UVs and smoothing groups with their own indices."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "T 2"] | None = None
    uv_faces: Int[np.ndarray, "F 3"] | None = None
    normal_faces: Int[np.ndarray, "F 3"] | None = None

    def turned(self) -> "MeshArrays":
        """The mesh turned inside out."""
        uv_faces, normal_faces = (None if f is None else f[:, ::-1] for f in (self.uv_faces, self.normal_faces))
        return MeshArrays(self.vertices, self.faces[:, ::-1], self.uvs, uv_faces, normal_faces)


@checked
class Mesh(eqx.Module):
    """Indexed triangles, counter-clockwise seen from outside.

    Positions, UVs and normals are indexed separately: a UV seam or a hard edge never splits a vertex. Vertices and UVs
    are float leaves, which may be differentiated. The topology is integer leaves, built once on the host.

    **Fields**

    - `vertices` [V, 3]: positions, in scene units.
    - `faces` [F, 3]: corner -> row of `vertices`.
    - `uvs` [T, 2], `uv_faces` [F, 3]: texture coordinates, (0, 0) at an image's lower left as in OBJ files, and corner
      -> row of `uvs`. Both are None without texture coordinates.
    - `normal_faces` [F, 3]: corner -> smoothing group, whose corners share one interpolated normal; None for flat
      shading.
    - `edges`: the edges and the faces at them, in spatial order, so that trees over them need no sorting.
    - `closed`: watertight and consistently oriented, that is, every edge is interior.
    - `normal_group_count`: number of smoothing groups G, zero for flat shading.

    Raises ValueError for arrays of another shape or type, values that are not finite, indices out of range, and meshes
    without area. Warns of faces without area, which are dropped, and of edges that coincide without sharing vertices.
    """

    vertices: Float[Array, "V 3"]
    faces: Int[Array, "F 3"]
    uvs: Float[Array, "T 2"] | None
    uv_faces: Int[Array, "F 3"] | None
    normal_faces: Int[Array, "F 3"] | None
    edges: Edges
    closed: bool = eqx.field(static=True)
    normal_group_count: int = eqx.field(static=True)

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        uvs: ArrayLike | None = None,
        uv_faces: ArrayLike | None = None,
        normal_faces: ArrayLike | None = None,
    ):
        """Check concrete arrays (see the fields for their shapes) and build the topology.

        Equal positions stay separate vertices; `weld` merges them. Vertices are stored in JAX's default float type.
        Faces without area in that precision are dropped, with one warning that counts them. Another warning counts
        edges that coincide without sharing vertices (split vertices, duplicate faces). Raises ValueError for traced
        arrays, wrong shapes or types, positions or UVs that are not finite, an index out of range, and a mesh without
        any face.
        """
        if traced(vertices):
            raise ValueError("Mesh: needs concrete vertices; under jit or grad use mesh.with_vertices(vertices)")
        _require_concrete(faces=faces, uvs=uvs, uv_faces=uv_faces, normal_faces=normal_faces)
        if (uvs is None) != (uv_faces is None):
            raise ValueError("Mesh: needs uvs and uv_faces together, or neither")
        points = _checked_floats("vertices", vertices, 3)
        corners = _checked_indices("faces", faces, len(points), "vertices")
        kept = has_area(points, corners)
        if not kept.any():
            raise EmptyMesh(f"Mesh: none of the {len(corners)} faces has an area")
        if not kept.all():
            warn(f"Mesh: dropped {np.sum(~kept)} of {len(kept)} faces, which have no area")

        def kept_corners(name, indices, count, target):
            checked = _checked_indices(name, indices, count, target)
            if len(checked) != len(kept):
                raise ValueError(f"Mesh: {name} has {len(checked)} rows for {len(kept)} faces; give one per face")
            return as_array(checked[kept], np.int32)

        self.vertices = as_array(points)
        self.faces = as_array(corners[kept], np.int32)
        self.uvs = self.uv_faces = self.normal_faces = None
        self.normal_group_count = 0
        if uvs is not None:
            texture_points = _checked_floats("uvs", uvs, 2)
            self.uvs = as_array(texture_points)
            self.uv_faces = kept_corners("uv_faces", uv_faces, len(texture_points), "uvs")
        if normal_faces is not None:
            self.normal_faces = kept_corners("normal_faces", normal_faces, None, "smoothing groups")
            self.normal_group_count = int(np.asarray(self.normal_faces).max()) + 1
        self.edges = build_edges(corners[kept], points)
        first = _first_on_one_another(points, np.asarray(self.edges.vertices))
        doubled = np.sum(first != np.arange(len(first)))
        if doubled:
            self.edges = dataclasses.replace(self.edges, first=as_array(first, np.int32))
            warn(
                f"Mesh: {doubled} edges lie on others without sharing vertices, as at split vertices and duplicate "
                "faces. Derivatives are right only while such edges move together, and gradients pull them apart; "
                "let faces share vertices (load_mesh joins them by position), and drop duplicate faces"
            )
        self.closed = bool(np.all(np.asarray(self.edges.kind) == INTERIOR))

    def with_vertices(self, vertices: Float[Array | np.ndarray, "V 3"]) -> "Mesh":
        """The same topology at other positions. Traceable; the values of traced positions are not checked.

        Raises `ValueError` if the number of vertices changes, and for concrete positions that are not finite.
        """
        vertices = as_array(vertices, self.vertices.dtype)
        if not isinstance(vertices, Tracer) and not (finite := np.isfinite(np.asarray(vertices))).all():
            first = np.argwhere(~finite)[0].tolist()
            raise ValueError(
                f"Mesh.with_vertices: vertices must be finite, and {np.sum(~finite)} of {finite.size} values are not, "
                f"the first at {first}"
            )
        if vertices.shape != self.vertices.shape:
            raise ValueError(f"Mesh.with_vertices: this mesh needs shape {self.vertices.shape}, got {vertices.shape}")
        return self._with({"vertices": vertices})

    def with_uvs(self, uvs: ArrayLike, uv_faces: ArrayLike) -> "Mesh":
        """The same mesh with other texture coordinates; on the host. Raises ValueError as the constructor does."""
        _require_concrete(uvs=uvs, uv_faces=uv_faces)
        points = _checked_floats("uvs", uvs, 2)
        corners = _checked_indices("uv_faces", uv_faces, len(points), "uvs")
        if len(corners) != len(self.faces):
            raise ValueError(f"Mesh: uv_faces has {len(corners)} rows for {len(self.faces)} faces; give one per face")
        return self._with({"uvs": as_array(points), "uv_faces": as_array(corners, np.int32)})

    def vertex_normals(self) -> Float[Array, "G 3"]:
        """Unit normal of every smoothing group: face normals weighted by corner angle (Thürmer and Wüthrich 1998).

        Differentiable in the vertices and finite everywhere; zero for a group whose faces have no area or cancel out.
        Raises `ValueError` for a flat-shaded mesh.
        """
        if self.normal_faces is None:
            raise ValueError("Mesh.vertex_normals: flat shading has none; use mesh.smooth().vertex_normals()")
        return _group_normals(self.vertices, self.faces, self.normal_faces, self.normal_group_count)

    def smooth(self) -> "Mesh":
        """The same mesh with one interpolated normal per vertex. Traceable."""
        return self._with_normal_faces(self.faces, self.vertices.shape[0])

    def flat(self) -> "Mesh":
        """The same mesh with flat shading: the face normal everywhere on a face. Traceable."""
        return self._with_normal_faces(None, 0)

    def turned(self, turns: bool | Bool[Array, ""] = True) -> "Mesh":
        """The same mesh turned inside out if `turns`, which may be traced: corners of faces in the other order."""
        if turns is False:
            return self

        def reversed_if(indices):
            if indices is None or isinstance(turns, bool):
                return None if indices is None else as_array(on_host(indices)[..., ::-1], np.int32)
            return jnp.where(turns, indices[..., ::-1], indices)

        corners = {name: reversed_if(getattr(self, name)) for name in ("faces", "uv_faces", "normal_faces")}
        # Each face runs through its edges the other way. So it is still the one at the same place of the table.
        edges = dataclasses.replace(self.edges, vertices=reversed_if(self.edges.vertices))
        return self._with(corners | {"edges": edges})

    def _with_normal_faces(self, normal_faces: Int[Array, "F 3"] | None, group_count: int) -> "Mesh":
        return self._with({"normal_faces": normal_faces, "normal_group_count": group_count})

    def _with(self, changed: dict) -> "Mesh":
        """The same mesh with some fields changed, unchecked."""
        # eqx.tree_at is slow and cannot replace a static field; __init__ needs concrete arrays.
        mesh = object.__new__(Mesh)
        for field in dataclasses.fields(self):
            object.__setattr__(mesh, field.name, changed.get(field.name, getattr(self, field.name)))
        return mesh


def weld(
    vertices: Float[np.ndarray, "V D"], faces: Int[np.ndarray, "..."]
) -> tuple[Float[np.ndarray, "W D"], Int[np.ndarray, "..."]]:
    """Merge positions (or other rows) that are equal in float32, on the host. The first of equal rows stays, in order.

    `faces` are indices of any shape.
    """
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    position = vertices.astype(np.float32) + 0.0  # +0 makes -0.0 a plain zero
    order = np.lexsort(position.T)
    position = position[order]
    starts_set = np.concatenate([[True], np.any(position[1:] != position[:-1], axis=1)])
    # lexsort is stable: the first of equal rows in sorted order is the first in the input as well.
    representative = np.empty(len(order), np.int64)
    representative[order] = order[starts_set][np.cumsum(starts_set) - 1]
    kept, new_index = np.unique(representative, return_inverse=True)
    return vertices[kept], new_index[faces]


@partial(jax.jit, static_argnames="group_count")
def _group_normals(
    vertices: Float[Array, "V 3"], faces: Int[Array, "F 3"], normal_faces: Int[Array, "F 3"], group_count: int
) -> Float[Array, "G 3"]:
    corners = vertices[faces]  # [F, 3 corners, 3]
    to_next = normalize(jnp.roll(corners, -1, axis=1) - corners)
    to_previous = normalize(jnp.roll(corners, 1, axis=1) - corners)
    crossed = cross(to_next, to_previous)
    normals = normalize(crossed)
    # Unlike arccos, atan2 of sine and cosine is smooth at 0 and 180 degrees, but not at (0, 0), which a side of length
    # zero gives. Then the normal is zero, so any other cosine will do.
    sine, cosine = dot(normals, crossed), dot(to_next, to_previous)
    angles = jnp.arctan2(sine, jnp.where((sine == 0) & (cosine == 0), 1.0, cosine))
    weighted = scale(normals, angles).reshape(-1, 3)
    return normalize(jax.ops.segment_sum(weighted, normal_faces.reshape(-1), group_count))


def _first_on_one_another(points: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """For every edge, the first edge whose ends are at the same positions."""
    ends = points[edges] + 0.0  # +0 makes -0.0 a plain zero
    first = np.arange(len(edges))
    # Edges that coincide have the same number, others hardly ever. Sorting numbers is far faster than sorting rows.
    low, high = (extreme(ends[:, 0], ends[:, 1]) for extreme in (np.minimum, np.maximum))
    mixed = low + math.sqrt(2) * high
    # Sum term by term: a matrix product would round rows differently.
    number = mixed[:, 0] + math.sqrt(3) * mixed[:, 1] + math.sqrt(5) * mixed[:, 2]
    order = np.argsort(number)
    same = np.diff(number[order]) == 0
    alike = np.sort(order[np.append(same, False) | np.insert(same, 0, False)])
    if not len(alike):
        return first
    ends = ends[alike]
    first_is_less = (ends[:, 0] < ends[:, 1])[np.arange(len(ends)), (ends[:, 0] != ends[:, 1]).argmax(1)]
    ends = np.where(first_is_less[:, None, None], ends, ends[:, ::-1]).reshape(-1, 6)
    _, earliest, group = np.unique(ends, axis=0, return_index=True, return_inverse=True)
    first[alike] = alike[earliest[group.reshape(-1)]]
    return first


def _checked_floats(name: str, values: ArrayLike, width: int) -> np.ndarray:
    array = np.asarray(values)
    if array.size == 0:
        raise ValueError(f"Mesh: {name} is empty")
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "fiu":
        raise ValueError(f"Mesh: {name} must be numbers of shape [n, {width}], not {array.dtype} {list(array.shape)}")
    with np.errstate(over="ignore"):  # an overflow becomes inf, which the next check names
        array = array.astype(jnp.result_type(float))
    finite = np.isfinite(array).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ValueError(f"Mesh: {name}[{row}] = {array[row].tolist()} is not finite ({np.sum(~finite)} such rows)")
    return array


def _require_concrete(**arrays: ArrayLike | None) -> None:
    for name, array in arrays.items():
        if traced(array):
            raise ValueError(f"Mesh: needs concrete {name}, not traced ones: make the mesh outside of jit and grad")


def _checked_indices(name: str, indices: ArrayLike, count: int | None, target: str) -> np.ndarray:
    array = np.asarray(indices)
    if array.size == 0:
        raise ValueError(f"Mesh: {name} is empty")
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise ValueError(f"Mesh: {name} must be integers of shape [n, 3], not {array.dtype} {list(array.shape)}")
    limit = np.iinfo(np.int32).max if count is None else count
    outside = np.any((array < 0) | (array >= limit), axis=1)
    if outside.any():
        row = int(np.argmax(outside))
        raise ValueError(f"Mesh: {name}[{row}] = {array[row].tolist()} is out of range: there are {limit} {target}")
    return array


def has_area(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Whether each face has an area: over its longest side squared, it exceeds rounding in the vertices' type."""
    a, b, c = (points[corners[:, k]].astype(np.float64) for k in range(3))
    longest_squared = np.max([np.sum((q - p) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    distinct = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    double_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return distinct & (double_area > np.finfo(points.dtype).eps * longest_squared)
