"""glTF files and pictures, as `jaxdr.load_gltf` and `jaxdr.load_image` read them."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.real_scenes.gltf_writer import CORNERS, CUBE, SQUARE, SQUARE_FACES, SQUARE_UVS, File
from jaxdr.geometry.gltf.primitives import has_draco
from jaxdr.image_formats import exr
from jaxdr.images import load_image, write_image
from jaxdr.scene.formats.gltf.load import load_gltf
from tests.fuzz.kind import Kind

RNG = np.random.default_rng(0)
PIXELS = RNG.integers(0, 256, (6, 9, 4), np.uint8)
PILLOW = {"png": "RGBA", "palette.png": "P", "jpg": "RGB", "bmp": "RGB", "tga": "RGBA"}


def kinds() -> list[Kind]:
    """A glTF file of each container, one that is compressed, and a picture of each format."""
    found = [
        Kind("gltf", lambda folder: _write(everything(), folder / "a.gltf"), _read_gltf, text=True),
        Kind("glb", lambda folder: _write(everything(), folder / "a.glb"), _read_gltf),
    ]
    if has_draco():
        found.append(Kind("draco.glb", lambda folder: _write(compressed(), folder / "a.glb"), _read_gltf))
    found += [Kind(name, _pillow_writer(name, mode), _read_image) for name, mode in PILLOW.items()]
    found.append(Kind("16.png", _write_deep_png, _read_image))
    suffixes = ["hdr", "pfm", "npy", *(["exr"] if exr.is_available() else [])]
    return found + [Kind(suffix, _float_writer(suffix), _read_image) for suffix in suffixes]


def everything() -> File:
    """A file with every part of glTF that the loader reads, except compression."""
    file = File()
    textured = file.primitive(
        *(SQUARE, SQUARE_FACES),
        attributes={"TEXCOORD_0": SQUARE_UVS, "NORMAL": np.tile(np.array([0, 0, 1], np.float32), (4, 1))},
        material=file.add("materials", _material(file)),
        targets=[{"POSITION": file.accessor(np.ones((4, 3), np.float32))}],
    )
    file.node(
        name="textured",
        mesh=file.mesh(textured, weights=[0.3]),
        translation=[0, 1, 0],
        rotation=[0, 0, 0, 1],
        scale=[1] * 3,
    )
    colored = file.primitive(attributes={"COLOR_0": RNG.random((8, 4)).astype(np.float32)}, mode=4)
    colored["material"] = file.add("materials", _glass())
    child = file.node(root=False, name="child", mesh=file.mesh(colored), matrix=np.eye(4).reshape(-1).tolist())
    file.node(name="parent", children=[child])
    _add_skin(file)
    places = {
        "TRANSLATION": file.accessor(CORNERS * 5),
        "ROTATION": file.accessor(np.tile(np.array([0, 0, 0, 127], np.int8), (8, 1)), True),
    }
    file.node(name="copies", mesh=file.mesh(), extensions={"EXT_mesh_gpu_instancing": {"attributes": places}})
    sparse = {"count": 1, "indices": {"bufferView": file.view(bytes([7])), "componentType": 5121}}
    sparse["values"] = {"bufferView": file.view(np.array([2, 2, 2], np.float32).tobytes())}
    file.json["accessors"][colored["attributes"]["POSITION"]]["sparse"] = sparse
    lens = {"yfov": 0.7, "znear": 0.01, "zfar": 100, "aspectRatio": 1.5}
    file.node(
        name="eye", camera=file.add("cameras", {"type": "perspective", "perspective": lens}), translation=[0, 0, 9]
    )
    lights = [
        {"type": "point", "intensity": 10.0, "color": [1, 1, 1]},
        {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5}},
        {"type": "directional"},
    ]
    file.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for number in range(3):
        file.node(name=f"lamp {number}", extensions={"KHR_lights_punctual": {"light": number}})
    file.uses("KHR_lights_punctual", "EXT_mesh_gpu_instancing", "KHR_texture_transform")
    return file


def compressed() -> File:
    """A cube that Draco compressed."""
    import DracoPy

    file, data = File(), DracoPy.encode(CORNERS, CUBE.astype(np.uint32), quantization_bits=14)
    extension = {"bufferView": file.view(data), "attributes": {"POSITION": 0}}
    primitive = {
        "attributes": {"POSITION": file.add("accessors", file.described(CORNERS))},
        "indices": file.add("accessors", file.described(CUBE.reshape(-1))),
        "extensions": {"KHR_draco_mesh_compression": extension},
    }
    file.node(mesh=file.mesh(primitive))
    file.uses("KHR_draco_mesh_compression", required=True)
    return file


def _material(file: File) -> dict:
    sampler = {"magFilter": 9729, "minFilter": 9729, "wrapS": 10497, "wrapT": 33071}
    picture = file.texture(_encoded("png", "RGBA"), sampler)
    moved = {"KHR_texture_transform": {"offset": [0.1, 0], "rotation": 0.5, "scale": [2, 2], "texCoord": 0}}
    surface = {
        "baseColorFactor": [1, 0.5, 0.5, 1],
        "baseColorTexture": {"index": picture, "texCoord": 0, "extensions": moved},
        "metallicFactor": 0.5,
        "roughnessFactor": 0.7,
    }
    return {
        "name": "painted",
        "pbrMetallicRoughness": surface,
        "normalTexture": {"index": file.texture(_encoded("jpg", "RGB"), mime="image/jpeg"), "scale": 0.8},
        "emissiveFactor": [1, 1, 0.5],
        "emissiveTexture": {"index": picture},
        "alphaMode": "MASK",
        "alphaCutoff": 0.5,
        "doubleSided": True,
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 3}},
    }


def _glass() -> dict:
    extensions = {
        "KHR_materials_transmission": {"transmissionFactor": 0.5},
        "KHR_materials_ior": {"ior": 1.4},
        "KHR_materials_volume": {"thicknessFactor": 1.0},
    }
    return {"pbrMetallicRoughness": {"metallicFactor": 0.0}, "extensions": extensions}


def _add_skin(file: File) -> None:
    joints, weights = np.zeros((8, 4), np.uint8), np.tile(np.array([1, 0, 0, 0], np.float32), (8, 1))
    skinned = file.primitive(attributes={"JOINTS_0": joints, "WEIGHTS_0": weights})
    joint = file.node(name="joint")
    inverse = file.accessor(np.eye(4, dtype=np.float32).reshape(1, 16))
    skin = file.add("skins", {"joints": [joint], "inverseBindMatrices": inverse})
    file.node(name="skinned", mesh=file.mesh(skinned), skin=skin)


def _write(file: File, path: Path) -> None:
    file.save(path, embed=True)


def _read_gltf(folder: Path) -> object:
    (path,) = (path for path in folder.iterdir() if path.suffix in (".glb", ".gltf"))
    return load_gltf(path, width=16, ignore_unsupported=True)


def _encoded(suffix: str, mode: str) -> bytes:
    file = io.BytesIO()
    image = Image.fromarray(PIXELS).convert("RGB").convert(mode)
    image.save(file, format={"jpg": "JPEG"}.get(suffix, suffix.upper()))
    return file.getvalue()


def _pillow_writer(name: str, mode: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / f"a.{name}").write_bytes(_encoded(name.split(".")[-1], mode))

    return write


def _write_deep_png(folder: Path) -> None:
    Image.fromarray(PIXELS[..., 0].astype(np.uint16) * 257).save(folder / "a.png")


def _float_writer(suffix: str) -> Callable[[Path], None]:
    return lambda folder: write_image(folder / f"a.{suffix}", PIXELS[..., :3].astype(np.float32))


def _read_image(folder: Path) -> object:
    (path,) = folder.iterdir()
    return load_image(path)
