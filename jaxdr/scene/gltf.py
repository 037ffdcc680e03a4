"""glTF 2.0 scenes (.glb, .gltf): nodes, meshes, materials and cameras. trimesh decodes the buffers."""

import contextlib
import itertools
import json
import os
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.load import Part, is_triangles, joined
from jaxdr.scene.bsdf import BSDF, NormalMap, Principled, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.film import Film
from jaxdr.scene.gltf_textures import (
    color,
    metallic_roughness,
    normal_map,
    texture_infos,
    unsupported_textures,
)
from jaxdr.scene.scene import RESERVED, Scene, Shape

EXTENSIONS = (".glb", ".gltf")
SUPPORTED = ("KHR_materials_emissive_strength",)
LINE_LOOP, LINE_STRIP, TRIANGLE_FAN = 2, 3, 6  # primitive modes that trimesh leaves out
FRAMING_FOV = 40.0  # degrees
FRAMING_DIRECTION = np.array([0.4, 0.3, 1.0])  # from the scene to the camera: assets face +z, and y is up

Matrix = Float[np.ndarray, "4 4"]


def is_gltf(path: str | os.PathLike) -> bool:
    """Whether a file is one for `load_gltf`, by its name."""
    return Path(path).suffix.lower() in EXTENSIONS


def load_gltf(
    path: str | os.PathLike, *, width: int = 512, height: int | None = None, ignore_unsupported: bool = False
) -> Scene:
    """The scene in a glTF 2.0 file, y up, in its units: one shape for each mesh primitive of each node.

    - Shapes are named by their nodes, with a number where names repeat. Normals are those of the file's smoothing
      groups (`load_mesh`, shading "file").
    - Base colour, metallic and roughness become a `Principled` BSDF, with their textures. It is two-sided where the
      material is, and in a `NormalMap` where there is one.
    - Emissive factors become area emitters, with their textures. Where nothing emits, there is a constant environment
      of radiance 1.
    - The first camera is taken, or one that shows the whole scene from the front.
    - The film is `width` pixels wide. Without `height` the camera's aspect ratio gives it (square without one).

    Raises one ValueError that lists whatever else is not supported (vertex colours, transparency, lights, animations,
    other extensions). With `ignore_unsupported` that becomes warnings, and the rest is loaded. Raises ValueError for a
    missing or damaged file.
    """
    path = Path(path)
    if not is_gltf(path):
        raise ValueError(f"load_gltf: {path} has an unknown extension; known are {', '.join(EXTENSIONS)}")
    if not path.is_file():
        raise ValueError(f"load_gltf: there is no file {path}")
    with _readable(path):
        header = _header(path)
        nodes = list(_nodes(header))
        problems = list(dict.fromkeys(_unsupported(header, nodes)))
    _report(path, problems, ignore_unsupported)
    import trimesh  # on use: importing it takes long

    with _readable(path):
        primitives = _primitives(header, trimesh.load_scene(path, process=False))
        shapes = dict(_shapes(header, nodes, primitives))
    if not shapes:
        raise ValueError(f"load_gltf: {path} has no triangles")
    with _readable(path):
        camera = _camera(header, nodes, shapes, width, height)
    glows = any(shape.emitter is not None for shape in shapes.values())
    return Scene(shapes=shapes, camera=camera, environment=None if glows else ConstantEnvironment(1.0))


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # whatever a broken file makes trimesh raise, and indices in the JSON that lead nowhere
        raise ValueError(f"load_gltf: {path} is not a readable glTF file ({type(error).__name__}: {error})") from error


def _header(path: Path) -> dict:
    """The JSON of a .gltf, or of the first chunk of a .glb."""
    data = path.read_bytes()
    if data[:4] == b"glTF":
        (length,) = struct.unpack_from("<I", data, 12)
        data = data[20 : 20 + length]
    header = json.loads(data)
    version = header["asset"]["version"]
    if not version.startswith("2."):
        raise ValueError(f"glTF version {version!r}; only 2.x is supported")
    return header


