"""What shines, or receives, moves: lamps of all kinds, the floor, environments and their pixels."""

import math

import numpy as np

import jaxdr as jd
from tests.stability.case import Case, Expected
from tests.stability.stage import camera, cube, floor, grey, lamp, rotation, table

SKY = (8, 16)  # pixels of the environment map


def moving_emitter() -> list[Case]:
    """The lamp moves, the cube stays."""
    wall = np.array([[1.0, -0.2, 0.0], [1.0, 0.8, 0.0], [1.0, -0.2, 1.0], [1.0, 0.8, 1.0]])
    standing = lamp(1.0, (1.0, 0.3, 0.5), (0.0, 0.3, 0.5)).with_vertices(wall)
    return [
        Case(
            "moving_emitter",
            "emitters",
            "the lamp moves over a cube",
            "emitters' outlines in spherical form (Bangaru et al. 2020); control for the others",
            table(cube()),
            {"lamp.vertices": (1.0, 0.4, 0.2)},
            0.03,
        ),
        Case(
            "moving_emitter_at_wall",
            "emitters",
            "a lamp that stands on the floor slides along it",
            "1/r² of emitters that touch what they light (Mitsuba issues about NaN and fireflies)",
            table(cube(0.4, (0.0, 0.1, 0.25)), light=standing),
            {"lamp.vertices": (1.0, 0.3, 0.0)},
            0.02,
        ),
    ]


def moving_receiver() -> Case:
    """The floor tilts and rises, the cube and the lamp stay."""
    ground = np.asarray(floor().vertices, float)
    velocity = np.zeros_like(ground)
    velocity[:, 2] = 0.5 + 0.15 * ground[:, 0] - 0.1 * ground[:, 1]
    return Case(
        "moving_receiver",
        "emitters",
        "the floor rises and tilts under a shadow; blocker and lamp stay",
        "V has two velocities: edges that do not move have a boundary term as well (own finding)",
        table(cube()),
        {"floor.vertices": velocity},
        0.02,
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
        "radiance that moves with the emitter is left out where emitters are sampled by direction (Mitsuba issues)",
        jd.Scene({**scene.shapes, "lamp": shining}, scene.camera),
        {"lamp.vertices": (1.0, 0.4, 0.2)},
        0.03,
        expected={"RednerWAS": Expected("refuses", "emitters with textures are not covered")},
    )


def cube_light() -> Case:
    """A glowing cube moves over the floor."""
    scene = table(cube(0.3, (-0.6, 0.2, 0.2)))
    shining = jd.Shape(cube(0.6, (0.4, 0.1, 1.2)), jd.Diffuse(0.0), jd.AreaEmitter(4.0))
    return Case(
        "cube_light",
        "emitters",
        "a glowing cube moves: all of its outlines are edges where normals jump",
        "2023 paper, Fig. 18: the public implementation of Bangaru et al. 2020 is biased there",
        jd.Scene({**scene.shapes, "lamp": shining}, scene.camera),
        {"lamp.vertices": (1.0, 0.4, 0.2)},
        0.03,
        expected={
            "RednerWAS, no normal edges": Expected("biased", "outlines between two faces are no boundary to it"),
            "RednerWAS, exponential": Expected("biased", "Eq. 57 has no small scale: v does not reach the boundary's"),
        },
        extra=("RednerWAS, no normal edges", "RednerWAS, exponential"),
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
    moved = {"blocker.vertices": (1.0, 0.4, 0.2)}
    turned = "the environment's rotation is a boundary term of silhouettes before it (own finding)"
    found = [
        ("bright_sun", "one pixel of the sky is the sun, which half of the edges see",
         "guides and kernels that look at edges alone (2026 paper, limits)", sun, moved, 0.02, True),
        ("smooth_sky", "a sky without a sun", "control", (), moved, 0.02, True),
        ("pole_of_sky", "the brightest pixels are at the pole", "sin θ = 0 at the poles of a map (Mitsuba issues)",
         [(0, j, 20.0) for j in range(SKY[1])], moved, 0.02, True),
        ("turning_sky", "the sky turns about the vertical", turned, (), {"environment.to_world": turning}, 0.02, True),
        ("turning_sun", "the sky turns, and the sun with it", turned, sun, {"environment.to_world": turning}, 0.02,
         True),
        ("sky_pixel", "a pixel of the sky brightens: no boundary moves", "gradients of single pixels of a map",
         sun, {"environment.radiance": pixel}, 0.1, False),
        ("sky_pole", "the row of pixels at the pole brightens", "sin θ = 0 at the poles of a map (Mitsuba issues)",
         (), {"environment.radiance": pole}, 0.1, False),
    ]  # fmt: skip
    return [
        Case(name, "skies", about, source, outdoors(sky(bright, not bright)), moves, step, boundary=boundary)
        for name, about, source, bright, moves, step, boundary in found
    ]


def cases() -> list[Case]:
    """Lamps and the floor."""
    return [*moving_emitter(), moving_receiver(), textured_emitter(), cube_light()]
