"""The scenes of a chart: procedural ones by name, scene files, and the motion of one of their shapes."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry import shapes
from jaxdr.geometry.shapes import plane, transformed
from jaxdr.moving import Moving
from jaxdr.optimize.compare import KEY as COMPARE
from jaxdr.optimize.config import optimize_config
from jaxdr.optimize.config_checks import check_choice, check_options
from jaxdr.optimize.problem import OBJECT, build_problem
from jaxdr.optimize.recovery import scenes as recovery_scenes
from jaxdr.optimize.recovery.config import is_recovery
from jaxdr.optimize.strict_toml import read_toml
from jaxdr.scene.bsdf import Diffuse, TwoSided
from jaxdr.scene.camera import Perspective, look_at
from jaxdr.scene.emitters import AreaEmitter
from jaxdr.scene.film import Film
from jaxdr.scene.formats.gltf.load import is_gltf, load_gltf
from jaxdr.scene.formats.mitsuba.load import load_mitsuba
from jaxdr.scene.motion import rounding_step
from jaxdr.scene.scene import Scene, Shape
from jaxdr.untrusted import array_of

NUDGES = 61  # more than the number of acceleration structures that are cached


def ball_and_shadow(*, resolution: int = 32, subdivisions: int = 3, light: float = 0.6) -> Scene:
    """A bumpy `ball` above a floor, with its soft shadow, under a square lamp of edge length `light`."""
    ball = shapes.displaced_sphere(subdivisions, radius=0.4, center=(0.0, 0.0, 0.1)).flat()
    lamp = transformed(shapes.rectangle(light, light), look_at((1.0, -0.6, 2.4), (0, 0, 0), (0, 0, 1)))
    return Scene(
        shapes={
            "ball": Shape(ball, TwoSided(Diffuse(0.5))),
            "floor": Shape(plane(6.0, center=(0.0, 0.0, -0.6)), TwoSided(Diffuse(0.5))),
            "lamp": Shape(lamp, Diffuse(0.0), AreaEmitter(6.0 / light**2)),
        },
        camera=Perspective(
            look_at((0.0, -2.6, 1.6), (-0.1, 0.0, -0.25), (0, 0, 1)), 36.0, Film(resolution, resolution)
        ),
    )


SCENES: dict[str, Callable[..., Scene]] = {"ball_and_shadow": ball_and_shadow, **recovery_scenes.SCENES}


class Case(NamedTuple):
    """A scene at rest, the parameter that moves (vertices of a shape), and its value at t.

    `nudge`: a step of t that moves coordinates by four units in the last place.
    """

    scene: Scene
    parameter: str
    shape: str
    rest: Float[Array, "V 3"]
    at: Callable[[Any], Float[Array, "V 3"]]
    moving: Moving
    nudge: float

    def moved(self, t) -> Scene:
        """The scene at t, which may be traced."""
        return self.scene.replace({self.parameter: self.at(t)})


def check_scene_options(name: str, options: dict) -> None:
    """Raises ValueError for an unknown procedural scene, or an option that its function does not have."""
    check_choice("procedural", name, SCENES)
    check_options("options", SCENES[name], options, name)


def load_case(name: str, file: str, procedural: str, options: dict, motion) -> Case:
    """A scene and its `motion` (`jaxdr.chart.config.Motion`). Raises ValueError, which starts with the scene's name."""
    try:
        if file.endswith(".toml"):
            scene = view_of_config(file, **options)
        elif file:
            reader = load_gltf if is_gltf(Path(file)) else load_mitsuba
            scene = reader(file, **options)
        else:
            scene = SCENES[procedural](**options)
        return _case(scene, motion)
    except (TypeError, ValueError) as problem:
        raise ValueError(f"scene {name}: {problem}") from None


