"""Materials of glTF files as BSDFs and area emitters."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import numpy as np

from jaxdr.arrays import as_array, on_host
from jaxdr.geometry.gltf.document import Document, numbers
from jaxdr.scene.bsdf import BSDF, Dielectric, Mask, NormalMap, Principled, RoughDielectric, ThinDielectric, TwoSided
from jaxdr.scene.bsdf.parameters import SMOOTHEST
from jaxdr.scene.emitters import AreaEmitter
from jaxdr.scene.formats.gltf.problems import Problems
from jaxdr.scene.formats.gltf.textures import (
    Textures,
    left_out_textures,
    linear,
    normals,
    texture_infos,
    usable_textures,
)
from jaxdr.scene.textures import Texture, VertexColors

STRENGTH = "KHR_materials_emissive_strength"
IOR, SPECULAR = "KHR_materials_ior", "KHR_materials_specular"
TRANSMISSION, VOLUME = "KHR_materials_transmission", "KHR_materials_volume"
READ = (STRENGTH, IOR, SPECULAR, TRANSMISSION, VOLUME)
# Lobes that are not read, with the value at which they have no effect.
LOBES = {
    "KHR_materials_clearcoat": ("clearcoatFactor", 0),
    "KHR_materials_sheen": ("sheenColorFactor", [0, 0, 0]),
    "KHR_materials_iridescence": ("iridescenceFactor", 0),
    "KHR_materials_anisotropy": ("anisotropyStrength", 0),
    "KHR_materials_dispersion": ("dispersion", 0),
    "KHR_materials_diffuse_transmission": ("diffuseTransmissionFactor", 0),
}
INSTEAD = {
    "KHR_materials_unlit": "light falls on it as on others",
    "KHR_materials_pbrSpecularGlossiness": "its metallic-roughness values count",
    "KHR_materials_dispersion": "one index counts for all colours",
}
BRIGHTEST = 0.08  # reflectance at normal incidence that `Principled` can have: specular = 1


def unsupported_in(material: dict) -> Iterator[str]:
    """What is not supported about a material, and what happens instead."""
    extensions = material.get("extensions", {})
    for name, extension in extensions.items():
        if name in LOBES:
            key, neutral = LOBES[name]
            if extension.get(key, neutral) == neutral:
                continue
        if name not in READ:
            yield f"extension {name} is not supported; {INSTEAD.get(name, 'it has no effect')}"
    specular = extensions.get(SPECULAR, {})
    for name in ("specularTexture", "specularColorTexture"):
        if name in specular:
            yield f"{SPECULAR}: {name} is not supported; it is left out"
    if specular.get("specularColorFactor", [1, 1, 1]) != [1, 1, 1]:
        yield f"{SPECULAR}: specularColorFactor is not supported; white counts"
    if _reflectance(material) > BRIGHTEST:
        yield f"{IOR}: an index of {extensions[IOR]['ior']:g} is not supported; 1.79 counts"
    if (obstacle := _transmission_obstacle(material)) is not None:
        yield obstacle
    if _transmits(material) and extensions.get(VOLUME, {}).get("attenuationDistance", np.inf) != np.inf:
        if extensions[VOLUME].get("attenuationColor", [1, 1, 1]) != [1, 1, 1]:
            yield f"{VOLUME}: absorption inside is not supported; it is left out"


def unsupported_at(document: Document, material: dict, attributes: dict, colors_vary: bool) -> Iterator[str]:
    """What is not supported about a material at a primitive with these attributes, and what happens instead."""
    yield from left_out_textures(document, material, attributes)
    if colors_vary and "baseColorTexture" in usable_textures(document, material, attributes):
        yield "vertex colours on a base colour texture are not supported; the texture alone counts"


class Materials:
    """Makes BSDFs and emitters of a file's materials; primitives with the same needs share them."""

    def __init__(self, document: Document, problems: Problems):
        self.document, self.problems = document, problems
        self.textures = Textures(document)
        self._made: dict[tuple, tuple] = {}

    def make(
        self, index: int | None, attributes: dict, colors: np.ndarray | None, flip: bool
    ) -> tuple[BSDF | TwoSided | None, AreaEmitter | None]:
        """(BSDF, emitter) of a material at a primitive with these attributes; no BSDF for one that nobody sees.

        `colors` [V, 3 or 4] belong to the vertices of its mesh, or are one colour [3 or 4]. `flip`: its UVs are
        mirrored.
        """
        material = {} if index is None else self.document.item("materials", index, "a primitive")
        label = "the default material" if index is None else self.document.label("materials", index)
        infos = usable_textures(self.document, material, attributes)
        key = (index, tuple(infos), None if colors is None else (*colors,) if colors.ndim == 1 else id(colors), flip)
        if key not in self._made:
            with self.document.at(label):
                # The colours are kept with what is made of them, so that their id stays theirs.
                self._made[key] = (*self._material(label, material, infos, colors, flip), colors)
        return self._made[key][:2]

    def _material(self, label: str, material: dict, infos: dict, colors: np.ndarray | None, flip: bool):
        factors = material.get("pbrMetallicRoughness", {})
        factor = numbers(factors, "baseColorFactor", (1.0, 1.0, 1.0, 1.0))
        if colors is not None and colors.ndim == 1:
            factor = factor * np.append(colors, 1.0)[:4]
            colors = None
        opacity = self._opacity(label, material, infos, factor[3], colors)
        if isinstance(opacity, float) and opacity == 0:
            self.problems.note(f"{label}: its alpha makes it invisible; shapes of it are left out")
            return None, None
        base: Any = factor[:3]
        if (info := infos.get("baseColorTexture")) is not None:
            base = self.textures.bitmap(info, linear(self.textures.pixels(info, label), base), label)
        elif colors is not None:
            base = VertexColors(colors[:, :3] * base.astype(np.float32))
        metallic, roughness = factors.get("metallicFactor", 1.0), factors.get("roughnessFactor", 1.0)
        if (info := infos.get("metallicRoughnessTexture")) is not None:
            pixels = self.textures.pixels(info, label)
            metallic, roughness = (
                self.textures.bitmap(info, pixels[..., channel] * np.float32(number), label)
                for channel, number in ((2, metallic), (1, roughness))
            )
        bsdf: BSDF = self._surface(label, material, base, metallic, roughness)
        if (info := infos.get("normalTexture")) is not None:
            pixels = normals(self.textures.pixels(info, label), float(info.get("scale", 1.0)), flip)
            bsdf = NormalMap(self.textures.bitmap(info, pixels, label), bsdf)
        if not isinstance(opacity, float) or opacity < 1:
            bsdf = Mask(opacity, bsdf)
        emitter = self._emitter(label, material, infos, opacity)
        both_sides = material.get("doubleSided", False) and not bsdf.transmissive
        return TwoSided(bsdf) if both_sides else bsdf, emitter

    def _surface(self, label: str, material: dict, base: Any, metallic: Any, roughness: Any) -> BSDF:
        """Glass, or metallic and roughness as the principled model has them."""
        if _transmits(material):
            index, thick = material["extensions"].get(IOR, {}).get("ior", 1.5), _is_thick(material)
            if thick and float(roughness) ** 2 > SMOOTHEST and index != 1:
                return RoughDielectric(float(roughness) ** 2, index, 1.0, specular_transmittance=base)
            if not thick:
                self.problems.note(
                    f"{label}: {TRANSMISSION}: a thin pane has two surfaces here: it reflects 2 R / (1 + R) where one "
                    "reflects R"
                )
            model: Any = Dielectric if thick else ThinDielectric
            return model(index, 1.0, specular_transmittance=base)
        strength = material.get("extensions", {}).get(SPECULAR, {}).get("specularFactor", 1.0)
        if strength not in (0, 1):
            self.problems.note(f"{label}: {SPECULAR}: specularFactor scales the reflection at normal incidence alone")
        return Principled(base, metallic, roughness, min(_reflectance(material) / BRIGHTEST, 1.0) * strength)

    def _opacity(self, label: str, material: dict, infos: dict, factor: float, colors: np.ndarray | None) -> Any:
        """The share of the surface that is there: a number, or a texture."""
        mode = material.get("alphaMode", "OPAQUE")
        if mode == "OPAQUE":
            return 1.0
        if mode not in ("MASK", "BLEND"):
            raise ValueError(f"alphaMode must be OPAQUE, MASK or BLEND, not {mode!r}")
        cutoff = float(material.get("alphaCutoff", 0.5)) if mode == "MASK" else None
        info, alpha = infos.get("baseColorTexture"), np.asarray(factor, np.float32)
        if info is not None:
            alpha = self.textures.pixels(info, label)[..., 3] * alpha
        elif colors is not None and colors.shape[1] == 4:
            alpha = colors[:, 3] * alpha
        if cutoff is not None:
            # Of alphas that may have been rounded on their way.
            there = (alpha >= np.float32(cutoff)).astype(np.float32)
            if info is None and np.ndim(alpha) and there.min() != there.max():
                self.problems.note(
                    f"{label}: alphaMode MASK with alpha at vertices: holes fade between vertices, "
                    "instead of ending at the cutoff"
                )
            alpha = there
        if np.min(alpha) == np.max(alpha):
            return float(np.min(alpha))
        if info is None:
            return VertexColors(alpha)
        if cutoff is not None:
            self.problems.note(
                f"{label}: alphaMode MASK: holes end at the borders of texels, not between their centres"
            )
        return self.textures.bitmap(info, alpha, label, nearest=cutoff is not None)

    def _emitter(self, label: str, material: dict, infos: dict, opacity: Any) -> AreaEmitter | None:
        """Emissive factor times strength, times the texture and the opacity, as radiance."""
        strength = material.get("extensions", {}).get(STRENGTH, {}).get("emissiveStrength", 1.0)
        radiance = strength * numbers(material, "emissiveFactor", (0.0, 0.0, 0.0))
        if not radiance.any():
            return None
        info = infos.get("emissiveTexture")
        if material.get("doubleSided", False):
            self.problems.note(f"{label}: it is double-sided, and shines from its front only")
        if isinstance(opacity, Texture) and info is None:
            shares = opacity.data()
            return AreaEmitter(
                eqx.tree_at(lambda t: t.data(), opacity, tuple(as_array(s * radiance) for s in map(on_host, shares)))
            )
        if isinstance(opacity, Texture):
            self.problems.note(f"{label}: its emissive texture shines where its alpha has holes, too")
        else:
            radiance = opacity * radiance
        if info is None:
            return AreaEmitter(radiance)
        return AreaEmitter(self.textures.bitmap(info, linear(self.textures.pixels(info, label), radiance), label))


