"""Textures of glTF materials: which of them are read, their images, and the `Bitmap`s that they become."""

import io
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.gltf.document import Document, number, numbers
from jaxdr.image_formats import png
from jaxdr.images import from_srgb
from jaxdr.scene.textures import Bitmap
from jaxdr.untrusted import LARGEST, check_memory, damage, opened_picture, shortened

# The occlusion texture is not read: light paths account for occlusion.
READ = ("baseColorTexture", "normalTexture", "metallicRoughnessTexture", "emissiveTexture", "transmissionTexture")
TRANSFORM = "KHR_texture_transform"
IMAGES = ("EXT_texture_webp", "EXT_texture_avif", "MSFT_texture_dds")  # further image formats, which Pillow reads
FORMATS = ("PNG", "JPEG", "WEBP", "DDS", "AVIF")  # Pillow's names for them, with those of glTF itself
WRAPS = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
NEAREST, LINEAR = 9728, 9729


def texture_infos(material: dict) -> dict[str, dict]:
    """The references of a material to the textures that are read, by name."""
    found = {}
    transmission = material.get("extensions", {}).get("KHR_materials_transmission", {})
    for owner in (material, material.get("pbrMetallicRoughness", {}), transmission):
        found.update({name: owner[name] for name in READ if name in owner})
    return {name: found[name] for name in READ if name in found}


def chosen_uv_set(document: Document, material: dict, attributes: dict) -> int | None:
    """The number of the texture coordinates that the mesh of a primitive gets; None if it has none.

    They are those of the first texture whose texture coordinates the primitive has, or else its first ones.
    """
    wanted = [_uv_set(info) for info in texture_infos(material).values() if _source(document, info) is not None]
    wanted += [int(name.removeprefix("TEXCOORD_")) for name in attributes if name.startswith("TEXCOORD_")]
    return next((number for number in wanted if f"TEXCOORD_{number}" in attributes), None)


def usable_textures(document: Document, material: dict, attributes: dict) -> dict[str, dict]:
    """The references of a material to textures that a primitive with these attributes can use."""
    chosen = chosen_uv_set(document, material, attributes)
    return {
        name: info
        for name, info in texture_infos(material).items()
        if chosen is not None and _uv_set(info) == chosen and _source(document, info) is not None
    }


def left_out_textures(document: Document, material: dict, attributes: dict) -> Iterator[str]:
    """Messages: which textures of a material a primitive with these attributes can't use, and why."""
    usable = usable_textures(document, material, attributes)
    for name, info in texture_infos(material).items():
        number = _uv_set(info)
        if name in usable:
            continue
        if _source(document, info) is None:
            formats = ", ".join(document.item("textures", info["index"], name).get("extensions", {}))
            yield f"{name} has no image in a format that is supported ({formats or 'none'}); it is left out"
        elif f"TEXCOORD_{number}" not in attributes:
            yield f"there are no texture coordinates (TEXCOORD_{number}) for {name}; it is left out"
        else:
            first = next(iter(usable))
            yield f"{name} uses other texture coordinates than {first}, which is not supported; it is left out"


def _uv_set(info: dict) -> int:
    """The number of the texture coordinates that a reference asks for."""
    return info.get("extensions", {}).get(TRANSFORM, {}).get("texCoord", info.get("texCoord", 0))


def _source(document: Document, info: dict) -> int | None:
    """The number of the image of a reference to a texture; None if it has none in a format that is read."""
    texture = document.item("textures", info["index"], "a material")
    sources = [texture.get("extensions", {}).get(name, {}).get("source") for name in IMAGES]
    return next((source for source in (*sources, texture.get("source")) if source is not None), None)


