"""Small glTF files with everything that makes other people's files hard to load, and what loading each must give.

`python -m experiments.real_scenes.gltf_corpus FOLDER` writes them all. They are made from the specification of glTF 2.0
and its extensions, by `gltf_writer`.
"""

import argparse
import contextlib
import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.real_scenes.gltf_writer import CORNERS, CUBE, SQUARE, SQUARE_FACES, SQUARE_UVS, File

HALF = 0.5**0.5


@dataclasses.dataclass
class Case:
    """A file and what loading it must give.

    `triangles` and the bounding box (`lower`, `upper`) are those of the whole scene in its default pose, `volume` the
    signed one that closed meshes enclose. `strict`: it loads without leaving anything out. `warned`: words of the
    warnings there must be, in any order; where it is not strict, of the items that are left out. `error`: words of the
    one error that a damaged file is, by any means.
    """

    name: str
    triangles: int = 12
    lower: tuple = (0, 0, 0)
    upper: tuple = (1, 1, 1)
    volume: float | None = None
    strict: bool = True
    warned: tuple[str, ...] = ()
    error: str | None = None
    path: Path = Path()


CASES: list[tuple[Case, Callable[[Path], None]]] = []


def case(name: str, **facts):
    """Register a function that writes the file of a case."""

    def register(function: Callable[[Path], None]):
        CASES.append((Case(name, **facts), function))
        return function

    return register