def _nodes(header: dict) -> Iterator[tuple[dict, Matrix]]:
    """The nodes of the file's default scene, parents first, with their node-to-world matrices."""
    nodes = header.get("nodes", [])
    if "scenes" in header:
        roots = header["scenes"][header.get("scene", 0)].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])})
    waiting = [(index, np.eye(4)) for index in reversed(roots)]
    seen = set()
    while waiting:
        index, parent = waiting.pop()
        if index in seen:
            raise ValueError(f"node {index} has two parents")
        seen.add(index)
        to_world = parent @ _node_matrix(nodes[index])
        yield nodes[index], to_world
        waiting += [(child, to_world) for child in reversed(nodes[index].get("children", []))]


def _node_matrix(node: dict) -> Matrix:
    """A node's `matrix` (stored by columns), or translation · rotation (quaternion x, y, z, w) · scale."""
    from trimesh.transformations import quaternion_matrix

    if "matrix" in node:
        return np.reshape(node["matrix"], (4, 4)).T.astype(float)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    matrix = quaternion_matrix([w, x, y, z])
    matrix[:3, :3] *= node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _primitives(header: dict, content: Any) -> list[list[tuple[dict, object]]]:
    """For each mesh its primitives, with what trimesh made of them: it keeps the order and leaves some modes out."""
    decoded = iter(content.geometry.values())
    left_out = (LINE_LOOP, LINE_STRIP, TRIANGLE_FAN)
    meshes = [
        [(p, next(decoded)) for p in mesh["primitives"] if p.get("mode", 4) not in left_out]
        for mesh in header.get("meshes", [])
    ]
    if next(decoded, None) is not None:
        raise ValueError("trimesh found more meshes than the header names")
    return meshes


def _shapes(header: dict, nodes: list, primitives: list) -> Iterator[tuple[str, Shape]]:
    taken: set[str] = set(RESERVED)
    for node, to_world in nodes:
        if "mesh" not in node:
            continue
        wanted = node.get("name") or header["meshes"][node["mesh"]].get("name") or f"mesh_{node['mesh']}"
        for primitive, geometry in primitives[node["mesh"]]:
            if not is_triangles(geometry):
                continue
            stem = wanted.replace(".", "_")  # a dot separates the parts of a parameter's name
            name = next(
                n for n in itertools.chain([stem], (f"{stem}_{i}" for i in itertools.count(1))) if n not in taken
            )
            taken.add(name)
            material = header["materials"][primitive["material"]] if "material" in primitive else {}
            part = Part(geometry, to_world)
            textures = {} if part.uvs is None else texture_infos(material)
            images = {texture: getattr(geometry.visual.material, texture) for texture in textures}
            for texture, image in images.items():
                if image is None:
                    raise ValueError(f"the image of {texture} can't be read")
            bsdf, emitter = _bsdf(header, material, textures, images), _emitter(header, material, textures, images)
            yield name, Shape(joined([part], "file"), bsdf, emitter)


def _bsdf(header: dict, material: dict, textures: dict[str, dict], images: dict) -> BSDF | TwoSided:
    """The BSDF of a glTF material: metallic and roughness as the principled model has them, of index 1.5.

    `textures` are those that count, `images` theirs.
    """
    factors = material.get("pbrMetallicRoughness", {})
    base = factors.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3]
    metallic, roughness = factors.get("metallicFactor", 1.0), factors.get("roughnessFactor", 1.0)
    if (info := textures.get("baseColorTexture")) is not None:
        base = color(header, info, images["baseColorTexture"], base)
    if (info := textures.get("metallicRoughnessTexture")) is not None:
        image = images["metallicRoughnessTexture"]
        metallic, roughness = metallic_roughness(header, info, image, metallic, roughness)
    bsdf: BSDF = Principled(base, metallic, roughness)
    if (info := textures.get("normalTexture")) is not None:
        bsdf = NormalMap(normal_map(header, info, images["normalTexture"]), bsdf)
    return TwoSided(bsdf) if material.get("doubleSided", False) else bsdf


def _emitter(header: dict, material: dict, textures: dict[str, dict], images: dict) -> AreaEmitter | None:
    """Emissive factor times strength, times the texture, as radiance."""
    strengths = material.get("extensions", {}).get("KHR_materials_emissive_strength", {})
    radiance = np.multiply(material.get("emissiveFactor", (0, 0, 0)), strengths.get("emissiveStrength", 1.0))
    if not radiance.any():
        return None
    if (info := textures.get("emissiveTexture")) is not None:
        return AreaEmitter(color(header, info, images["emissiveTexture"], radiance))
    return AreaEmitter(radiance)


