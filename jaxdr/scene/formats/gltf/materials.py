"""Materials of glTF files as BSDFs and area emitters."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxdr.geometry.gltf.document import Document, number, numbers
from jaxdr.scene.bsdf import BSDF, Blend, Diffuse, Mask, NormalMap, Principled, TwoSided
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
from jaxdr.scene.formats.gltf.transmission import (
    IOR,
    SPECULAR,
    TRANSMISSION,
    VOLUME,
    glass_bsdf,
    glass_of,
    index_of,
    unsupported_glass,
)
from jaxdr.scene.formats.ties import Made
from jaxdr.scene.textures import Product, Texture, VertexColors
from jaxdr.untrusted import LARGEST

STRENGTH = "KHR_materials_emissive_strength"
UNLIT = "KHR_materials_unlit"
READ = (STRENGTH, IOR, SPECULAR, TRANSMISSION, VOLUME, UNLIT)
# Lobes that are not read: the factor of each, and the value of that factor at which the lobe has no effect.
LOBES = {
    "KHR_materials_clearcoat": ("clearcoatFactor", 0),
    "KHR_materials_sheen": ("sheenColorFactor", [0, 0, 0]),
    "KHR_materials_iridescence": ("iridescenceFactor", 0),
    "KHR_materials_anisotropy": ("anisotropyStrength", 0),
    "KHR_materials_dispersion": ("dispersion", 0),
    "KHR_materials_diffuse_transmission": ("diffuseTransmissionFactor", 0),
}
INSTEAD = {
    # Burley's lobes differ: his coat reflects from 0.6 (head on) to 0.1 (grazing) as much light as glTF's, and his
    # sheen has another shape.
    "KHR_materials_clearcoat": "there is no coat; that of Principled is another one",
    "KHR_materials_sheen": "there is no sheen; that of Principled is another one",
    "KHR_materials_pbrSpecularGlossiness": "its metallic-roughness values count",
    "KHR_materials_dispersion": "one index counts for all colours",
}
BRIGHTEST = 0.08  # largest reflectance at normal incidence that `Principled` can have, at specular = 1


def unsupported_in(material: dict) -> Iterator[str]:
    """Messages: what is not supported in a material, and what happens instead."""
    extensions = material.get("extensions", {})
    for name, extension in extensions.items():
        if name in LOBES:
            key, neutral = LOBES[name]
            if is_unlit(material) or extension.get(key, neutral) == neutral:
                continue
        if name not in READ:
            yield f"extension {name} is not supported; {INSTEAD.get(name, 'it has no effect')}"
    if is_unlit(material):  # reflects nothing
        return
    specular = extensions.get(SPECULAR, {})
    for name in ("specularTexture", "specularColorTexture"):
        if name in specular:
            yield f"{SPECULAR}: {name} is not supported; it is left out"
    if specular.get("specularColorFactor", [1, 1, 1]) != [1, 1, 1]:
        yield f"{SPECULAR}: specularColorFactor is not supported; white counts"
    if _reflectance(material) > BRIGHTEST:
        yield f"{IOR}: an index of {extensions[IOR]['ior']:g} is not supported; 1.79 counts"
    yield from unsupported_glass(material, texture_infos(material))


def unsupported_at(document: Document, material: dict, attributes: dict, colors_vary: bool) -> Iterator[str]:
    """Messages: what is not supported in a material at a primitive with these attributes, and what happens instead."""
    yield from left_out_textures(document, material, attributes)
    if colors_vary and material.get("alphaMode") == "MASK":
        has_alpha = document.item("accessors", attributes["COLOR_0"], "COLOR_0")["type"] == "VEC4"
        if has_alpha and "baseColorTexture" in usable_textures(document, material, attributes):
            yield "alphaMode MASK: alpha of vertices on a texture is not supported; only the texture's counts"


class Materials:
    """Makes BSDFs and emitters from a file's materials. Primitives share them where they can."""

    def __init__(self, document: Document, problems: Problems):
        self.document, self.problems = document, problems
        self.textures = Textures(document)
        self._made: dict[tuple, tuple] = {}

    def make(
        self, index: int | None, attributes: dict, colors: np.ndarray | None, flip: bool
    ) -> tuple[BSDF | TwoSided | None, AreaEmitter | None]:
        """(BSDF, emitter) of a material at a primitive with these attributes. An invisible material has no BSDF.

        `colors` [V, 3 or 4] belong to the vertices of its mesh, or are one colour [3 or 4]. `flip`: whether its UVs are
        mirrored.
        """
        material = {} if index is None else self.document.item("materials", index, "a primitive")
        label = "the default material" if index is None else self.document.label("materials", index)
        infos = usable_textures(self.document, material, attributes)
        key = (index, tuple(infos), None if colors is None else (*colors,) if colors.ndim == 1 else id(colors), flip)
        if key not in self._made:
            with self.document.at(label):
                # The colours are kept in the cache, so that no other array gets their id.
                self._made[key] = (*self._material(label, material, infos, colors, flip), colors)
        return self._made[key][:2]

    def made(self) -> list[Made]:
        """The BSDFs and emitters of the materials of the file that were made."""
        found: dict[tuple[int, str], Made] = {}
        for (index, *_), (*parts, _) in self._made.items():
            if index is not None:
                name = self.document.item("materials", index, "a primitive").get("name") or f"material_{index}"
                for kind, part in zip((".bsdf", ".emitter"), parts, strict=True):
                    if part is not None:
                        found.setdefault((index, kind), Made(name, kind, [])).modules.append(part)
        return list(found.values())

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
            if colors is not None:
                base = Product(base, VertexColors(colors[:, :3]))
        elif colors is not None:
            base = VertexColors(colors[:, :3] * base.astype(np.float32))
        if is_unlit(material):
            return self._unlit(label, material, base, opacity)
        bsdf: BSDF = self._surface(label, material, infos, base)
        if (info := infos.get("normalTexture")) is not None:
            strength = number(info, "scale", -LARGEST, default=1.0)
            pixels = normals(self.textures.pixels(info, label), strength, flip)
            bsdf = NormalMap(self.textures.bitmap(info, pixels, label), bsdf)
        if not isinstance(opacity, float) or opacity < 1:
            bsdf = Mask(opacity, bsdf)
        emitter = self._emitter(label, material, infos, opacity)
        both_sides = material.get("doubleSided", False) and not bsdf.transmissive
        return TwoSided(bsdf) if both_sides else bsdf, emitter

    def _surface(self, label: str, material: dict, infos: dict, base: Any) -> BSDF:
        """The principled BSDF of a material, or its glass, or a mixture of both."""
        factors = material.get("pbrMetallicRoughness", {})
        metallic, roughness = (
            number(factors, name, -LARGEST, default=1.0) for name in ("metallicFactor", "roughnessFactor")
        )
        if (info := infos.get("metallicRoughnessTexture")) is not None:
            pixels = self.textures.pixels(info, label)
            metallic, roughness = (
                self.textures.bitmap(info, pixels[..., channel] * np.float32(number), label)
                for channel, number in ((2, metallic), (1, roughness))
            )
        glass = glass_of(material, infos, self.textures, label)
        if glass.whole:
            return glass_bsdf(label, material, base, roughness, self.problems)
        if glass.there:
            metallic = glass.metallic
        strength = number(material.get("extensions", {}).get(SPECULAR, {}), "specularFactor", -LARGEST, default=1.0)
        if strength not in (0, 1):
            self.problems.note(f"{label}: {SPECULAR}: specularFactor scales only the reflection at normal incidence")
        opaque = Principled(base, metallic, roughness, min(_reflectance(material) / BRIGHTEST, 1.0) * strength)
        if not glass.there:
            return opaque
        return Blend(glass.share, opaque, glass_bsdf(label, material, base, roughness, self.problems))

    def _unlit(self, label: str, material: dict, base: Any, opacity: Any) -> tuple[BSDF | TwoSided, AreaEmitter | None]:
        """A surface that shines with its base colour and reflects nothing."""
        bsdf: BSDF = Diffuse(0.0) if isinstance(opacity, float) and opacity == 1 else Mask(opacity, Diffuse(0.0))
        two_sided = TwoSided(bsdf) if material.get("doubleSided", False) else bsdf
        if isinstance(base, np.ndarray) and not base.any():
            return two_sided, None
        self._name_back(label, material)
        if isinstance(base, np.ndarray):
            return two_sided, AreaEmitter(opacity.times(base) if isinstance(opacity, Texture) else opacity * base)
        return two_sided, AreaEmitter(Product(base, opacity) if isinstance(opacity, Texture) else base.times(opacity))

    def _name_back(self, label: str, material: dict) -> None:
        if material.get("doubleSided", False):
            self.problems.note(f"{label}: it is double-sided, and shines from its front only")

    def _opacity(self, label: str, material: dict, infos: dict, factor: float, colors: np.ndarray | None) -> Any:
        """The opacity of the surface: a number, or a texture."""
        mode = material.get("alphaMode", "OPAQUE")
        if mode == "OPAQUE":
            return 1.0
        if mode not in ("MASK", "BLEND"):
            raise ValueError(f"alphaMode must be OPAQUE, MASK or BLEND, not {mode!r}")
        cutoff = number(material, "alphaCutoff", 0.0, default=0.5) if mode == "MASK" else None
        info, alpha = infos.get("baseColorTexture"), np.asarray(factor, np.float32)
        if info is not None:
            alpha = self.textures.pixels(info, label)[..., 3] * alpha
        elif colors is not None and colors.shape[1] == 4:
            alpha = colors[:, 3] * alpha
        if cutoff is not None:
            # In float32, since the alphas are rounded to it too.
            there = (alpha >= np.float32(cutoff)).astype(np.float32)
            if info is None and np.ndim(alpha) and there.min() != there.max():
                self.problems.note(
                    f"{label}: alphaMode MASK with alpha at vertices: holes fade between vertices, "
                    "instead of ending at the cutoff"
                )
            alpha = there
        if info is not None and cutoff is None and colors is not None and colors.shape[1] == 4:
            return Product(self.textures.bitmap(info, alpha, label), VertexColors(colors[:, 3]))
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
        """An emitter whose radiance is the product of emissive factor, strength, texture and opacity."""
        strength = number(material.get("extensions", {}).get(STRENGTH, {}), "emissiveStrength", 0.0, default=1.0)
        radiance = strength * numbers(material, "emissiveFactor", (0.0, 0.0, 0.0))
        if not radiance.any():
            return None
        info = infos.get("emissiveTexture")
        self._name_back(label, material)
        if isinstance(opacity, Texture) and info is None:
            return AreaEmitter(opacity.times(radiance))
        if isinstance(opacity, Texture):
            self.problems.note(f"{label}: its emissive texture shines where its alpha has holes, too")
        else:
            radiance = opacity * radiance
        if info is None:
            return AreaEmitter(radiance)
        return AreaEmitter(self.textures.bitmap(info, linear(self.textures.pixels(info, label), radiance), label))


def _reflectance(material: dict) -> float:
    """Reflectance at normal incidence of the part that is not metal."""
    index = index_of(material)
    return ((index - 1) / (index + 1)) ** 2


def is_unlit(material: dict) -> bool:
    """Whether a material shows its colour in any light."""
    return UNLIT in material.get("extensions", {})
