"""Textures over an atlas, and the GLB that holds them."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.geometry.mesh import Mesh
from jaxdr.images import to_srgb

NAME = "object"  # of mesh, node and material


class Atlas(NamedTuple):
    """A mesh cut open: `vertices` of the mesh that its own came from, `faces` of its own, and `uvs` in [0, 1]²."""

    vertices: Int[np.ndarray, " W"]
    faces: Int[np.ndarray, "F 3"]
    uvs: Float[np.ndarray, "W 2"]


def unwrap(mesh: Mesh) -> Atlas:
    """Charts side by side, by xatlas. Raises ImportError without it."""
    xatlas = require_xatlas()
    points, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    found: Any = xatlas.parametrize(points, faces, np.asarray(mesh.vertex_normals(), np.float32))
    vertices, faces, uvs = found
    return Atlas(vertices.astype(np.int64), faces.astype(np.int64), np.asarray(uvs, float))


def bake(atlas: Atlas, values: Float[np.ndarray, "V C"], size: int) -> Float[np.ndarray, "size size C"]:
    """A texture of values at the vertices of the mesh, interpolated over its faces; the top row first.

    Texels outside of the charts have the values of the nearest texel inside: look-ups between texels may reach them.
    """
    import trimesh
    from scipy.ndimage import distance_transform_edt

    flat = np.concatenate([atlas.uvs * size, np.zeros((len(atlas.uvs), 1))], 1)
    charts = trimesh.Trimesh(flat, atlas.faces, process=False)
    x, y = np.meshgrid(np.arange(size) + 0.5, size - np.arange(size) - 0.5)
    origins = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    directions = np.broadcast_to([0.0, 0, -1], origins.shape)
    hits: Any = charts.ray.intersects_id(origins, directions, multiple_hits=False)
    face, ray = hits
    corners = flat[atlas.faces[face]]
    weights = trimesh.triangles.points_to_barycentric(corners, origins[ray] * [1, 1, 0])
    found = np.asarray(values, float)[atlas.vertices[atlas.faces[face]]]
    texture = np.zeros((size * size, found.shape[-1]))
    texture[ray] = (np.clip(weights, 0, 1)[..., None] * found).sum(1)
    inside = np.zeros(size * size, bool)
    inside[ray] = True
    texture, inside = texture.reshape(size, size, -1), inside.reshape(size, size)
    nearest: Any = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return texture[tuple(nearest)]


def write_glb(
    path: Path, mesh: Mesh, albedo: Float[np.ndarray, "V 3"], roughness: Float[np.ndarray, " V"], size: int
) -> None:
    """Write a GLB with normals, and textures of base colour and roughness, `size` pixels wide; it is no metal.

    Positions stay as they are. The file appears complete or not at all.
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    atlas = unwrap(mesh)
    texture = bake(atlas, np.concatenate([albedo, roughness[:, None]], 1), size)
    surface = np.zeros((size, size, 3))
    surface[..., 1] = np.clip(texture[..., 3], 0, 1)  # green holds roughness, blue metal
    material = PBRMaterial(
        name=NAME,
        baseColorTexture=Image.fromarray(to_srgb(texture[..., :3])),
        metallicRoughnessTexture=Image.fromarray(np.round(255 * surface).astype(np.uint8)),
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    cut = trimesh.Trimesh(
        np.asarray(mesh.vertices)[atlas.vertices],
        atlas.faces,
        vertex_normals=np.asarray(mesh.vertex_normals())[atlas.vertices],
        visual=TextureVisuals(uv=atlas.uvs, material=material),
        process=False,
    )
    scene = trimesh.Scene()
    scene.add_geometry(cut, node_name=NAME, geom_name=NAME)
    data: Any = scene.export(file_type="glb", include_normals=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def require_xatlas() -> Any:
    """The package. Raises ImportError that says how to install it."""
    try:
        import xatlas
    except ImportError as missing:
        raise ImportError('textures need xatlas, which is optional: pip install "jaxdr[reconstruct]"') from missing
    return xatlas
