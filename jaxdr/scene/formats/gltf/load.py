"""glTF 2.0 scenes (.glb, .gltf): nodes, meshes, materials, lights and cameras."""

import os
from collections.abc import Iterable
from pathlib import Path

from jaxdr.argument_kinds import checked
from jaxdr.geometry.gltf.document import Document
from jaxdr.geometry.gltf.nodes import Node, named, scene_nodes, world_matrices
from jaxdr.geometry.gltf.primitives import is_triangles
from jaxdr.geometry.gltf.sizes import check_size
from jaxdr.scene.emitters import ConstantEnvironment
from jaxdr.scene.formats.gltf.cameras import read_camera
from jaxdr.scene.formats.gltf.extensions import name_unread
from jaxdr.scene.formats.gltf.lights import light_at, read_light
from jaxdr.scene.formats.gltf.materials import is_unlit, unsupported_at, unsupported_in
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.formats.gltf.shapes import Names, Shapes, material_of, shared_color
from jaxdr.scene.formats.ties import tie_shared
from jaxdr.scene.lights import DeltaLight
from jaxdr.scene.scene import RESERVED, Scene

EXTENSIONS = (".glb", ".gltf")


def is_gltf(path: str | os.PathLike) -> bool:
    """Whether the name of a file says that `load_gltf` reads it."""
    return Path(path).suffix.lower() in EXTENSIONS


@checked
def load_gltf(
    path: str | os.PathLike,
    *,
    width: int = 512,
    height: int | None = None,
    camera: str | int | None = None,
    ignore_unsupported: bool = False,
) -> Scene:
    """The scene in a glTF 2.0 file, y up, in its units: one shape for each mesh primitive of each node.

    - Shapes are named by their nodes, with a number where names repeat. All instances of a node
      (EXT_mesh_gpu_instancing) are one shape. Normals are those of the file's smoothing groups (`load_mesh`, shading
      "file").
    - Base colour, metallic and roughness become a `Principled` BSDF, with their textures or vertex colours. It is
      two-sided if the material is. A normal texture puts it in a `NormalMap`, and alpha with holes in a `Mask`.
    - A material that transmits all light is glass. One that transmits a part of it is a `Blend` with glass. An unlit
      one shines with its base colour and reflects nothing.
    - A material that several shapes have can be changed in all of them by names that begin with its own, such as
      `brass.bsdf.roughness` (`Scene.tie`). Without a name it is `material_` and its number.
    - Emissive factors become area emitters, with their textures; lights become lights. The file's photometric numbers
      are kept. If nothing shines, there is a constant environment of radiance 1.
    - Animated, skinned and morphed files are loaded in their default pose, with a warning.
    - The camera is the first one of the scene, or the one that `camera` names: by its node, by itself, or by its
      number among those of the scene, from 0. If there is none, the camera shows the whole scene from the front.
    - The film is `width` pixels wide. Without `height` the camera's aspect ratio gives it (square without one).

    Raises one ValueError that lists everything that is not supported, before anything is loaded. With
    `ignore_unsupported` these become warnings, and the rest is loaded. Raises ValueError, with the place in the file,
    for a missing or damaged file, and for triangles and images that take more memory than there is. Raises ValueError
    for a camera that is not there.

    A file may name others, buffers and images. Only files in its own folder and below are read, no matter how the way
    there is written: `../`, absolute paths and links to somewhere else raise ValueError. Images are PNG, JPEG, WebP,
    AVIF and DDS.
    """
    path = Path(path)
    if not is_gltf(path):
        raise ValueError(f"load_gltf: {path} has an unknown extension; known are {', '.join(EXTENSIONS)}")
    if not path.is_file():
        raise ValueError(f"load_gltf: there is no file {path}")
    document, problems = Document(path), Problems(path)
    with document.at("the JSON"):
        places = world_matrices(document)
        nodes = scene_nodes(document, places)
        check_size(document, nodes)
        _find_problems(document, nodes, problems)
    problems.check(ignore_unsupported)
    reader = Shapes(document, problems, places)
    with document.at("the meshes"):
        shapes = reader.read(nodes)
    if not shapes:
        raise ValueError(f"load_gltf: {path} has no triangles")
    with document.at("the lights"):
        lights = _lights(document, nodes, problems, taken=(*RESERVED, *shapes))
    with document.at("the camera"):
        view = read_camera(document, nodes, shapes, width, height, camera)
    problems.warn_notes()
    shines = lights or any(shape.emitter is not None for shape in shapes.values())
    with document.at("the scene"):
        scene = Scene(shapes, view, None if shines else ConstantEnvironment(1.0), lights)
        return tie_shared(scene, reader.materials.made())


def _lights(document: Document, nodes: list[Node], problems: Problems, taken: Iterable[str]) -> dict[str, DeltaLight]:
    names, found = Names(taken), {}
    for node in nodes:
        if (light := light_at(document, node)) is not None:
            wanted = node.header.get("name") or light.get("name") or f"{light.get('type', '')}_light"
            found[names.free(wanted)] = read_light(document, node, light, problems)
    return found


def _find_problems(document: Document, nodes: list[Node], problems: Problems) -> None:
    """Collect what is not supported, and what is worth a warning. Only the JSON is read for that."""
    name_unread(document, problems)
    if document.header.get("animations"):
        problems.note("animations are not played; everything stays where its node puts it")
    for node in nodes:
        if "skin" in node.header:
            problems.note(f"{node.label}: its skin stays in the pose that the nodes of its joints give it")
    materials = {}
    for index in dict.fromkeys(index for _, index in named(nodes, "mesh")):
        mesh, name = document.item("meshes", index, "a node"), document.label("meshes", index)
        with document.at(name):
            for number, primitive in enumerate(mesh["primitives"]):
                _find_primitive_problems(document, primitive, name, number, problems)
                if "material" in primitive and is_triangles(primitive):
                    materials[primitive["material"]] = material_of(document, primitive)
    if materials and any(map(is_unlit, materials.values())) and not all(map(is_unlit, materials.values())):
        unlit = ", ".join(document.label("materials", index) for index, of in materials.items() if is_unlit(of))
        problems.note(f"{unlit}: unlit; it shines with its colour, so that it lights the other materials")
    for index, material in materials.items():
        label = document.label("materials", index)
        with document.at(label):
            for problem in unsupported_in(material):
                problems.leave_out(f"{label}: {problem}")


def _find_primitive_problems(document: Document, primitive: dict, name: str, number: int, problems: Problems) -> None:
    if not is_triangles(primitive):
        problems.note(f"{name}: points and lines are not supported; they are left out")
        return
    attributes, label = primitive["attributes"], f"{name}, primitive {number}"
    if primitive.get("targets"):
        problems.note(f"{name}: its morph targets stay at the file's weights")
    vary = "COLOR_0" in attributes and shared_color(document, primitive, label) is None
    for problem in unsupported_at(document, material_of(document, primitive), attributes, vary):
        problems.leave_out(f"{name}: {problem}")
