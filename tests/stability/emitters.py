"""What shines, or receives, moves: lamps of all kinds, the floor, environments and their pixels."""

import math

import numpy as np

import jaxdr as jd
from jaxdr.geometry import shapes
from tests.stability.case import Case, Expected
from tests.stability.shadows import BOTH, HIGH, NOISY, SHADE, SHORT, SPHERE
from tests.stability.stage import camera, cube, floor, grey, lamp, rotation, table

SKY = (8, 16)  # pixels of the environment map
EVERYWHERE = Expected(
    "noisy",
    "likely a limit of the method: the whole sky lights every point, and under a nearly uniform sky the terms cancel "
    "while their noise remains",
)

TOUCHES = Expected(
    "noisy",
    "the interior term is noisy, not the boundary term (KernelDensity, LineSampling and GuidedEdges have the same "
    "numbers). Likely cause: BSDF-sampled points of the lamp that are very close to the lit point. "
    'PathTracer(sampling="emitter") has less noise. WalkOnCaps and RednerWAS use it here: WalkOnCaps is off in the '
    "pixels where lamp and floor touch, and RednerWAS has individual huge values (0.893 ± 0.118)",
)
CUT = Expected(
    "biased",
    "a limit of the method: strips of the kernel are clipped to lamps of up to 16 faces, and to faces larger than the "
    "kernel; on smaller faces they extend beyond the lamp's border. `jd.EstimatorWarning` says so",
)


def glowing(light: jd.Mesh, blocker: jd.Mesh, radiance: float, view=None) -> jd.Scene:
    """The table with a lamp of twelve triangles."""
    scene = table(blocker, view=view)
    shining = jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(radiance))
    return jd.Scene({**scene.shapes, "lamp": shining}, scene.camera)


def moved(name, about, source, scene, light=0.0, ground=0.0, **options) -> Case:
    """Lamp and floor by their velocities; where one is zero, it stays in value and is differentiated all the same."""
    moves = {"lamp.vertices": np.asarray(light), "floor.vertices": np.asarray(ground)}
    return Case(name, "emitters", about, source, scene, moves, 0.03, **options)


def solid_lights() -> list[Case]:
    """Glowing boxes, flat ones and cubes: one structure."""
    ground = np.asarray(floor().vertices, float)
    rising = np.zeros_like(ground)
    rising[:, 2] = 0.5 + 0.15 * ground[:, 0] - 0.1 * ground[:, 1]
    above = cube((0.6, 0.6, 0.02), (0.9, -0.5, 2.4), rotation((0.5, 0.8, 0.0), 0.3))
    upright = cube((0.05, 1.0, 1.0), (1.0, 0.3, 0.5), np.eye(3))
    outlines = "it does not treat outlines between two faces as boundaries, so v does not reach their velocity"
    return [
        moved(
            "cube_light",
            "a glowing cube moves; normals jump at all of its outlines",
            "2023 paper, Fig. 18: the public implementation of Bangaru et al. 2020 is biased there",
            glowing(
                cube(0.6, (0.4, 0.1, 1.2)), cube(0.3, (-0.4, -0.4, 0.2)), 4.0, camera(target=(0.1, -0.6, 0.0), fov=36.0)
            ),
            (1.0, 0.4, 0.2),
            expected={
                "RednerWAS, no normal edges": Expected("biased", outlines),
                "RednerWAS, exponential": Expected(
                    "biased", "Eq. 57 has no small scale, so v does not reach the velocity of outlines either"
                ),
            },
            extra=("RednerWAS, no normal edges", "RednerWAS, exponential"),
        ),
        moved(
            "moving_emitter",
            "a flat glowing box moves over a cube",
            "emitters' outlines in spherical form (Bangaru et al. 2020)",
            glowing(above, cube(), 20.0),
            (1.0, 0.4, 0.2),
            expected=BOTH,
        ),
        moved(
            "moving_emitter_at_wall",
            "a glowing slab slides over the floor that it stands on",
            "1 / r² of emitters that touch the surface they light (own list)",
            glowing(upright, cube(0.4, (0.0, 0.1, 0.25)), 4.0),
            (1.0, 0.3, 0.0),
            expected=dict.fromkeys(("KernelDensity", "LineSampling", "GuidedEdges", "RednerWAS"), TOUCHES) | NOISY,
        ),
        moved(
            "moving_receiver",
            "the floor rises and tilts under a shadow; blocker and lamp stay",
            "V is a difference of two velocities, so edges at rest have a boundary term too (own finding)",
            glowing(above, cube(), 20.0),
            ground=rising,
            expected=BOTH,
        ),
    ]


def round_lamp() -> Case:
    """A ball of small faces above a cube."""
    return Case(
        "round_lamp",
        "emitters",
        "a glowing ball of 320 faces, the shadow of a cube under it",
        "emitter faces smaller than a kernel (own list)",
        glowing(shapes.sphere(2, radius=0.35, center=(0.9, -0.5, 2.2)), cube(at=HIGH), 8.0, camera(*SHADE, 45.0)),
        {"blocker.vertices": (1.0, 0.4, 0.2)},
        0.02,
        expected=NOISY,
    )