def view_of_config(file: str, *, view: int = 0, resolution: int = 0, initial: bool = False) -> Scene:
    """View number `view` of a config of `jaxdr optimize`: of its target, or with `initial` of what it starts from.

    The shape is `object`. `resolution`: width and height in pixels; 0 for the config's. `[[compare]]` is left out.
    Raises ValueError for configs that can't be read, and for a view that they don't have.
    """
    path = Path(file)
    table = read_toml(path)
    if is_recovery(table):
        raise ValueError(f"{path}: expected a config that makes a mesh from a sphere, not one with [scene]")
    config = optimize_config({key: value for key, value in table.items() if key != COMPARE}, path)
    if not 0 <= view < config.cameras.views:
        raise ValueError(f"options.view: {path} has {config.cameras.views} views, got {view}")
    problem = build_problem(config)
    scene, pose = problem.scene, jnp.asarray(problem.views[view])
    old, mesh = scene.shapes[OBJECT], problem.target
    mesh = scene.shapes[OBJECT].mesh if initial else mesh
    mesh = mesh.with_vertices(mesh.vertices @ pose[:3, :3].T.astype(mesh.vertices.dtype)) if problem.turned else mesh
    size = resolution or config.cameras.resolution
    camera = dataclasses.replace(scene.camera, film=Film(size, size))
    viewed = Scene({**scene.shapes, OBJECT: Shape(mesh, old.bsdf)}, camera, scene.environment)
    return viewed if problem.turned else viewed.replace({"camera.to_world": pose})


def nudged(case: Case, t: float, number: int) -> float:
    """t plus a tiny step, which differs between `NUDGES` calls in a row and changes coordinates by rounding only.

    Acceleration structures are cached by their content. Calls at exactly the same t would not build them.
    """
    return t + (number % NUDGES - NUDGES // 2) * case.nudge


def _case(scene: Scene, motion) -> Case:
    movable = [name for name in scene.shapes if f"{name}.vertices" in scene.parameters()]
    if motion.shape not in movable:
        raise ValueError(f"motion.shape: expected one of {', '.join(movable)}, got {motion.shape!r}")
    parameter = f"{motion.shape}.vertices"
    rest = jnp.asarray(scene.parameters()[parameter])
    moving = Moving(tuple(name == motion.shape for name in scene.shapes), False, (False,) * len(scene.lights), False)
    if motion.kind == "rotate":
        at, speed = _turned(rest, motion)
    else:
        velocities = _velocities(rest, motion)
        at, speed = (lambda t: rest + t * velocities), float(jnp.linalg.norm(velocities, axis=1).max())
    return Case(scene, parameter, motion.shape, rest, at, moving, rounding_step(rest, speed))


def _turned(rest, motion):
    axis = np.asarray(motion.axis, float) / np.linalg.norm(motion.axis)
    middle = (rest.min(0) + rest.max(0)) / 2
    pivot = middle if motion.pivot is None else jnp.asarray(motion.pivot, rest.dtype)
    axis = jnp.asarray(axis, rest.dtype)
    arm = rest - pivot
    along = (arm @ axis)[:, None] * axis
    across = jnp.cross(axis, arm)

    def at(t):
        # Rodrigues' formula
        return pivot + along + jnp.cos(t) * (arm - along) + jnp.sin(t) * across

    return at, float(jnp.linalg.norm(across, axis=1).max())


def _velocities(rest, motion) -> Float[Array, "V 3"]:
    if motion.kind == "translate":
        return jnp.broadcast_to(jnp.asarray(motion.direction, rest.dtype), rest.shape)
    if motion.vertex is not None:
        if not 0 <= motion.vertex < len(rest):
            raise ValueError(f"motion.vertex: {motion.shape} has {len(rest)} vertices, got {motion.vertex}")
        return jnp.zeros_like(rest).at[motion.vertex].set(jnp.asarray(motion.direction, rest.dtype))
    field = array_of(Path(motion.velocities), f"motion.velocities: {motion.velocities}")
    if field.dtype.kind not in "iuf":
        raise ValueError(f"motion.velocities: {motion.velocities}: expected numbers, got {field.dtype}")
    if field.shape != rest.shape or not np.isfinite(field).all() or not field.any():
        raise ValueError(
            f"motion.velocities: expected finite numbers, not all zero, of shape {list(rest.shape)}; "
            f"got {list(field.shape)}"
        )
    return jnp.asarray(field, rest.dtype)


def describe(motion) -> str:
    """A description of the motion, in one line for the page."""
    values = {k: v for k, v in dataclasses.asdict(motion).items() if v not in (None, "") and k not in ("shape", "kind")}
    shown = {
        "translate": ("direction",),
        "rotate": ("axis", "pivot"),
        "vertices": ("vertex", "velocities", "direction"),
    }
    options = ", ".join(f"{k} {v}" for k, v in values.items() if k in shown[motion.kind])
    return f"{motion.shape}: {motion.kind} ({options})"
