"""From a config to the things an optimisation works on: target, start, scene and views."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxdr.geometry.load import load_mesh
from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.shapes import centred, plane, rectangle, sphere, transformed
from jaxdr.integrators import BidirectionalPathTracer, PathTracer
from jaxdr.optimize.config import TARGET_SHAPES, Cameras, Light, OptimizeConfig, Target
from jaxdr.optimize.surroundings import material_of, placed
from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter, ConstantEnvironment
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Scene, Shape

OBJECT = "object"  # id of the shape that is optimised
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


class Problem(NamedTuple):
    """A scene with the initial mesh as shape `object`, the target mesh, and matrices of the views.

    - `views`: camera-to-world. If the object turns (`turned`) object-to-world, and the camera is the scene's.
    - `integrator`: None until a plan is made, where the config leaves it to one.
    """

    scene: Scene
    target: Mesh
    views: Float[np.ndarray, "N 4 4"]
    integrator: PathTracer | BidirectionalPathTracer | None
    turned: bool = False


def build_problem(config: OptimizeConfig) -> Problem:
    """Everything that a config describes. Raises ValueError when the target can't be built or loaded."""
    views = camera_poses(config.cameras)
    resolution = config.cameras.resolution
    turntable, place = config.turntable, views[0]
    if turntable is not None:
        place, views = placed(turntable.position, turntable.target), object_poses(views)
    camera = Perspective(place, config.cameras.fov, Film(resolution, resolution))
    start = config.initial
    initial = sphere(start.subdivisions, start.radius, vertex_count=start.vertices or None)
    initial = initial.smooth() if config.initial.shading == "smooth" else initial

    # Folds and passages through itself may show the inside on the way to the target: grey there too, not black.
    shapes = {OBJECT: Shape(initial, material_of(config.target.material, config.target.reflectance))}
    if config.floor is not None:
        ground = plane(size=config.floor.size, center=(0.0, 0.0, config.floor.height))
        shapes["floor"] = Shape(ground, TwoSided(Diffuse(config.floor.reflectance)))
    for number, other in enumerate(config.shapes):
        try:
            shapes[f"shape_{number}"] = other.build()
        except ValueError as problem:
            raise ValueError(f"shapes.{number}: {problem}") from None
    for number, light in enumerate(config.lights):
        shapes[f"light_{number}"] = _light(light)
    environment = ConstantEnvironment(config.environment) if np.any(config.environment) else None
    integrator = None if config.integrator.planned else config.integrator.build()
    scene = Scene(shapes, camera, environment)
    return Problem(scene, build_target(config.target), views, integrator, turntable is not None)


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


def object_poses(cameras: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "N 4 4"]:
    """Rotations of the object in place of cameras around it: what they see of it is then seen from -y, with z up."""
    front = np.asarray(look_at((0, -1, 0), (0, 0, 0), (0, 0, 1)))[:3, :3]
    poses = np.tile(np.eye(4), (len(cameras), 1, 1))
    poses[:, :3, :3] = front @ cameras[:, :3, :3].transpose(0, 2, 1)
    return poses


def _light(light: Light) -> Shape:
    mesh = transformed(rectangle(light.width, light.height), placed(light.position, light.target))
    return Shape(mesh, Diffuse(0.0), AreaEmitter(light.radiance))


def views_of_step(count: int, size: int, iteration: int, seed: int) -> list[int]:
    """Numbers of the `size` views of a step: a stream of shuffled rounds over all `count` views, cut into pieces."""
    chosen = []
    for place in range(iteration * size, (iteration + 1) * size):
        order = np.random.default_rng((seed, place // count)).permutation(count)
        chosen.append(int(order[place % count]))
    return chosen
