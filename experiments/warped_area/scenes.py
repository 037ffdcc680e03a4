"""Scenes after Fig. 12, 13 and 18 of Xu et al. 2023, from procedural shapes; z is up."""

import numpy as np

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.geometry.shapes import transformed

HEIGHT = 1.1  # of the middle of what hangs above the floor


def chess(piece: jd.Mesh, resolution: int) -> jd.Scene:
    """A piece above the floor under a small light; the camera looks at its shadow from below it."""
    lamp = transformed(shapes.rectangle(0.25, 0.25), jd.look_at((0.4, -0.3, 3.2), (0, 0, HEIGHT), (0, 1, 0)))
    return _scene(
        {"piece": jd.Shape(piece, jd.Diffuse(0.0)), "light": jd.Shape(lamp, jd.Diffuse(0.0), jd.AreaEmitter(120.0))},
        resolution,
    )


def cube_light(resolution: int) -> jd.Scene:
    """A figure on the floor beside a glowing cube, above the picture."""
    figure = shapes.centred(shapes.duck(3), 0.9)
    figure = jd.Mesh(figure.vertices + np.array([0.0, 0.0, 0.35]), figure.faces)
    turned = np.eye(4)
    turned[:3, :3] = jd.look_at((0, 0, 0), (1.0, 0.4, 0.7), (0, 0, 1))[:3, :3]
    turned[:3, 3] = (0.9, 0.3, 1.6)
    cube = transformed(shapes.box(0.5), turned)
    return _scene(
        {
            "figure": jd.Shape(figure, jd.Diffuse((0.6, 0.55, 0.5))),
            "light": jd.Shape(cube, jd.Diffuse(0.0), jd.AreaEmitter(8.0)),
        },
        resolution,
        eye=(0.0, -2.6, 1.5),
        fov=45.0,
    )


def _scene(parts: dict, resolution: int, eye=(0.0, -1.9, 0.75), fov=60.0) -> jd.Scene:
    floor = jd.Shape(shapes.plane(12.0), jd.Diffuse(0.6))
    pose = jd.look_at(eye, (0.0, 0.0, 0.1 if eye[2] > 1 else 0.0), (0, 0, 1))
    return jd.Scene({**parts, "floor": floor}, jd.Perspective(pose, fov, jd.Film(resolution, resolution)))


def chess_piece(segments: int = 20) -> jd.Mesh:
    """A pawn, its middle at the origin."""
    pawn = shapes.pawn(segments)
    return jd.Mesh(np.asarray(pawn.vertices) - np.array([0.0, 0.0, 0.5]), pawn.faces)


def poses(count: int, seed: int = 0) -> np.ndarray:
    """Rotations [count, 3, 3] that lay a piece on its side, spread evenly around the vertical with some tilt."""
    rng = np.random.default_rng(seed)
    turns = []
    for k in range(count):
        around, tilt = np.pi * k / count, np.pi / 2 + rng.uniform(-0.5, 0.5)
        turns.append(_about(2, around) @ _about(0, tilt) @ _about(2, rng.uniform(0, 2 * np.pi)))
    return np.stack(turns)


def _about(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
    return turn
