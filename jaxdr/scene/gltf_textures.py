"""Textures of glTF 2.0 materials: which are read, and the `Bitmap`s they become. trimesh decodes the images."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from PIL import Image

from jaxdr.images import from_srgb
from jaxdr.scene.textures import Bitmap

READ = ("baseColorTexture", "metallicRoughnessTexture", "normalTexture", "emissiveTexture")  # not occlusion: traced
WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
NEAREST = 9728


def texture_infos(material: dict) -> dict[str, dict]:
    """The textures of a material that are read, by name."""
    return {name: info for name, info in _infos(material) if name in READ and not _obstacle(info)}


def unsupported_textures(header: dict, material: dict) -> Iterator[str]:
    """What is not supported about a material's textures, and what happens instead."""
    for name, info in _infos(material):
        if _obstacle(info):
            yield f"{name} {_obstacle(info)}, which is not supported; it is left out"
            continue
        for extension in info.get("extensions", {}):
            yield f"{name}: extension {extension} is not supported; it has no effect"
        sampler = _sampler(header, info)
        if sampler.get("wrapS") != sampler.get("wrapT"):
            yield f"{name} wraps differently along u and v, which is not supported; as along u it wraps along both"


def color(header: dict, info: dict, image: Image.Image, factor) -> Bitmap:
    """Base or emitted colours, which are stored in sRGB, times a linear RGB factor."""
    return _bitmap(header, info, from_srgb(_pixels(image)) * np.asarray(factor, float))


def metallic_roughness(header: dict, info: dict, image: Image.Image, metallic, roughness) -> tuple[Bitmap, Bitmap]:
    """(metallic, roughness): blue and green times a factor."""
    pixels = _pixels(image)
    return _bitmap(header, info, pixels[..., 2] * metallic), _bitmap(header, info, pixels[..., 1] * roughness)


def normal_map(header: dict, info: dict, image: Image.Image) -> Bitmap:
    """Normals, stored as `NormalMap` has them: the tangent is along u."""
    return _bitmap(header, info, _pixels(image))


def _infos(material: dict) -> Iterator[tuple[str, dict]]:
    for name in READ:
        for owner in (material, material.get("pbrMetallicRoughness", {})):
            if name in owner:
                yield name, owner[name]


def _obstacle(info: dict) -> str:
    """Why a texture can't be read; empty where it can."""
    if info.get("texCoord", 0) != 0:
        return "uses a second set of texture coordinates"
    return "has a scale other than 1" if info.get("scale", 1) != 1 else ""


def _sampler(header: dict, info: dict) -> dict:
    texture = header["textures"][info["index"]]
    return header["samplers"][texture["sampler"]] if "sampler" in texture else {}


def _bitmap(header: dict, info: dict, pixels: Float[np.ndarray, "H W *C"]) -> Bitmap:
    sampler = _sampler(header, info)
    nearest = sampler.get("magFilter") == NEAREST
    return Bitmap(pixels, filter="nearest" if nearest else "bilinear", wrap=WRAPS[sampler.get("wrapS", 10497)])


def _pixels(image: Image.Image) -> Float[np.ndarray, "H W 3"]:
    return np.asarray(image.convert("RGB"), np.float32) / 255