def write(folder: Path) -> list[Case]:
    """Write all files into a folder; what each must give. A file whose package is missing is left out."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for made, function in CASES:
        path = folder / made.name
        with contextlib.suppress(ImportError):
            function(path)
            written.append(dataclasses.replace(made, path=path))
    return written


def png(pixels) -> bytes:
    """A PNG of 8 bits."""
    stream = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


FLAT = dict(triangles=2, upper=(1, 1, 0))  # the square
CHECKS = png([[[255, 0, 0, 255], [0, 255, 0, 64]], [[0, 0, 255, 192], [255, 255, 255, 0]]])

# Containers and URIs


@case("percent_encoded.gltf", volume=1)
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    file.save(path, buffer="percent%20encoded.bin")


@case("data_uri.gltf", volume=1)
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    file.save(path, embed=True)


@case("two_buffers.glb", triangles=24, upper=(3, 1, 1), volume=2)
def _(path):
    """A second buffer in a file beside the .glb."""
    file = File()
    file.node(mesh=file.mesh())
    (path.parent / "second buffer.bin").write_bytes((CORNERS + np.float32([2, 0, 0])).tobytes())
    file.json["buffers"] = [{}, {"byteLength": 96, "uri": "second%20buffer.bin"}]
    view = file.add("bufferViews", {"buffer": 1, "byteLength": 96})
    moved = file.add("accessors", file.described(CORNERS) | {"bufferView": view})
    file.node(mesh=file.mesh({"attributes": {"POSITION": moved}, "indices": file.accessor(CUBE.reshape(-1))}))
    file.save(path)


@case("no_scenes.glb", triangles=24, upper=(3, 1, 1), volume=2)
def _(path):
    """Without a list of scenes the nodes without parents are the scene."""
    file = File()
    mesh = file.mesh()
    file.node(mesh=mesh, children=[file.node(root=False, mesh=mesh, translation=[2, 0, 0])])
    del file.json["scenes"], file.json["scene"]
    file.save(path)


# Nodes


@case("instances.glb", triangles=36, lower=(0, 0, 0), upper=(14, 2, 3), volume=8 + 8 + 1)
def _(path):
    """Three cubes: one scaled by 2, one turned by 90 degrees about z and scaled by 1, 2, 4 (mirrored), one moved."""
    file = File()
    file.uses("EXT_mesh_gpu_instancing", required=True)
    attributes = {
        "TRANSLATION": file.accessor(np.float32([[0, 0, 0], [10, 0, 0], [12, 0, 2]])),
        "ROTATION": file.accessor(np.float32([[0, 0, 0, 1], [0, 0, HALF, HALF], [0, 0, 0, 1]])),
        "SCALE": file.accessor(np.float32([[2, 2, 2], [2, -4, 1], [1, 1, 1]])),
    }
    file.node(mesh=file.mesh(), extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    file.save(path)


@case("instances_quantized.glb", triangles=24, lower=(5, 0, 0), upper=(11, 2, 2), volume=16)
def _(path):
    """Rotations as normalised shorts, under a node that scales by 2 and moves by 5 along x."""
    file = File()
    file.uses("EXT_mesh_gpu_instancing")
    attributes = {
        # Turned by 90 degrees about y, the cube goes down to z = -1.
        "TRANSLATION": file.accessor(np.float32([[0, 0, 0], [2, 0, 1]])),
        "ROTATION": file.accessor(np.int16([[0, 0, 0, 32767], [0, 23170, 0, 23170]]), normalized=True),
    }
    child = file.node(root=False, mesh=file.mesh(), extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    file.node(translation=[5, 0, 0], scale=[2, 2, 2], children=[child])
    file.save(path)


@case("mirrored.glb", lower=(-2, 0, 0), upper=(0, 1, 1), volume=2)
def _(path):
    """A node that mirrors keeps the outside outside."""
    file = File()
    file.node(mesh=file.mesh(), scale=[-2, 1, 1])
    file.save(path)


@case("hidden.glb", volume=1)
def _(path):
    file = File()
    file.uses("KHR_node_visibility")
    mesh = file.mesh()
    file.node(mesh=mesh)
    child = file.node(root=False, mesh=mesh, translation=[9, 0, 0])
    file.node(children=[child], extensions={"KHR_node_visibility": {"visible": False}})
    file.save(path)


@case("many_nodes.glb", triangles=12 * 3000, upper=(5999, 1, 1), volume=3000)
def _(path):
    """3,000 nodes with one mesh, all of one name."""
    file = File()
    mesh = file.mesh()
    for i in range(3000):
        file.node(name="cube", mesh=mesh, translation=[2 * i, 0, 0])
    file.save(path)


# Primitives


@case("strip.glb", triangles=4, upper=(2, 1, 0))
def _(path):
    """Two squares side by side; the strip counts from 1."""
    file = File()
    points = np.float32([[9, 9, 9], [0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0], [2, 1, 0]])
    file.node(mesh=file.mesh(file.primitive(points, np.uint8([2, 1, 4, 3, 6, 5]), mode=5)))
    file.save(path)


@case("fan.glb", triangles=4, lower=(-1, -1, 0), upper=(1, 1, 0))
def _(path):
    file = File()
    points = np.float32([[0, 0, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0]])
    file.node(mesh=file.mesh(file.primitive(points, None, mode=6)))
    file.save(path)


@case("points_and_lines.glb", volume=1, warned=("points and lines are not supported",))
def _(path):
    file = File()
    others = [file.primitive(CORNERS + 5, None, mode=mode) for mode in (0, 1, 2, 3)]
    file.node(mesh=file.mesh(*others[:2], file.primitive(), *others[2:]))
    file.save(path)


@case("no_area.glb", volume=1, warned=("none of its faces has an area",))
def _(path):
    """One primitive is all lines: the others stay."""
    file = File()
    line = file.primitive(np.float32([[0, 0, 0], [1, 1, 1], [2, 2, 2]]), None)
    file.node(mesh=file.mesh(line, file.primitive()))
    file.save(path)


@case("quantized.glb", lower=(-1, -2, -3), upper=(1, 2, 3), volume=48)
def _(path):
    """Positions as shorts in rows of 8 bytes, in a node that makes them meters; UVs as normalised bytes."""
    file = File()
    file.uses("KHR_mesh_quantization", required=True)
    stored = file.accessor(np.int16(CORNERS * 200 - 100), stride=8)
    uvs = file.accessor(np.uint8(CORNERS[:, :2] * 255), normalized=True, stride=4)
    normals = file.accessor(np.int8(np.sign(CORNERS - 0.5) * 73), normalized=True, stride=4)
    attributes = {"POSITION": stored, "TEXCOORD_0": uvs, "NORMAL": normals}
    mesh = file.mesh({"attributes": attributes, "indices": file.accessor(CUBE.reshape(-1))})
    file.node(mesh=mesh, scale=[0.01, 0.02, 0.03])
    file.save(path)


@case("quantized_normalized.glb", lower=(-1, -1, -1), upper=(1, 1, 1), volume=8)
def _(path):
    """Positions as normalised bytes; -128 stands for -1 as well."""
    file = File()
    file.uses("KHR_mesh_quantization", required=True)
    values = np.where(CORNERS > 0, 127, -128).astype(np.int8)
    stored = file.accessor(values, normalized=True, stride=4)
    file.node(mesh=file.mesh({"attributes": {"POSITION": stored}, "indices": file.accessor(CUBE.reshape(-1))}))
    file.save(path)


@case("sparse.glb", upper=(1, 1, 3), volume=1 + 0.5 * 2)
def _(path):
    """Two corners of a cube are raised by 2: a wedge more."""
    file = File()
    primitive = file.primitive()
    file.json["accessors"][primitive["attributes"]["POSITION"]]["sparse"] = {
        "count": 2,
        "indices": {"bufferView": file.view(np.uint8([1, 3]).tobytes()), "componentType": 5121},
        "values": {"bufferView": file.view(np.float32([[0, 0, 3], [0, 1, 3]]).tobytes())},
    }
    file.node(mesh=file.mesh(primitive))
    file.save(path)


@case("sparse_alone.glb", volume=1)
def _(path):
    """Zeros where nothing is stored: all but seven corners."""
    file = File()
    sparse = {
        "count": 7,
        "indices": {"bufferView": file.view(np.uint32(range(1, 8)).tobytes()), "componentType": 5125},
        "values": {"bufferView": file.view(CORNERS[1:].tobytes())},
    }
    position = file.add("accessors", file.described(CORNERS) | {"sparse": sparse})
    file.node(mesh=file.mesh({"attributes": {"POSITION": position}, "indices": file.accessor(CUBE.reshape(-1))}))
    file.save(path)


# Poses


@case("animated.glb", lower=(2, 0, 0), upper=(3, 1, 1), volume=1, warned=("animations are not played",))
def _(path):
    file = File()
    node = file.node(mesh=file.mesh(), translation=[2, 0, 0])
    times, places = file.accessor(np.float32([0, 1])), file.accessor(np.float32([[0, 0, 0], [0, 9, 0]]))
    channel = {"sampler": 0, "target": {"node": node, "path": "translation"}}
    file.add("animations", {"samplers": [{"input": times, "output": places}], "channels": [channel]})
    file.save(path)


@case("morphed.glb", upper=(1, 1, 2.5), volume=2.5, warned=("morph targets stay",))
def _(path):
    """The mesh's weights: half of the first target (up by 3 at the top), none of the second."""
    file = File()
    up = np.float32(CORNERS * [0, 0, 3])
    targets = [{"POSITION": file.accessor(up)}, {"POSITION": file.accessor(up * 100)}]
    file.node(mesh=file.mesh(file.primitive(targets=targets), weights=[0.5, 0]))
    file.save(path)


