"""Light that goes through glTF materials: the share of a material that is glass, and the kind of glass.

In KHR_materials_transmission the part that is not metal reflects at its surface. Of the light that enters it, a share t
goes through and the rest is diffuse. With metallic m, a share t (1 - m) of the material is glass. Of the remaining
share, m / (1 - t (1 - m)) is metal.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxdr.arrays import as_array, on_host
from jaxdr.geometry.gltf.document import number
from jaxdr.scene.bsdf import BSDF, Dielectric, RoughDielectric, ThinDielectric
from jaxdr.scene.bsdf.parameters import SMOOTHEST
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.formats.gltf.textures import Textures
from jaxdr.untrusted import LARGEST

IOR, SPECULAR = "KHR_materials_ior", "KHR_materials_specular"
TRANSMISSION, VOLUME = "KHR_materials_transmission", "KHR_materials_volume"
TEXTURE, METAL_TEXTURE = "transmissionTexture", "metallicRoughnessTexture"


class Glass(NamedTuple):
    """The `share` of a surface that is glass, and the `metallic` share of the rest. Both are numbers or textures."""

    share: Any
    metallic: Any

    @property
    def there(self) -> bool:
        return not isinstance(self.share, float) or self.share > 0

    @property
    def whole(self) -> bool:
        return isinstance(self.share, float) and self.share == 1


def glass_of(material: dict, infos: dict, textures: Textures, label: str) -> Glass:
    """How much of a material is glass. It is none if the combination of textures is not supported."""
    factors = material.get("pbrMetallicRoughness", {})
    metal, through = number(factors, "metallicFactor", -LARGEST, default=1.0), _factor(material)
    metal_info = infos.get(METAL_TEXTURE) if metal else None
    info = infos.get(TEXTURE) if through else None
    if metal_info is not None and info is not None and not _same_place(metal_info, info):
        through, info = 0.0, None
    metals = metal if metal_info is None else textures.pixels(metal_info, label)[..., 2] * np.float32(metal)
    glass = through if info is None else textures.pixels(info, label)[..., 0] * np.float32(through)
    shares = np.asarray(glass * (1 - metals))
    others = np.where(shares < 1, 1 - shares, 1)

    def made(values: np.ndarray) -> Any:
        if np.ptp(values) == 0:
            return float(values.flat[0])
        placed = info or metal_info
        assert placed is not None
        return textures.bitmap(placed, values.astype(np.float32), label)

    return Glass(made(shares), made(np.where(shares < 1, metals / others, 0)))


def glass_bsdf(label: str, material: dict, base: Any, roughness: Any, problems: Problems) -> BSDF:
    """The BSDF of the glass: that of the border of a volume, or that of a thin pane."""
    index = index_of(material)
    if not _is_thick(material):
        problems.note(
            f"{label}: {TRANSMISSION}: a thin pane has two surfaces here: it reflects 2 R / (1 + R) where one "
            "reflects R"
        )
        return _smooth(ThinDielectric, index, base)
    if index == 1 or (isinstance(roughness, float) and roughness**2 <= SMOOTHEST):
        return _smooth(Dielectric, index, base)
    return RoughDielectric(_alpha(roughness), index, 1.0, specular_transmittance=base)


def _smooth(model: Any, index: float, base: Any) -> BSDF:
    return model(index, 1.0, specular_transmittance=base)


def unsupported_glass(material: dict, infos: dict) -> Iterator[str]:
    """Messages: what is not supported about light that goes through a material, and what happens instead."""
    factors, extensions = material.get("pbrMetallicRoughness", {}), material.get("extensions", {})
    metal = number(factors, "metallicFactor", -LARGEST, default=1.0)
    if not _factor(material) or (metal == 1 and METAL_TEXTURE not in infos):  # a metal absorbs what enters it
        return
    both = [infos[name] for name in (METAL_TEXTURE, TEXTURE) if name in infos and (name == TEXTURE or metal)]
    if len(both) == 2 and not _same_place(*both):
        yield f"{TRANSMISSION}: {TEXTURE} and {METAL_TEXTURE} of different images are not supported; it is opaque"
        return
    thick = _is_thick(material)
    if not thick and number(factors, "roughnessFactor", -LARGEST, default=1.0) ** 2 > SMOOTHEST:
        yield f"{TRANSMISSION}: a thin rough pane is not supported; it is smooth"
    if not thick and material.get("doubleSided", False) and (_factor(material) < 1 or both or metal):
        yield f"{TRANSMISSION}: a pane that is glass in part is not supported on two sides; behind the rest is black"
    if extensions.get(SPECULAR, {}).get("specularFactor", 1.0) != 1:
        yield f"{SPECULAR}: specularFactor of glass is not supported; only its index counts"
    volume = extensions.get(VOLUME, {})
    if volume.get("attenuationDistance", np.inf) != np.inf and volume.get("attenuationColor", [1, 1, 1]) != [1, 1, 1]:
        yield f"{VOLUME}: absorption inside is not supported; it is left out"


def _factor(material: dict) -> float:
    return number(_extension(material, TRANSMISSION), "transmissionFactor", 0.0, 1.0, default=0.0)


def index_of(material: dict) -> float:
    """The index of refraction of a material: the specification allows 0, and 1 and more."""
    return number(_extension(material, IOR), "ior", 0.0, default=1.5)


def _extension(material: dict, name: str) -> dict:
    return material.get("extensions", {}).get(name, {})


def _is_thick(material: dict) -> bool:
    """Whether the surface is the border of a volume, so that it refracts."""
    return number(_extension(material, VOLUME), "thicknessFactor", 0.0, default=0.0) > 0


def _same_place(one: dict, other: dict) -> bool:
    """Whether two references to textures place the same texels in the same way."""
    return (one["index"], one.get("texCoord", 0), one.get("extensions", {})) == (
        other["index"],
        other.get("texCoord", 0),
        other.get("extensions", {}),
    )


def _alpha(roughness: Any) -> Any:
    """Alpha of the microfacets. Values of a texture that are too small become the least allowed."""
    if isinstance(roughness, float):
        return roughness**2
    return eqx.tree_at(lambda t: t.pixels, roughness, as_array(np.maximum(on_host(roughness.pixels) ** 2, SMOOTHEST)))