def _reflectance(material: dict) -> float:
    """Of the surface, at normal incidence, where it is not metal."""
    index = material.get("extensions", {}).get(IOR, {}).get("ior", 1.5)
    return ((index - 1) / (index + 1)) ** 2


def _is_thick(material: dict) -> bool:
    """Whether the surface is the border of a volume, so that it refracts."""
    return material.get("extensions", {}).get(VOLUME, {}).get("thicknessFactor", 0) > 0


def _wants_transmission(material: dict) -> bool:
    extension = material.get("extensions", {}).get(TRANSMISSION, {})
    # All light that enters a metal is absorbed.
    metal = _factor(material, "metallicFactor") == 1 and "metallicRoughnessTexture" not in texture_infos(material)
    return extension.get("transmissionFactor", 0) != 0 and not metal


def _transmits(material: dict) -> bool:
    """Whether a material becomes glass."""
    extension = material.get("extensions", {}).get(TRANSMISSION, {})
    return (
        _wants_transmission(material)
        and extension["transmissionFactor"] == 1
        and "transmissionTexture" not in extension
        and _factor(material, "metallicFactor") == 0
        and "metallicRoughnessTexture" not in texture_infos(material)
    )


def _transmission_obstacle(material: dict) -> str | None:
    """What is not supported about light that goes through a material, and what happens instead."""
    if not _wants_transmission(material):
        return None
    if not _transmits(material):
        return (
            f"{TRANSMISSION}: only what is all glass is supported (transmissionFactor 1, metallicFactor 0, no textures "
            "of these); it is opaque"
        )
    if not _is_thick(material) and _factor(material, "roughnessFactor") ** 2 > SMOOTHEST:
        return f"{TRANSMISSION}: a thin rough pane is not supported; it is smooth"
    return None


def _factor(material: dict, name: str) -> float | int:
    return material.get("pbrMetallicRoughness", {}).get(name, 1.0)