def _camera(header: dict, nodes: list, shapes: dict[str, Shape], width: int, height: int | None) -> Perspective:
    """The first perspective camera, or one that frames the scene."""
    for node, to_world in nodes:
        if "camera" in node and "perspective" in header["cameras"][node["camera"]]:
            lens = header["cameras"][node["camera"]]["perspective"]
            matrix = to_world @ np.diag([-1.0, 1, -1, 1])  # glTF looks along -z with x to the right
            matrix[:3, :3] /= np.linalg.norm(matrix[:3, :3], axis=0)
            film = Film(width, height or max(1, round(width / lens.get("aspectRatio", 1.0))))
            near = float(lens["znear"])
            return Perspective(matrix, np.degrees(lens["yfov"]), film, "y", near, float(lens.get("zfar", 1e6 * near)))
    points = np.concatenate([np.asarray(shape.mesh.vertices) for shape in shapes.values()])
    lower, upper = points.min(0), points.max(0)
    centre, radius = (lower + upper) / 2, np.linalg.norm(upper - lower) / 2
    distance = radius / np.sin(np.radians(FRAMING_FOV) / 2)
    origin = centre + distance * FRAMING_DIRECTION / np.linalg.norm(FRAMING_DIRECTION)
    matrix = look_at(origin, centre, (0, 1, 0))
    return Perspective(matrix, FRAMING_FOV, Film(width, height or width), "smaller", 1e-3 * distance, 1e3 * distance)


def _unsupported(header: dict, nodes: list[tuple[dict, Matrix]]) -> Iterator[str]:
    """What the file has and a scene here can't hold, and what happens instead."""
    for name in header.get("extensionsRequired", []):
        if name not in SUPPORTED:
            yield f"extension {name} is required; what it changes is left out"
    if header.get("animations"):
        yield "animations are not supported; everything stays where its node puts it"
    for i, mesh in enumerate(header.get("meshes", [])):
        name = f"mesh {mesh.get('name', i)!r}"
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) not in (4, 5):
                yield f"{name}: points, lines and triangle fans are not supported; they are left out"
            if "COLOR_0" in primitive["attributes"]:
                yield f"{name}: vertex colours are not supported; the base colour of the material counts"
            if "TEXCOORD_0" not in primitive["attributes"] and "material" in primitive:
                if texture_infos(header["materials"][primitive["material"]]):
                    yield f"{name}: there are no texture coordinates; its material counts without textures"
            if primitive.get("targets"):
                yield f"{name}: morph targets are not supported; they have no effect"
    for node, _ in nodes:
        name = f"node {node.get('name', '')!r}"
        if "KHR_lights_punctual" in node.get("extensions", {}):
            yield f"{name}: point, spot and directional lights are not supported; the light is left out"
        if "skin" in node:
            yield f"{name}: skins are not supported; the mesh stays in its bind pose"
        if "camera" in node and "perspective" not in header["cameras"][node["camera"]]:
            yield f"{name}: orthographic cameras are not supported; the camera is left out"
    for i, material in enumerate(header.get("materials", [])):
        name = f"material {material.get('name', i)!r}"
        for problem in unsupported_textures(header, material):
            yield f"{name}: {problem}"
        if material.get("alphaMode", "OPAQUE") != "OPAQUE":
            yield f"{name}: transparency is not supported; the material is opaque"
        for extension in material.get("extensions", {}):
            if extension not in SUPPORTED:
                yield f"{name}: extension {extension} is not supported; it has no effect"


def _report(path: Path, problems: list[str], ignore_unsupported: bool) -> None:
    if ignore_unsupported:
        for problem in problems:
            warnings.warn(f"{path}: {problem}", stacklevel=3)
    elif len(problems) == 1:
        raise ValueError(f"{path}: with ignore_unsupported only: {problems[0]}")
    elif problems:
        heading = f"{path} has {len(problems)} things that are not supported; with ignore_unsupported:"
        raise ValueError("\n  ".join([heading, *problems]))