@case("morphed_at_node.glb", upper=(1, 1, 4), volume=4, warned=("morph targets stay",))
def _(path):
    """A node's own weights count more than the mesh's."""
    file = File()
    targets = [{"POSITION": file.accessor(np.float32(CORNERS * [0, 0, 3]))}]
    file.node(mesh=file.mesh(file.primitive(targets=targets), weights=[0]), weights=[1])
    file.save(path)


@case("skinned.glb", lower=(3, 0, 0), upper=(4, 2, 2), volume=2, warned=("skin stays in the pose",))
def _(path):
    """The lower half hangs on a joint at x = 3, the upper half on its child 1 higher, which was bound at y = -1."""
    file = File()
    joints = np.zeros((8, 4), np.uint8)
    joints[:, 0] = CORNERS[:, 2]
    weights = np.zeros((8, 4), np.uint8)
    weights[:, 0] = 255
    attributes = {
        "JOINTS_0": file.accessor(joints),
        "WEIGHTS_0": file.accessor(weights, normalized=True),
    }
    upper = file.node(root=False, translation=[0, 0, 1])
    lower = file.node(translation=[3, 0, 0], children=[upper])
    inverse = np.float32([np.eye(4), np.eye(4)])
    inverse[1, 1, 3] = 1
    inverse = inverse.transpose(0, 2, 1).reshape(2, 16)  # stored by columns
    skin = file.add("skins", {"joints": [lower, upper], "inverseBindMatrices": file.accessor(inverse)})
    file.node(mesh=file.mesh(file.primitive(attributes=attributes)), skin=skin, translation=[99, 0, 0])
    file.save(path)


# Vertex colours and alpha


@case("colors_u8.glb", volume=1)
def _(path):
    file = File()
    colors = file.accessor(np.uint8(CORNERS * 255), normalized=True, stride=4)
    file.node(mesh=file.mesh(file.primitive(attributes={"COLOR_0": colors})))
    file.save(path)


