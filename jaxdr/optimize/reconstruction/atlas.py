"""Texture coordinates by xatlas, and textures over them. Arrays here are NumPy's, on the host."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.queries import Geometry, Rays, closest_hit

PADDING = 2  # texels between charts: what lies between texels of one chart never reaches into another


class Texels(NamedTuple):
    """The texels of a square texture whose centres lie on the surface.

    `index`: of the flattened texture, the top row first; `face`; `weights`: barycentric coordinates.
    """

    index: Int[np.ndarray, " T"]
    face: Int[np.ndarray, " T"]
    weights: Float[np.ndarray, "T 3"]


def unwrapped(mesh: Mesh, size: int) -> Mesh:
    """The mesh with texture coordinates in [0, 1]²: charts side by side, for textures that are `size` pixels wide.

    `mesh` has one normal per vertex. Raises ImportError without xatlas.
    """
    xatlas = require_xatlas()
    points, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    atlas, packing = xatlas.Atlas(), xatlas.PackOptions()
    packing.padding, packing.resolution = PADDING, size
    atlas.add_mesh(points, faces, np.asarray(mesh.vertex_normals(), np.float32))
    atlas.generate(pack_options=packing)
    _, uv_faces, uvs = atlas[0]
    return mesh.with_uvs(uvs, uv_faces)


def rows_of_uvs(mesh: Mesh) -> Int[np.ndarray, " T"]:
    """The vertex of every row of the texture coordinates."""
    uvs, uv_faces = _coordinates(mesh)
    rows = np.zeros(len(uvs), np.int64)
    rows[uv_faces] = np.asarray(mesh.faces)
    return rows


def covered(mesh: Mesh, size: int) -> Texels:
    """The texels that a mesh with texture coordinates covers."""
    uvs, uv_faces = _coordinates(mesh)
    flat = np.concatenate([uvs * size, np.zeros((len(uvs), 1))], 1)
    x, y = np.meshgrid(np.arange(size) + 0.5, size - np.arange(size) - 0.5)
    origins = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    down = np.broadcast_to([0.0, 0, -1], origins.shape)
    rays = Rays(*(jnp.asarray(a, jnp.float32) for a in (origins, down, np.full(len(origins), 2.0))))
    charts = Geometry(jnp.asarray(flat, jnp.float32), jnp.asarray(uv_faces))
    face, _, weights = (np.asarray(answer) for answer in closest_hit(charts, rays))
    index = np.flatnonzero(face >= 0)
    return Texels(index, face[index], np.clip(weights[index].astype(float), 0, 1))


def interpolated(mesh: Mesh, texels: Texels, values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "T C"]:
    """Values at texels from values at vertices."""
    corners = np.asarray(values, float)[np.asarray(mesh.faces)[texels.face]]
    return (texels.weights[..., None] * corners).sum(1)


def filled(texels: Texels, values: Float[np.ndarray, "T C"], size: int) -> Float[np.ndarray, "size size C"]:
    """The texture with these values. Other texels have the value of the nearest one: look-ups may reach them."""
    from scipy.ndimage import distance_transform_edt

    texture, inside = np.zeros((size * size, values.shape[-1])), _inside(texels, size)
    texture[texels.index] = values
    nearest: Any = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return texture.reshape(size, size, -1)[tuple(nearest)]


def bake(mesh: Mesh, values: Float[np.ndarray, "V C"], size: int) -> Float[np.ndarray, "size size C"]:
    """The texture of values at the vertices of a mesh with texture coordinates; the top row first."""
    texels = covered(mesh, size)
    return filled(texels, interpolated(mesh, texels, values), size)


def neighbours(texels: Texels, size: int) -> Int[np.ndarray, "P 2"]:
    """Pairs of texels side by side, or one above the other, one of which at least is covered."""
    number, inside = np.arange(size * size).reshape(size, size), _inside(texels, size).ravel()
    beside = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], -1)
    below = np.stack([number[:-1].ravel(), number[1:].ravel()], -1)
    pairs = np.concatenate([beside, below])
    return pairs[inside[pairs].any(1)]


def at_vertices(mesh: Mesh, texture: Float[np.ndarray | Array, "H W C"]) -> Float[np.ndarray, "V C"]:
    """Values at vertices: those of the nearest texel."""
    texture = np.asarray(texture, float)
    height, width, channels = texture.shape
    uvs, _ = _coordinates(mesh)
    column = np.clip((uvs[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1 - uvs[:, 1]) * height).astype(int), 0, height - 1)
    values = np.zeros((len(mesh.vertices), channels))
    values[rows_of_uvs(mesh)] = texture[row, column]
    return values


def require_xatlas() -> Any:
    """The package. Raises ImportError that says how to install it."""
    try:
        import xatlas
    except ImportError as missing:
        raise ImportError('textures need xatlas, which is optional: pip install -e ".[reconstruct]"') from missing
    return xatlas


def _coordinates(mesh: Mesh) -> tuple[Float[np.ndarray, "T 2"], Int[np.ndarray, "F 3"]]:
    assert mesh.uvs is not None  # `unwrapped` gives some
    return np.asarray(mesh.uvs, float), np.asarray(mesh.uv_faces)


def _inside(texels: Texels, size: int):
    inside = np.zeros(size * size, bool)
    inside[texels.index] = True
    return inside.reshape(size, size)
