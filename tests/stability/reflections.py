"""What rough and smooth mirrors show: lamps (direct light), and objects that move and shadow themselves."""

import dataclasses

import numpy as np

import jaxdr as jd
from tests.stability.case import DIRECT_ONLY, Case, Expected
from tests.stability.shadows import BOTH, NOISY
from tests.stability.stage import camera as view
from tests.stability.stage import cube, lamp, table

ALONG = (1.0, 0.4, 0.2)
LOBE = Expected(
    "noisy",
    "a limit of all estimators here: in a narrow lobe the material form is noisy",
)
DOWN = ((0.0, -2.2, 1.3), (0.08, -0.75, 0.0), 36.0)  # into the mirror: what is above it is not seen itself


def mirror(alpha: float) -> jd.RoughConductor:
    """A metal of this GGX roughness that reflects everything."""
    return jd.RoughConductor(alpha)


def glossy_shadow(name, alpha, about, source, **options) -> Case:
    """A lamp seen in a rough floor, the cube before it: direct light."""
    light = lamp(1.2, (0.0, 1.8, 1.6), (0.0, 0.0, 0.3))
    scene = table(cube(0.5, (0.1, 0.75, 0.75)), light=light, ground_bsdf=mirror(alpha), view=view((0.0, -2.0, 1.3)))
    return Case(name, "reflections", about, source, scene, {"blocker.vertices": ALONG}, 0.02, **options)


def pair() -> jd.Mesh:
    """A small box above a large one, one mesh: it shadows itself."""
    low, high = cube((0.7, 0.7, 0.3), (0.0, 0.3, 0.65)), cube(0.3, (0.2, 0.15, 1.25))
    points = [np.asarray(mesh.vertices, float) for mesh in (low, high)]
    return jd.Mesh(np.vstack(points), np.vstack([np.asarray(low.faces), np.asarray(high.faces) + len(points[0])]))


def reflected(name, alpha, about, source, light=None, **options) -> Case:
    """Two boxes over a mirror, seen in it: camera, mirror, box, lamp."""
    light = lamp(0.6, (0.8, -0.6, 2.7), (0.0, 0.2, 0.8)) if light is None else light
    scene = table(pair(), light=light, ground_bsdf=mirror(alpha), view=view(*DOWN))
    return Case(
        name,
        "reflections",
        about,
        source,
        scene,
        {"blocker.vertices": ALONG},
        0.02,
        max_depth=3,
        reference_spp=512,
        expected={"RednerWAS": DIRECT_ONLY} | options.pop("expected", {}),
        **options,
    )


def uv_seams() -> Case:
    """A box, every side with the whole of a texture that does not join at the edges, over a rough mirror."""
    pixels = np.random.default_rng(0).uniform(0.1, 0.9, (4, 4, 3))
    scene = table(cube(0.5, (0.0, 0.2, 0.95)), ground_bsdf=mirror(0.1), view=view(*DOWN))
    painted = jd.TwoSided(jd.Diffuse(jd.Bitmap(pixels)))
    members = dict(scene.shapes) | {"blocker": jd.Shape(scene.shapes["blocker"].mesh, painted)}
    return Case(
        "uv_seams",
        "reflections",
        "a box whose texture jumps at every edge, seen in a rough mirror",
        "Mitsuba issue 1648: wrong gradients in a rough mirror for meshes with UV seams",
        jd.Scene(members, scene.camera),
        {"blocker.vertices": ALONG},
        0.02,
        max_depth=3,
        reference_spp=512,
        expected={"RednerWAS": DIRECT_ONLY},
    )


def cases() -> list[Case]:
    """Direct light in a glossy floor; then what a mirror shows. By default all of them take `ByKind`."""
    rough = "2026 paper, Fig. 13: reflections in rough surfaces"
    smooth = "narrow lobes: noise of the material form grows as one over the roughness (own finding)"
    made = [
        glossy_shadow(
            "glossy_rough",
            0.4,
            "a lamp and the objects in front of it, reflected in a floor of roughness 0.4",
            rough,
            expected=BOTH,
        ),
        glossy_shadow("glossy", 0.15, "the same, roughness 0.15", rough, expected=BOTH),
        glossy_shadow("glossy_smooth", 0.03, "the same, roughness 0.03", smooth, expected=BOTH),
        reflected("rough_reflection", 0.3, "two boxes in a mirror of roughness 0.3", rough, expected=NOISY),
        reflected("mirror_medium", 0.1, "the same, roughness 0.1", smooth),
        reflected(
            "mirror_low_roughness",
            0.01,
            "the same, roughness 0.01",
            smooth,
            expected=dict.fromkeys(("KernelDensity", "LineSampling", "GuidedEdges", "ByKind"), LOBE) | NOISY,
        ),
        reflected(
            "self_shadow_reflected",
            0.05,
            "lamp right above, so one box shadows the other; seen in a mirror of roughness 0.05",
            "Mitsuba issue 1648: gradients of a self-shadow seen in a rough mirror depend on the guide",
            lamp(0.4, (0.6, -0.1, 2.4), (0.1, 0.2, 0.9)),
            expected=NOISY,
        ),
        uv_seams(),
    ]
    return [dataclasses.replace(case, extra=("ByKind",)) for case in made]