@case("colors_u16.glb", warned=("edges lie on others",), **FLAT)
def _(path):
    """Each triangle has a colour of its own, so vertices at one position have two; alpha counts not."""
    file = File()
    colors = np.uint16([[65535, 0, 0, 9]] * 3 + [[0, 65535, 0, 9]] * 3)
    attributes = {"COLOR_0": file.accessor(colors, normalized=True)}
    file.node(mesh=file.mesh(file.primitive(SQUARE[SQUARE_FACES.reshape(-1)], None, attributes=attributes)))
    file.save(path)


@case("colors_float.glb", volume=1)
def _(path):
    """Times the base colour factor."""
    file = File()
    material = file.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 1, 1]}})
    file.node(mesh=file.mesh(file.primitive(attributes={"COLOR_0": np.float32(CORNERS)}, material=material)))
    file.save(path)


@case("colors_on_texture.glb", **FLAT)
def _(path):
    file = File()
    texture = file.texture(CHECKS)
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}}
    file.square(material, attributes={"COLOR_0": np.float32(SQUARE)})
    file.save(path)


@case("tint_on_texture.glb", **FLAT)
def _(path):
    """One colour at all vertices is a factor."""
    file = File()
    texture = file.texture(CHECKS)
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}}
    file.square(material, attributes={"COLOR_0": np.float32([[0.5, 1, 0.25]] * 4)})
    file.save(path)


@case("alpha_mask.glb", warned=("holes end at the borders of texels",), **FLAT)
def _(path):
    """Alphas of 1, 64/255, 192/255 and 0 at a cutoff of 0.5."""
    file = File()
    material = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(CHECKS)}}}
    file.square(material)
    file.save(path)


@case(
    "alpha_mask_vertices.glb",
    strict=False,
    warned=("alpha of vertices on a texture", "holes end at the borders of texels"),
    **FLAT,
)
def _(path):
    file = File()
    material = {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(CHECKS)}}}
    file.square(
        material, attributes={"COLOR_0": np.float32([[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 0.5]])}
    )
    file.save(path)


@case("alpha_blend.glb", **FLAT)
def _(path):
    file = File()
    file.square(
        {"alphaMode": "BLEND", "doubleSided": True, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.25]}}
    )
    file.save(path)


@case("alpha_blend_vertices.glb", **FLAT)
def _(path):
    file = File()
    colors = np.float32([[1, 1, 1, 0], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 0.5]])
    file.square({"alphaMode": "BLEND"}, attributes={"COLOR_0": colors})
    file.save(path)


@case("alpha_nothing.glb", volume=1, warned=("its alpha makes it invisible",))
def _(path):
    """A square that is cut away as a whole, beside a cube."""
    file = File()
    file.square(
        {"alphaMode": "MASK", "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.4]}}, translation=[9, 0, 0]
    )
    file.node(mesh=file.mesh())
    file.save(path)


# Textures


@case("wraps.glb", **FLAT)
def _(path):
    file = File()
    texture = file.texture(CHECKS, {"wrapS": 33071, "wrapT": 33648, "magFilter": 9729})
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}})
    file.save(path)


@case("texture_transform.glb", **FLAT)
def _(path):
    """The specification's example: the lower left quadrant, turned clockwise by 90 degrees."""
    file = File()
    file.uses("KHR_texture_transform")
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    info = {"index": file.texture(CHECKS), "extensions": {"KHR_texture_transform": transform}}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": info}})
    file.save(path)


@case("second_uvs.glb", **FLAT)
def _(path):
    """All textures use TEXCOORD_1."""
    file = File()
    info = {"index": file.texture(CHECKS), "texCoord": 1}
    attributes = {"TEXCOORD_1": file.accessor(np.uint16(SQUARE_UVS * 65535), normalized=True)}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": info}, "emissiveTexture": info}, attributes=attributes)
    file.save(path)


@case("two_uv_sets.glb", strict=False, warned=("normalTexture uses other texture coordinates",), **FLAT)
def _(path):
    file = File()
    texture = file.texture(CHECKS)
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": texture}},
        "normalTexture": {"index": texture, "texCoord": 1},
    }
    file.square(material, attributes={"TEXCOORD_1": SQUARE_UVS})
    file.save(path)


