"""Models with the Mitsuba 3 plugins they should agree with: (ours, plugin, tolerance of eval, of pdf or None).

GGX and principled are the same formulas. Beckmann's masking is exact here, up to 0.4 % off in Mitsuba (twice in eval).
Plastic: Mitsuba's fit of the internal reflectance. Rough plastic: its quadrature of that integral counts the last of 64
angles fully, which is 2 % of what leaves for small alpha, and its even steps in the cosine are wide near grazing
angles. Rough glass chooses its lobe before the facet here, so its
density is another.
"""

import jaxdr as jd

COLOUR = (0.1, 0.5, 0.8)


def rgb(*value):
    return {"type": "rgb", "value": list(value)}


LOBES = (
    {"anisotropic": 0.8},
    {"spec_tint": 0.7},
    {"sheen": 0.8},
    {"sheen": 0.8, "sheen_tint": 0.6},
    {"clearcoat": 0.9},
    {"clearcoat": 0.9, "clearcoat_gloss": 0.3},
    {"flatness": 0.6},
    {"spec_trans": 0.7},
    {"spec_trans": 0.4, "anisotropic": 0.5, "spec_tint": 0.5, "sheen": 0.5, "clearcoat": 0.5, "flatness": 0.5},
)


def _peers():
    base = rgb(*COLOUR)
    yield "diffuse", jd.Diffuse(COLOUR), {"type": "diffuse", "reflectance": base}, 1e-4, 1e-4
    for name, beckmann in (("ggx", 0.0), ("beckmann", 0.008)):
        for alpha in (0.01, 0.2, 1.0):
            common = {"alpha": alpha, "distribution": name}
            metal = jd.RoughConductor(alpha, "Au", specular_reflectance=0.7, distribution=name)
            plugin = {"type": "roughconductor", "material": "Au", "specular_reflectance": rgb(0.7, 0.7, 0.7), **common}
            yield f"metal {name} {alpha}", metal, plugin, 1e-3 + beckmann, 1e-3 + beckmann
            glass = jd.RoughDielectric(alpha, "bk7", "water", distribution=name)
            plugin = {"type": "roughdielectric", "int_ior": "bk7", "ext_ior": "water", **common}
            yield f"glass {name} {alpha}", glass, plugin, 2e-3 + beckmann, None
            plastic = jd.RoughPlastic(COLOUR, alpha, 1.8, nonlinear=alpha == 0.2, distribution=name)
            plugin = {"type": "roughplastic", "diffuse_reflectance": base, "int_ior": 1.8, **common}
            plugin["nonlinear"] = alpha == 0.2
            tolerance = 0.1 if alpha == 0.01 else 0.03
            yield f"rough plastic {name} {alpha}", plastic, plugin, tolerance, tolerance
        common = {"alpha_u": 0.4, "alpha_v": 0.1, "distribution": name}
        metal = jd.RoughConductor(0.4, "Au", alpha_v=0.1, distribution=name)
        tolerance = 1e-3 + beckmann
        yield f"metal {name} two", metal, {"type": "roughconductor", "material": "Au", **common}, tolerance, tolerance
        glass = jd.RoughDielectric(0.4, "bk7", "water", alpha_v=0.1, distribution=name)
        plugin = {"type": "roughdielectric", "int_ior": "bk7", "ext_ior": "water", **common}
        yield f"glass {name} two", glass, plugin, 2e-3 + beckmann, None
    plugin = {"type": "plastic", "diffuse_reflectance": base, "nonlinear": True}
    yield "plastic", jd.Plastic(COLOUR, nonlinear=True), plugin, 2e-3, 1e-3
    for metallic, roughness, specular in ((0.0, 0.5, 0.5), (1.0, 0.2, 0.3), (0.6, 0.8, 1.0)):
        model = jd.Principled(COLOUR, metallic, roughness, specular)
        plugin = {"type": "principled", "base_color": base, "metallic": metallic, "roughness": roughness}
        yield f"principled {metallic}", model, {**plugin, "specular": specular}, 1e-3, 1e-3
    common = {"type": "principled", "base_color": base, "roughness": 0.4, "metallic": 0.3}
    for lobes in LOBES:
        densities = None if "spec_trans" in lobes else 2e-3
        yield (
            f"principled {', '.join(lobes)}",
            jd.Principled(COLOUR, 0.3, 0.4, **lobes),
            common | lobes,
            2e-3,
            densities,
        )
    inner = {"type": "diffuse", "reflectance": base}
    plugin = {"type": "blendbsdf", "weight": 0.3, "one": inner, "two": {"type": "roughconductor", "alpha": 0.2}}
    blend = jd.Blend(0.3, jd.Diffuse(COLOUR), jd.RoughConductor(0.2, distribution="beckmann"))
    yield "blend", blend, plugin, 9e-3, None
    plugin = {"type": "normalmap", "normalmap": rgb(0.7, 0.4, 0.9), "inner": inner}
    yield "normal map", jd.NormalMap((0.7, 0.4, 0.9), jd.Diffuse(COLOUR)), plugin, 1e-4, 1e-4
    yield "mask", jd.Mask(0.3, jd.Diffuse(COLOUR)), {"type": "mask", "opacity": 0.3, "inner": inner}, 1e-4, 1e-4


PEERS = {name: rest for name, *rest in _peers()}
DELTA_PEERS = {
    "conductor": (jd.Conductor("Al"), {"type": "conductor", "material": "Al"}),
    "mirror": (jd.Conductor(), {"type": "conductor"}),
    "dielectric": (jd.Dielectric("water"), {"type": "dielectric", "int_ior": "water"}),
    "thin dielectric": (jd.ThinDielectric(), {"type": "thindielectric"}),
    "plastic": (jd.Plastic(0.3), {"type": "plastic", "diffuse_reflectance": rgb(0.3, 0.3, 0.3)}),
}