MISSING = Expected("biased", "0.72 ± 0.04, with noise of three times the image. We did not look for the cause")


def lamp_of_many_faces() -> Case:
    """`tiny_light` once more, in 32 triangles."""
    return Case(
        "lamp_of_many_faces",
        "emitters",
        "the lamp of `tiny_light`, made of 32 triangles",
        "strips are not clipped to emitter faces smaller than a kernel (own finding)",
        table(cube(at=HIGH), light=lamp(0.016, resolution=4), view=camera(*SHADE, 45.0)),
        {"blocker.vertices": (1.0, 0.4, 0.2)},
        0.02,
        reference_spp=512,
        expected={"KernelDensity": CUT, "WarpedArea": MISSING, "RednerWAS": SHORT},
    )


def textured_emitter() -> Case:
    """The lamp is a picture, and moves."""
    pixels = np.random.default_rng(3).uniform(0.0, 12.0, (4, 4, 3))
    scene = table(cube(), light=lamp(1.2))
    shining = jd.Shape(scene.shapes["lamp"].mesh, jd.Diffuse(0.0), jd.AreaEmitter(jd.Bitmap(pixels, wrap="clamp")))
    return Case(
        "textured_emitter",
        "emitters",
        "a lamp with a picture on it moves over a cube",
        "radiance that moves with the emitter (own list)",
        jd.Scene({**scene.shapes, "lamp": shining}, scene.camera),
        {"lamp.vertices": (1.0, 0.4, 0.2)},
        0.03,
        expected={"RednerWAS": Expected("refuses", "emitters with textures are not covered")},
    )


def sky(bright=(), smooth=True) -> np.ndarray:
    """An environment map: a smooth gradient, or almost dark, with `bright` pixels (row, column, radiance)."""
    height, width = SKY
    row, column = np.mgrid[0:height, 0:width]
    grey = 0.6 + 0.3 * np.cos(2 * math.pi * column / width) + 0.2 * np.sin(math.pi * row / height)
    pixels = grey if smooth else np.full(SKY, 0.1)
    for i, j, value in bright:
        pixels[i, j] = value
    return np.repeat(pixels[..., None], 3, axis=2)


Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def outdoors(pixels: np.ndarray) -> jd.Scene:
    """A cube on the floor under a sky."""
    return jd.Scene(
        {"blocker": jd.Shape(cube(0.6, (0.0, 0.0, 0.6)), grey()), "floor": jd.Shape(floor(), grey())},
        camera(),
        jd.EnvironmentMap(pixels, Z_UP),
    )


def skies() -> list[Case]:
    """The cube moves under the sky, the sky turns, its pixels change."""
    turning = np.zeros((4, 4))
    turning[:3, :3] = (rotation((0, 0, 1), math.pi / 2) - np.diag([0.0, 0.0, 1.0])) @ Z_UP[:3, :3]
    pixel, pole = np.zeros((*SKY, 3)), np.zeros((*SKY, 3))
    pixel[2, 5], pole[0] = 1.0, 1.0
    sun = [(2, 3, 60.0)]
    slides = {"blocker.vertices": (1.0, 0.4, 0.2)}
    turned = "a rotating environment has a boundary term at silhouettes in front of it (own finding)"
    found = [
        ("bright_sun", "one pixel of the sky is the sun, and half of the edges see it",
         "guides and kernels that consider edges only (own list)", sun, slides, 0.02, True),
        ("smooth_sky", "a sky without a sun", "control", (), slides, 0.02, True),
        ("pole_of_sky", "the brightest pixels are at the pole", "sin θ = 0 at the poles of a map (own list)",
         [(0, j, 20.0) for j in range(SKY[1])], slides, 0.02, True),
        ("turning_sky", "the sky turns about the vertical", turned, (), {"environment.to_world": turning}, 0.02, True),
        ("turning_sun", "the sky turns, and the sun with it", turned, sun, {"environment.to_world": turning}, 0.02,
         True),
        ("sky_pixel", "a pixel of the sky brightens: no boundary moves", "gradients of single pixels of a map",
         sun, {"environment.radiance": pixel}, 0.1, False),
        ("sky_pole", "the row of pixels at the pole brightens", "sin θ = 0 at the poles of a map (own list)",
         (), {"environment.radiance": pole}, 0.1, False),
    ]  # fmt: skip
    wrong = {
        "smooth_sky": NOISY,
        "pole_of_sky": NOISY,
        "turning_sky": {"KernelDensity": EVERYWHERE} | NOISY,
        "turning_sun": NOISY,
        "sky_pixel": {"RednerWAS": SPHERE},
    }
    return [
        Case(
            name,
            "skies",
            about,
            source,
            outdoors(sky(bright, not bright)),
            moves,
            step,
            boundary=boundary,
            expected=wrong.get(name, {}),
        )
        for name, about, source, bright, moves, step, boundary in found
    ]


def cases() -> list[Case]:
    """Lamps and the floor."""
    return [*solid_lights(), textured_emitter(), round_lamp(), lamp_of_many_faces()]