@case("basisu.glb", strict=False, warned=("no image in a format that is supported (KHR_texture_basisu)",), **FLAT)
def _(path):
    file = File()
    file.uses("KHR_texture_basisu", required=True)
    image = file.add("images", {"bufferView": file.view(b"\xabKTX 20\xbb"), "mimeType": "image/ktx2"})
    texture = file.add("textures", {"extensions": {"KHR_texture_basisu": {"source": image}}})
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}})
    file.save(path)


@case("webp.glb", **FLAT)
def _(path):
    file = File()
    file.uses("EXT_texture_webp", required=True)
    stream = io.BytesIO()
    Image.fromarray(np.uint8([[[255, 0, 0], [0, 0, 255]]])).save(stream, "WEBP", lossless=True)
    texture = file.texture(stream.getvalue(), mime="image/webp")
    file.json["textures"][texture] = {"extensions": {"EXT_texture_webp": {"source": 0}}}
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": texture}}})
    file.save(path)


@case("mirrored_normal_map.glb", triangles=4, upper=(3, 1, 0), warned=("normal map is mirrored on 50% of the faces",))
def _(path):
    """Two squares of one primitive; the second one's UVs are mirrored."""
    file = File()
    points = np.concatenate([SQUARE, SQUARE + np.float32([2, 0, 0])])
    uvs = np.concatenate([SQUARE_UVS, SQUARE_UVS * [-1, 1] + [1, 0]]).astype(np.float32)
    material = file.add("materials", {"normalTexture": {"index": file.texture(CHECKS), "scale": 2}})
    faces = np.concatenate([SQUARE_FACES, SQUARE_FACES + 4])
    file.node(mesh=file.mesh(file.primitive(points, faces, attributes={"TEXCOORD_0": uvs}, material=material)))
    file.save(path)


# Materials


def material_case(name: str, material: dict, **facts):
    """A square with a material, which names the extensions it uses."""

    def save(path: Path) -> None:
        file = File()
        file.uses(*material.get("extensions", {}))
        file.square(material)
        file.save(path)

    case(name, **FLAT, **facts)(save)


material_case("ior.glb", {"extensions": {"KHR_materials_ior": {"ior": 1.4}}})
material_case(
    "ior_high.glb", {"extensions": {"KHR_materials_ior": {"ior": 2.4}}}, strict=False, warned=("index of 2.4",)
)
material_case(
    "specular.glb",
    {"extensions": {"KHR_materials_specular": {"specularFactor": 0.5}}},
    warned=("specularFactor scales only the reflection at normal incidence",),
)
material_case(
    "emissive_strength.glb",
    {"emissiveFactor": [1, 0.5, 0.25], "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}}},
)
material_case(
    "glass_thin.glb",
    {
        "pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 0},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}},
    },
    warned=("a thin pane has two surfaces",),
)
material_case(
    "glass_thick.glb",
    {
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0.5},
        "extensions": {
            "KHR_materials_transmission": {"transmissionFactor": 1},
            "KHR_materials_volume": {"thicknessFactor": 1},
            "KHR_materials_ior": {"ior": 1.25},
        },
    },
)
material_case(
    "glass_in_part.glb",
    {
        "pbrMetallicRoughness": {"metallicFactor": 0.25, "roughnessFactor": 0.5},
        "extensions": {
            "KHR_materials_transmission": {"transmissionFactor": 0.5},
            "KHR_materials_volume": {"thicknessFactor": 1},
        },
    },
)
material_case(
    "glass_thin_rough.glb",
    {
        "doubleSided": True,
        "pbrMetallicRoughness": {"metallicFactor": 0},
        "extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.5}},
    },
    strict=False,
    warned=("a thin rough pane is not supported", "behind the rest is black", "a thin pane has two surfaces"),
)
material_case("unlit.glb", {"extensions": {"KHR_materials_unlit": {}}})
material_case(
    "lobes.glb",
    {"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1}, "KHR_materials_sheen": {}}},
    strict=False,
    warned=("KHR_materials_clearcoat is not supported; there is no coat",),  # and no sheen, whose colour is black
)


@case("variants.glb", volume=1, warned=("KHR_materials_variants is not supported; the default materials count",))
def _(path):
    file = File()
    file.uses("KHR_materials_variants")
    file.json["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}}
    red = file.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}})
    mappings = {"KHR_materials_variants": {"mappings": [{"variants": [0], "material": red}]}}
    file.node(mesh=file.mesh(file.primitive(extensions=mappings)))
    file.save(path)


