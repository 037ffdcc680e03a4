"""From a config to the things an optimisation works on: target, start, scene and views."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import centred, plane, rectangle, sphere, transformed
from jaxdr.integrators import PathTracer
from jaxdr.optimize.config import TARGET_SHAPES, Cameras, Light, OptimizeConfig, Target
from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Scene, Shape

OBJECT = "object"  # id of the shape that is optimised
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


class Problem(NamedTuple):
    """A scene with the initial mesh as shape `object`, the target mesh, and camera-to-world matrices of the views.

    `integrator` is None until a plan is made, where the config leaves it to one.
    """

    scene: Scene
    target: Mesh
    views: Float[np.ndarray, "N 4 4"]
    integrator: PathTracer | None


def build_problem(config: OptimizeConfig) -> Problem:
    """Everything that a config describes. Raises ValueError when the target can't be built or loaded."""
    views = camera_poses(config.cameras)
    resolution = config.cameras.resolution
    camera = Perspective(views[0], config.cameras.fov, Film(resolution, resolution))
    start = config.initial
    initial = sphere(start.subdivisions, start.radius, vertex_count=start.vertices or None)
    initial = initial.smooth() if config.initial.shading == "smooth" else initial

    # Folds and passages through itself may show the inside on the way to the target: grey there too, not black.
    shapes = {OBJECT: Shape(initial, TwoSided(Diffuse(config.target.reflectance)))}
    if config.floor is not None:
        ground = plane(size=config.floor.size, center=(0.0, 0.0, config.floor.height))
        shapes["floor"] = Shape(ground, TwoSided(Diffuse(config.floor.reflectance)))
    for number, light in enumerate(config.lights):
        shapes[f"light_{number}"] = _light(light)
    environment = ConstantEnvironment(config.environment) if np.any(config.environment) else None
    integrator = None if config.integrator.planned else config.integrator.build()
    return Problem(Scene(shapes, camera, environment), build_target(config.target), views, integrator)


def build_target(target: Target) -> Mesh:
    """The target mesh, centred at the origin, scaled to its size, with z up."""
    if target.path:
        mesh = load_mesh(target.path)
    else:
        try:
            mesh = TARGET_SHAPES[target.shape](**target.parameters)
        except (TypeError, ValueError) as problem:
            raise ValueError(f"target.parameters: {problem}") from None
    # Rotations by a third of a turn or not at all: they keep the orientation of the faces.
    order = {"z": (0, 1, 2), "y": (2, 0, 1), "x": (1, 2, 0)}[target.up]
    mesh = centred(transformed(mesh, np.eye(4)[[*order, 3]]), target.size)
    return mesh.smooth() if target.shading == "smooth" else mesh.flat()


def camera_poses(cameras: Cameras) -> Float[np.ndarray, "N 4 4"]:
    """Camera-to-world matrices on a Fibonacci spiral: golden angles, equal steps in the sine of the elevation."""
    low, high = np.sin(np.deg2rad(cameras.elevation))
    poses = []
    for i in range(cameras.views):
        z = low + (high - low) * (i + 0.5) / cameras.views
        azimuth = i * GOLDEN_ANGLE
        radius = math.sqrt(1 - z * z)
        direction = np.array([radius * math.cos(azimuth), radius * math.sin(azimuth), z])
        poses.append(look_at(cameras.distance * direction, (0, 0, 0), (0, 0, 1)))
    return np.stack(poses)


def _light(light: Light) -> Shape:
    direction = np.subtract(light.target, light.position)
    straight = np.allclose(np.cross(direction, (0, 0, 1)), 0)
    placed = look_at(light.position, light.target, (0, 1, 0) if straight else (0, 0, 1))
    mesh = transformed(rectangle(light.width, light.height), placed)
    return Shape(mesh, Diffuse(0.0), AreaEmitter(light.radiance))


def views_of_step(count: int, size: int, iteration: int, seed: int) -> list[int]:
    """Numbers of the `size` views of a step: a stream of shuffled rounds over all `count` views, cut into pieces."""
    chosen = []
    for place in range(iteration * size, (iteration + 1) * size):
        order = np.random.default_rng((seed, place // count)).permutation(count)
        chosen.append(int(order[place % count]))
    return chosen
