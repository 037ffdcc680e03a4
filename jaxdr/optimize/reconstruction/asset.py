"""The GLB of a reconstruction."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.atomic_file import atomic_path
from jaxdr.geometry.mesh import Mesh
from jaxdr.images import to_srgb
from jaxdr.optimize.reconstruction.atlas import bake, rows_of_uvs, unwrapped

NAME = "object"  # of mesh, node and material


def write_glb(
    path: Path,
    mesh: Mesh,
    albedo: Float[np.ndarray, "V 3"] | Float[np.ndarray, "H W 3"],
    roughness: Float[np.ndarray, " V"],
    size: int,
) -> None:
    """Write a GLB with normals, and textures of base colour and roughness; it is no metal.

    `albedo` at vertices and `roughness` are baked into textures that are `size` pixels wide. A texture of albedo stays
    as it is; the mesh has texture coordinates then. Positions stay as they are. The file appears complete or not at
    all. Raises ImportError without xatlas.
    """
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if albedo.ndim == 2:
        mesh = unwrapped(mesh, size)
        albedo = bake(mesh, albedo, size)
    surface = np.zeros((size, size, 3))
    surface[..., 1] = np.clip(bake(mesh, roughness[:, None], size)[..., 0], 0, 1)  # green holds roughness, blue metal
    material = PBRMaterial(
        name=NAME,
        baseColorTexture=Image.fromarray(to_srgb(albedo)),
        metallicRoughnessTexture=Image.fromarray(np.round(255 * surface).astype(np.uint8)),
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    rows = rows_of_uvs(mesh)
    cut = trimesh.Trimesh(
        np.asarray(mesh.vertices)[rows],
        np.asarray(mesh.uv_faces),
        vertex_normals=np.asarray(mesh.vertex_normals())[rows],
        visual=TextureVisuals(uv=np.asarray(mesh.uvs), material=material),
        process=False,
    )
    scene = trimesh.Scene()
    scene.add_geometry(cut, node_name=NAME, geom_name=NAME)
    data: Any = scene.export(file_type="glb", include_normals=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)