# Lights and cameras


@case("lights.glb", volume=1, warned=("range has no effect",))
def _(path):
    """A directional, a point and a spot light; the spot at a node that is turned to shine along +x, and scaled."""
    file = File()
    file.uses("KHR_lights_punctual")
    lights = [
        {"type": "directional", "color": [1, 0.5, 0.25], "intensity": 4},
        {"type": "point", "intensity": 100, "range": 9},
        {"type": "spot", "intensity": 7, "spot": {"innerConeAngle": np.pi / 8, "outerConeAngle": np.pi / 3}},
    ]
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    at = [{"extensions": {"KHR_lights_punctual": {"light": i}}} for i in range(3)]
    file.node(mesh=file.mesh())
    file.node(name="sun", **at[0])
    file.node(name="bulb", translation=[0, 5, 0], **at[1])
    file.node(name="spot", translation=[-5, 0, 0], rotation=[0, -HALF, 0, HALF], scale=[3, 3, 3], **at[2])
    file.save(path)


@case("orthographic.glb", volume=1)
def _(path):
    """Shows 6 by 2 units along -z."""
    file = File()
    lens = {"xmag": 3, "ymag": 1, "znear": 0, "zfar": 100}
    camera = file.add("cameras", {"type": "orthographic", "orthographic": lens})
    file.node(mesh=file.mesh())
    file.node(camera=camera, translation=[0, 0, 10])
    file.save(path)


# Compression


@case("draco.glb", lower=(-1, -1, -1), upper=(1, 1, 1), volume=8)
def _(path):
    import DracoPy

    file = File()
    file.uses("KHR_draco_mesh_compression", required=True)
    points = CORNERS * 2 - 1
    data = DracoPy.encode(points, CUBE.astype(np.uint32), quantization_bits=16, preserve_order=True)
    extension = {"bufferView": file.view(data), "attributes": {"POSITION": 0}}
    primitive = {
        "attributes": {"POSITION": file.add("accessors", file.described(points))},
        "indices": file.add("accessors", file.described(CUBE.reshape(-1))),
        "extensions": {"KHR_draco_mesh_compression": extension},
    }
    file.node(mesh=file.mesh(primitive))
    file.save(path)


@case("meshopt.glb", upper=(2, 2, 2), volume=8)
def _(path):
    import meshoptimizer

    file = File()
    file.uses("EXT_meshopt_compression", required=True)
    file.json["buffers"] = [{}, {"byteLength": 8 * 12 + 36 * 2}]  # the fallback, which holds no data

    def compressed(data: bytes, values, offset: int, mode: str) -> int:
        stride = values.dtype.itemsize * (values.shape[1] if values.ndim == 2 else 1)
        number = file.view(data)
        source = file.json["bufferViews"][number]
        extension = {**source, "byteStride": stride, "count": len(values), "mode": mode}
        view = {"buffer": 1, "byteOffset": offset, "byteLength": values.nbytes}
        view["extensions"] = {"EXT_meshopt_compression": extension}
        return file.add("accessors", file.described(values) | {"bufferView": file.add("bufferViews", view)})

    points, indices = np.ascontiguousarray(CORNERS * 2), CUBE.reshape(-1)
    primitive = {
        "attributes": {
            "POSITION": compressed(meshoptimizer.encode_vertex_buffer(points, 8, 12), points, 0, "ATTRIBUTES")
        },
        "indices": compressed(
            meshoptimizer.encode_index_buffer(indices.astype(np.uint32), 36, 8), indices, 96, "TRIANGLES"
        ),
    }
    file.node(mesh=file.mesh(primitive))
    file.save(path)


# Extensions that nobody reads


@case("unknown_extensions.glb", volume=1, strict=False, warned=("EXT_a is required", "node 'cube': extension EXT_b"))
def _(path):
    file = File()
    file.uses("EXT_a", required=True)
    file.uses("EXT_b")
    file.node(name="cube", mesh=file.mesh(), extensions={"EXT_b": {}})
    file.save(path)


# Damage


def damaged(name: str, error: str, change: Callable[[File, dict], None]):
    """A cube whose file is changed before it is written; `change` gets its primitive as well."""

    def save(path: Path) -> None:
        file = File()
        file.node(name="cube", mesh=file.mesh(name="a cube"))
        change(file, file.json["meshes"][0]["primitives"][0])
        file.save(path)

    case(name, error=error)(save)


