"""Writes shapes with their materials as GLB files, through trimesh."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from jaxdr.argument_kinds import checked
from jaxdr.atomic_file import atomic_path
from jaxdr.geometry.load import cut_mesh
from jaxdr.scene.formats.gltf.surfaces import Surface, surface_of
from jaxdr.scene.scene import Shape

COLORS = "_colors"  # trimesh names attributes of its users so; glTF calls colours COLOR_0
OUTSIDE = ("normalTexture", "emissiveTexture")  # textures that are not inside of pbrMetallicRoughness


@checked
def save_gltf(path: str | os.PathLike, shapes: Mapping[str, Shape]) -> None:
    """Write shapes as a GLB file, each with its material: `save_gltf("scene.glb", scene.shapes)`.

    `load_gltf` and programs such as Blender read it. Positions stay as they are (glTF says that y is up) and vertices
    split where UVs or normals do. Written are the mesh, its UVs and normals, and of its BSDF:

    - `Principled` with base colour, metallic, roughness and specular, or `Diffuse`, which is read as a rough
      `Principled` that has no specular reflection; inside of `NormalMap`, `Mask` and `TwoSided` or not;
    - constants; `Bitmap`s, in 8 bits (colours in sRGB); `VertexColors` as base colour, in float32, or their `Product`;
    - `AreaEmitter`s of constants or `Bitmap`s.

    Camera, lights without area and environment are not. The file appears complete or not at all. Raises ValueError,
    with the name of the parameter, for a material that glTF can't hold; for no shapes, another extension than .glb and
    a missing folder.
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise ValueError(f"save_gltf: {path} must end with .glb")
    if not path.parent.is_dir():
        raise ValueError(f"save_gltf: there is no folder {path.parent}")
    if not shapes:
        raise ValueError("save_gltf: shapes is empty; give at least one shape")
    surfaces = {name: surface_of(name, shape) for name, shape in shapes.items()}
    data = _scene(shapes, surfaces).export(
        file_type="glb", unitize_normals=True, tree_postprocessor=lambda tree: _finish(tree, surfaces)
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _scene(shapes: Mapping[str, Shape], surfaces: dict[str, Surface]) -> Any:
    """A trimesh.Scene with meshes and images. What trimesh would round or drop comes later (`_finish`)."""
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    scene = trimesh.Scene()
    for name, shape in shapes.items():
        surface = surfaces[name]
        cut, rows = cut_mesh(shape.mesh)
        if surface.images:
            images: dict[str, Any] = {key: Image.fromarray(pixels) for key, pixels in surface.images.items()}
            cut.visual = TextureVisuals(cut.visual.uv, PBRMaterial(**images))
        if surface.colors is not None:
            cut.vertex_attributes[COLORS] = surface.colors[rows].astype(np.float32) * np.ones(3, np.float32)
        scene.add_geometry(cut, node_name=name, geom_name=name)
    return scene


def _finish(tree: dict[str, Any], surfaces: dict[str, Surface]) -> None:
    """Put the materials into the JSON of the file, with every digit, and the samplers of their textures."""
    materials, textures, samplers, extensions = [], [], [], set()
    for mesh in tree["meshes"]:
        surface, (primitive,) = surfaces[mesh["name"]], mesh["primitives"]
        material = surface.material
        extensions.update(material.get("extensions", {}))
        if surface.images:
            stored = tree["materials"][primitive["material"]]
            stored = {**stored, **stored.get("pbrMetallicRoughness", {})}
            for key, sampler in surface.samplers.items():
                source = tree["textures"][stored[key]["index"]]["source"]
                owner = material if key in OUTSIDE else material["pbrMetallicRoughness"]
                owner[key] = {"index": len(textures)}
                textures.append({"source": source, "sampler": len(samplers)})
                samplers.append(sampler)
        if COLORS in primitive["attributes"]:
            primitive["attributes"]["COLOR_0"] = primitive["attributes"].pop(COLORS)
        primitive["material"] = len(materials)
        materials.append(material)
    tree["materials"] = materials
    for key, items in (("textures", textures), ("samplers", samplers), ("extensionsUsed", sorted(extensions))):
        tree.pop(key, None)
        if items:
            tree[key] = items
