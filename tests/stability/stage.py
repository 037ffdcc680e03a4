"""Scenes of a few triangles, whose numbers differ and whose structure does not: one compiled program serves many."""

import numpy as np

import jaxdr as jd
from jaxdr.geometry import shapes
from jaxdr.geometry.shapes import transformed

GREY = 0.5
FILM = 16
EYE, TARGET = (0.0, -2.6, 1.7), (0.1, 0.0, 0.25)


def rotation(axis, angle: float) -> np.ndarray:
    """About an axis through the origin, right-handed [3, 3]."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def placed(mesh: jd.Mesh, turn=None, at=(0.0, 0.0, 0.0), scale=1.0) -> jd.Mesh:
    """Scaled (by a number or three), turned, moved."""
    turn = np.eye(3) if turn is None else turn
    points = (np.asarray(mesh.vertices, float) * scale) @ np.asarray(turn).T + np.asarray(at)
    return mesh.with_vertices(points)


TURN = rotation((0.3, 0.5, 0.8), 0.7)


def standing(x: float = 1.0, low: float = -0.2, high: float = 0.8) -> np.ndarray:
    """Corners of a `lamp` that stands on the floor at `x` and shines towards -x, as `shapes.rectangle` has them."""
    return np.array([[x, high, 0.0], [x, low, 0.0], [x, high, high - low], [x, low, high - low]])


def cube(size=0.5, at=(0.0, 0.0, 0.7), turn=TURN) -> jd.Mesh:
    """A turned box; `size` may be three numbers."""
    return placed(shapes.box(), turn, at, size)


def floor(size: float = 6.0) -> jd.Mesh:
    """A square in the plane z = 0, facing up."""
    return shapes.plane(size)


def lamp(size: float = 0.6, at=(0.9, -0.5, 2.4), towards=(0.0, 0.0, 0.3), resolution: int = 1) -> jd.Mesh:
    """A square that shines from `at` towards a point, `resolution` squares of two triangles along its sides."""
    return transformed(shapes.plane(size, resolution), jd.look_at(at, towards, (0.3, 0.8, 0.1)))


def camera(eye=EYE, target=TARGET, fov: float = 42.0, film: int = FILM) -> jd.Perspective:
    """With clipping planes for scenes of any size."""
    return jd.Perspective(jd.look_at(eye, target, (0, 0, 1)), fov, jd.Film(film, film), near_clip=1e-5, far_clip=1e5)


def grey(reflectance=GREY) -> jd.TwoSided:
    """Diffuse on both sides."""
    return jd.TwoSided(jd.Diffuse(reflectance))


def table(
    blocker: jd.Mesh, ground=None, light=None, power: float = 6.0, view=None, ground_bsdf=None, shade=GREY
) -> jd.Scene:
    """A `blocker` over the `floor` under the `lamp`, all diffuse; the lamp sends `power`, whatever its size.

    `shade`: reflectance of the blocker.
    """
    ground = floor() if ground is None else ground
    light = lamp() if light is None else light
    corners = np.asarray(light.vertices, float)[np.asarray(light.faces)]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    return jd.Scene(
        shapes={
            "blocker": jd.Shape(blocker, grey(shade)),
            "floor": jd.Shape(ground, grey() if ground_bsdf is None else ground_bsdf),
            "lamp": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(power / area)),
        },
        camera=camera() if view is None else view,
    )


def resized(scene: jd.Scene, scale: float = 1.0, offset=(0.0, 0.0, 0.0)) -> jd.Scene:
    """The same picture in other units, and elsewhere: vertices and camera are scaled, then moved."""
    parameters, offset = scene.parameters(), np.asarray(offset, float)
    changed = {
        name: scale * np.asarray(value, float) + offset
        for name, value in parameters.items()
        if name.endswith(".vertices")
    }
    pose = np.array(parameters["camera.to_world"], float)
    pose[:3, 3] = scale * pose[:3, 3] + offset
    return scene.replace(changed | {"camera.to_world": pose})
