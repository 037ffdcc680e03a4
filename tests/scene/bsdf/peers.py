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
    plugin = {"type": "plastic", "diffuse_reflectance": base, "nonlinear": True}
    yield "plastic", jd.Plastic(COLOUR, nonlinear=True), plugin, 2e-3, 1e-3
    for metallic, roughness, specular in ((0.0, 0.5, 0.5), (1.0, 0.2, 0.3), (0.6, 0.8, 1.0)):
        model = jd.Principled(COLOUR, metallic, roughness, specular)
        plugin = {"type": "principled", "base_color": base, "metallic": metallic, "roughness": roughness}
        yield f"principled {metallic}", model, {**plugin, "specular": specular}, 1e-3, 1e-3
    inner = {"type": "diffuse", "reflectance": base}
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
