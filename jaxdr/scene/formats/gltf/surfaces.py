"""Materials of shapes as those of glTF files: numbers, images and colours of vertices. The reverse of `materials`."""

import dataclasses
import math
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Float, UInt8

from jaxdr.images import to_srgb
from jaxdr.scene.bsdf import BSDF, Diffuse, Mask, NormalMap, Principled, TwoSided
from jaxdr.scene.formats.gltf.materials import BRIGHTEST, IOR, STRENGTH
from jaxdr.scene.formats.gltf.textures import NEAREST, WRAPS
from jaxdr.scene.scene import Shape, unwrap
from jaxdr.scene.textures import Bitmap, Product, Texture, VertexColors

LINEAR = 9729  # the filter of bilinear textures
CODES = {name: code for code, name in WRAPS.items()}
LOBES = ("anisotropic", "spec_tint", "sheen", "clearcoat", "spec_trans", "flatness")  # of Principled, not of glTF


@dataclasses.dataclass
class Surface:
    """The material of a shape: its JSON without textures, its images and their samplers by names of textures.

    `colors` multiply the base colour at the vertices; None without.
    """

    material: dict[str, Any]
    images: dict[str, UInt8[np.ndarray, "H W C"]] = dataclasses.field(default_factory=dict)
    samplers: dict[str, dict[str, int]] = dataclasses.field(default_factory=dict)
    colors: Float[np.ndarray, "V 3"] | None = None

    def add(self, name: str, pixels: np.ndarray, sampler: dict[str, int]) -> None:
        """Add an image in [0, 1] under the name of a texture of glTF."""
        self.images[name] = np.round(255 * pixels).astype(np.uint8) if pixels.dtype.kind == "f" else pixels
        self.samplers[name] = sampler


def surface_of(name: str, shape: Shape) -> Surface:
    """The material of a shape. Raises ValueError, with the name of the parameter, for what glTF can't hold."""
    bsdf, opacity, normal = unwrap(shape.bsdf), None, None
    place = f"{name}.bsdf"
    if isinstance(bsdf, Mask):
        opacity, bsdf = bsdf.opacity, bsdf.bsdf
        if shape.emitter is not None:
            _refuse(f"{name}.emitter", "light of a surface with holes", "leave the mask or the emitter out")
    if isinstance(bsdf, NormalMap):
        normal, bsdf = bsdf.normal, bsdf.bsdf
    base, metallic, roughness, specular = _lobes(place, bsdf)
    factors: dict[str, Any] = {}
    surface = Surface({"name": name, "pbrMetallicRoughness": factors})
    if isinstance(shape.bsdf, TwoSided):
        surface.material["doubleSided"] = True
    _base_color(surface, factors, place, base, opacity)
    _metal(surface, factors, place, metallic, roughness)
    if specular != 0.5:
        surface.material["extensions"] = {IOR: {"ior": _index(specular)}}
    if normal is not None:
        image = _bitmap(f"{place}.normal", normal)
        surface.add("normalTexture", _pixels(image), _sampler(image))
    if shape.emitter is not None:
        _emission(surface, f"{name}.emitter.radiance", shape.emitter.radiance)
    return surface


def _lobes(place: str, bsdf: BSDF) -> tuple[Any, Any, Any, float]:
    """(base colour, metallic, roughness, specular) of a BSDF."""
    if isinstance(bsdf, Diffuse):
        return bsdf.reflectance, np.zeros(()), np.ones(()), 0.0
    if not isinstance(bsdf, Principled):
        _refuse(place, f"a {type(bsdf).__name__}", "take a Principled or Diffuse, in a NormalMap or Mask or not")
    for lobe in LOBES:
        value = getattr(bsdf, lobe)
        if value is not None and (isinstance(value, Texture) or float(value) != 0):
            _refuse(f"{place}.{lobe}", "a lobe that glTF lacks", "set it to 0 or None")
    if isinstance(bsdf.specular, Texture):
        _refuse(f"{place}.specular", "a texture of it", "give a number")
    return bsdf.base_color, bsdf.metallic, bsdf.roughness, float(bsdf.specular)