class Textures:
    """Makes `Bitmap`s from a file's textures. Each image is decoded once."""

    def __init__(self, document: Document):
        self.document = document
        self._images: dict[int, np.ndarray] = {}
        self._taken = 0  # bytes of all images and textures

    def pixels(self, info: dict, place: str) -> Float[np.ndarray, "H W 4"]:
        """The image of a texture as it is stored, in [0, 1]. Alpha is 1 if the image has none."""
        source = _source(self.document, info)
        assert source is not None, "only usable textures are asked for"
        if source not in self._images:
            self._images[source] = self._image(source, place)
            self._take(self._images[source])
        return self._images[source]

    def bitmap(self, info: dict, pixels: Float[np.ndarray, "H W *C"], place: str, nearest: bool = False) -> Bitmap:
        """These pixels as a texture, with the sampler and the transform of a texture of the file."""
        texture = self.document.item("textures", info["index"], place)
        label = self.document.label("textures", info["index"])
        sampler = self.document.item("samplers", texture["sampler"], label) if "sampler" in texture else {}
        with self.document.at(label):
            along_u, along_v = (WRAPS[_choice(sampler, name, tuple(WRAPS))] for name in ("wrapS", "wrapT"))
            is_nearest = _choice(sampler, "magFilter", (LINEAR, NEAREST)) == NEAREST
            self._take(pixels)
        return Bitmap(
            pixels,
            filter="nearest" if nearest or is_nearest else "bilinear",
            wrap=along_u if along_u == along_v else (along_u, along_v),
            to_uv=_to_uv(info),
        )

    def _take(self, pixels: np.ndarray) -> None:
        """Raises ValueError where all images and textures together take more memory than there is."""
        self._taken += pixels.nbytes
        check_memory(self._taken, "the images and textures")

    def _image(self, index: int, place: str) -> Float[np.ndarray, "H W 4"]:
        image, label = self.document.item("images", index, place), f"image {index}"
        with self.document.at(label):
            if "uri" in image:
                data = self.document.bytes_at(image["uri"], label)
            else:
                data = self.document.view(image["bufferView"], label)
            stored = _decoded(bytes(data))
        if stored.shape[2] == 1:
            stored = np.repeat(stored, 3, axis=2)
        if stored.shape[2] == 3:
            stored = np.concatenate([stored, np.ones_like(stored[..., :1])], axis=2)
        return stored


def linear(pixels: Float[np.ndarray, "H W 4"], factor) -> Float[np.ndarray, "H W 3"]:
    """Linear RGB of base or emitted colours, which are stored in sRGB, times a linear RGB factor."""
    return from_srgb(pixels[..., :3]) * np.asarray(factor, np.float32)


def normals(pixels: Float[np.ndarray, "H W 4"], strength: float, flip: bool) -> Float[np.ndarray, "H W 3"]:
    """Normals as `NormalMap` stores them, with x and y times `strength`. `flip` turns y over, for mirrored UVs."""
    n = (2 * pixels[..., :3] - 1) * np.array([strength, -strength if flip else strength, 1], np.float32)
    return 0.5 * n / max(1.0, abs(strength)) + 0.5  # the length of a normal has no effect


def _decoded(data: bytes) -> Float[np.ndarray, "H W C"]:
    with opened_picture(io.BytesIO(data), FORMATS) as image:
        if image.format not in ("PNG", "JPEG"):
            with damage(f"not a readable {image.format} file"):
                return np.asarray(image.convert("RGBA"), np.float32) / 255
    return png.read(io.BytesIO(data))


def _choice(sampler: dict, name: str, codes: tuple[int, ...]) -> int:
    """A property of a sampler that is one of these; the first without it."""
    code = sampler.get(name, codes[0])
    if code not in codes:
        raise ValueError(f"{name} must be one of {', '.join(map(str, codes))}, not {shortened(code)}")
    return code


def _to_uv(info: dict) -> Float[np.ndarray, "2 3"] | None:
    """KHR_texture_transform for UVs whose v goes up: offset · rotation · scale, with v turned over before and after."""
    transform = info.get("extensions", {}).get(TRANSFORM)
    if transform is None:
        return None
    angle = number(transform, "rotation", -LARGEST, default=0.0)
    (su, sv), offset = numbers(transform, "scale", (1.0, 1.0)), numbers(transform, "offset", (0.0, 0.0))
    # Anticlockwise in the image, so clockwise in glTF's coordinates, whose v goes down.
    turned = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) * (su, sv)
    down = np.eye(3)
    down[:2] = np.column_stack([turned, offset])
    over = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])
    return (over @ down @ over)[:2]
