"""The GLB of a reconstruction."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.optimize.reconstruction.atlas import bake, unwrapped
from jaxdr.scene.bsdf import Principled
from jaxdr.scene.formats.gltf.save import save_gltf
from jaxdr.scene.scene import Shape
from jaxdr.scene.textures import Bitmap

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
    if albedo.ndim == 2:
        mesh = unwrapped(mesh, size)
        albedo = bake(mesh, albedo, size)
    rough = bake(mesh, roughness[:, None], size)
    color, alpha = (Bitmap(np.clip(pixels, 0.0, 1.0)) for pixels in (albedo, rough))
    save_gltf(path, {NAME: Shape(mesh, Principled(color, 0.0, alpha))})