def _base_color(surface: Surface, factors: dict[str, Any], place: str, base: Any, opacity: Any) -> None:
    image, factor = None, np.ones(3)
    for part in (base.first, base.second) if isinstance(base, Product) else (base,):
        if isinstance(part, VertexColors) and surface.colors is None:
            surface.colors = _pixels(part)
        elif isinstance(part, Texture) and image is None:
            image = _bitmap(f"{place}.base_color", part)
        elif isinstance(part, Texture):
            _refuse(f"{place}.base_color", "a product of two images", "multiply their pixels")
        else:
            factor = np.asarray(part, float)
    pixels = None if image is None else to_srgb(_pixels(image))
    sampler = None if image is None else _sampler(image)
    alpha = 1.0
    if isinstance(opacity, Texture):
        mask = _bitmap(f"{place}.opacity", opacity)
        holes = np.round(255 * _pixels(mask)[..., :1]).astype(np.uint8)
        pixels = np.full((*holes.shape[:2], 3), 255, np.uint8) if pixels is None else pixels
        settings = _sampler(mask)
        if pixels.shape[:2] != holes.shape[:2] or sampler not in (None, settings):
            _refuse(f"{place}.opacity", "another size or look-up than that of the base colour", "give both the same")
        pixels, sampler = np.concatenate([pixels, holes], -1), settings
    elif opacity is not None:
        alpha = float(opacity)
    if pixels is not None and sampler is not None:
        surface.add("baseColorTexture", pixels, sampler)
    factors["baseColorFactor"] = [*factor.tolist(), alpha]
    if opacity is not None:
        surface.material["alphaMode"] = "BLEND"


def _metal(surface: Surface, factors: dict[str, Any], place: str, metallic: Any, roughness: Any) -> None:
    """Blue of one image holds metallic and green holds roughness, each times its factor."""
    image = sampler = None
    for channel, field, value in ((2, "metallic", metallic), (1, "roughness", roughness)):
        if not isinstance(value, Texture):
            factors[f"{field}Factor"] = float(value)
            continue
        bitmap = _bitmap(f"{place}.{field}", value)
        pixels, settings = _pixels(bitmap), _sampler(bitmap)
        image = np.ones((*pixels.shape[:2], 3)) if image is None else image
        if image.shape[:2] != pixels.shape[:2] or sampler not in (None, settings):
            _refuse(f"{place}.{field}", "another size or look-up than that of metallic", "give both the same")
        image[..., channel], sampler = pixels[..., 0], settings
        factors[f"{field}Factor"] = 1.0
    if image is not None and sampler is not None:
        surface.add("metallicRoughnessTexture", image, sampler)


def _emission(surface: Surface, place: str, radiance: Any) -> None:
    image = _bitmap(place, radiance) if isinstance(radiance, Texture) else None
    values = np.asarray(radiance, float) if image is None else _pixels(image)
    brightest = float(values.max())
    if brightest == 0:
        return
    strength = max(brightest, 1.0) if image is None else brightest
    factor = np.ones(3)
    if image is None:
        factor = values / strength
    else:
        surface.add("emissiveTexture", to_srgb(values / strength), _sampler(image))
    surface.material["emissiveFactor"] = factor.tolist()
    if strength != 1:
        surface.material.setdefault("extensions", {})[STRENGTH] = {"emissiveStrength": strength}


def _index(specular: float) -> float:
    """The index of refraction at which BRIGHTEST x specular is reflected at normal incidence."""
    amplitude = math.sqrt(BRIGHTEST * specular)
    index = (1 + amplitude) / (1 - amplitude)
    while ((index - 1) / (index + 1)) ** 2 > BRIGHTEST:  # by rounding
        index = math.nextafter(index, 1.0)
    return index


def _bitmap(place: str, texture: Any) -> Bitmap:
    if not isinstance(texture, Bitmap):
        remedy = "give a Bitmap" + (", or VertexColors" if place.endswith("base_color") else "")
        _refuse(place, f"a {type(texture).__name__} of it", remedy)
    if texture.to_uv is not None:
        _refuse(place, "a to_uv of its texture", "map the uvs of the mesh instead (Mesh.with_uvs)")
    return texture


def _pixels(texture: Bitmap | VertexColors) -> np.ndarray:
    return np.asarray(texture.pixels if isinstance(texture, Bitmap) else texture.colors)


def _sampler(image: Bitmap) -> dict[str, int]:
    along_u, along_v = (image.wrap, image.wrap) if isinstance(image.wrap, str) else image.wrap
    code = NEAREST if image.filter == "nearest" else LINEAR
    return {"magFilter": code, "minFilter": code, "wrapS": CODES[along_u], "wrapT": CODES[along_v]}


def _refuse(place: str, what: str, remedy: str) -> NoReturn:
    raise ValueError(f"save_gltf: {place}: glTF can't hold {what}; {remedy}")