def accessor(key: str, value):
    """Change one property of the positions' accessor."""
    return lambda file, primitive: file.json["accessors"][primitive["attributes"]["POSITION"]].update({key: value})


def _cycle(file: File, _: dict) -> None:
    a, b = file.node(root=False, name="a"), file.node(root=False, name="b")
    file.json["nodes"][a]["children"], file.json["nodes"][b]["children"] = [b], [a]


WHERE = "mesh 'a cube', primitive 0: "
damaged(
    "bad_count.glb",
    f"{WHERE}POSITION: accessor 0: its 9 values need 108 bytes, and the bufferView has 96",
    accessor("count", 9),
)
damaged(
    "bad_accessor.glb",
    f"{WHERE}POSITION: refers to accessor 99; there are 2",
    lambda f, p: p["attributes"].update(POSITION=99),
)
damaged("bad_type.glb", "POSITION: accessor 0: must be of type VEC3, not 'VEC2'", accessor("type", "VEC2"))
damaged("bad_component.glb", "POSITION: accessor 0: has an unknown componentType 5130", accessor("componentType", 5130))
damaged(
    "bad_indices.glb",
    "indices: accessor 2: indices must be unsigned integers, not of componentType 5126",
    lambda f, p: p.update(indices=f.accessor(np.float32([0, 1, 2]))),
)
damaged(
    "bad_index.glb",
    f"{WHERE}its indices go up to 8; there are 8 vertices",
    lambda f, p: p.update(indices=f.accessor(np.uint8([0, 1, 8]))),
)
damaged(
    "bad_corners.glb",
    f"{WHERE}has 4 corners of triangles, which is not a multiple of 3",
    lambda f, p: p.update(indices=f.accessor(np.uint8([0, 1, 2, 3]))),
)
damaged(
    "bad_view.glb",
    "bufferView 0: its bytes 0 to 5000 are not in buffer 0",
    lambda f, p: f.json["bufferViews"][0].update(byteLength=5000),
)
damaged("bad_cycle.glb", "node 'a': it is below itself", _cycle)
damaged("bad_parents.glb", "node 'cube': it has two parents", lambda f, p: [f.node(children=[0]), f.node(children=[0])])
damaged(
    "bad_child.glb", "node 'cube': refers to node 7; there are 1", lambda f, p: f.json["nodes"][0].update(children=[7])
)
damaged("bad_material.glb", "refers to material 3; there are 0", lambda f, p: p.update(material=3))
damaged(
    "bad_positions.glb",
    f"{WHERE}POSITION has values that are not finite",
    lambda f, p: p["attributes"].update(POSITION=f.accessor(CORNERS * np.float32(np.nan), min=[0] * 3, max=[1] * 3)),
)
damaged(
    "bad_normals.glb",
    f"{WHERE}NORMAL has 4 values for 8 vertices",
    lambda f, p: p["attributes"].update(NORMAL=f.accessor(SQUARE)),
)
damaged(
    "bad_light.glb",
    "node 'cube': KHR_lights_punctual: refers to light 0; there are 0",
    lambda f, p: f.json["nodes"][0].update(extensions={"KHR_lights_punctual": {"light": 0}}),
)


@case("bad_cut_off.glb", error="the GLB header: the file has ")
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    data = file.save(path).read_bytes()
    path.write_bytes(data[:-50])


@case("bad_buffer_cut_off.gltf", error="buffer 0: has 100 of its 168 bytes; the file is cut off")
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    file.save(path)
    buffer = path.with_suffix(".bin")
    buffer.write_bytes(buffer.read_bytes()[:100])


@case("bad_no_uri.gltf", error="buffer 0: has no data: neither a uri")
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    header = json.loads(file.save(path, embed=True).read_text())
    del header["buffers"][0]["uri"]
    path.write_text(json.dumps(header))


@case("bad_no_file.gltf", error="buffer 0: there is no file ")
def _(path):
    file = File()
    file.node(mesh=file.mesh())
    file.save(path)
    path.with_suffix(".bin").unlink()


@case("bad_image.glb", error="image 0: ")
def _(path):
    file = File()
    file.square({"pbrMetallicRoughness": {"baseColorTexture": {"index": file.texture(CHECKS[:40])}}})
    file.save(path)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    print(f"{len(write(parser.parse_args().folder))} files")
