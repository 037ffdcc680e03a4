"""From a config to what a recovery works on: the scene at its start, its parametrised values, targets and views."""

import difflib
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.images import load_image
from jaxdr.integrators import BidirectionalPathTracer, PathTracer
from jaxdr.optimize.problem import camera_poses
from jaxdr.optimize.recovery.config import Parameter, RecoveryConfig
from jaxdr.optimize.recovery.parameters import Bounded, Motion, Parametrization, Plain, Smoothed
from jaxdr.optimize.recovery.scenes import load_scene
from jaxdr.render import render
from jaxdr.scene.camera import Perspective
from jaxdr.scene.film import Film
from jaxdr.scene.scene import Scene, every_parameter

Latents = dict[str, Array]


class Problem(NamedTuple):
    """What is optimised, and towards what.

    - `scene`: with all values that are not optimised; `parameters`: parametrisation by name.
    - `target`: the scene that is rendered as target, or None; then `images` [N, H, W, 3] are given.
    - `views`: camera-to-world matrices; `fixed_views`: whether the camera itself is not optimised.
    - `integrator`: None until a plan is made, where the config leaves it to one.
    """

    scene: Scene
    parameters: dict[str, Parametrization]
    target: Scene | None
    images: Float[np.ndarray, "N H W 3"] | None
    views: Float[np.ndarray, "N 4 4"]
    fixed_views: bool
    integrator: PathTracer | BidirectionalPathTracer | None

    def start(self) -> Latents:
        """Latent numbers at the start."""
        return {name: parameter.start() for name, parameter in self.parameters.items()}

    def values(self, latents: Latents) -> dict[str, Array]:
        """Values of the parameters, differentiably."""
        return {name: parameter.value(latents[name]) for name, parameter in self.parameters.items()}

    def image(
        self, scene: Scene, latents: Latents, to_world: Float[Array, "4 4"], key: PRNGKeyArray, spp: int
    ) -> Float[Array, "H W 3"]:
        """The view from a camera, unless that is optimised.

        Under jit `scene` (the problem's own) is an argument: a program with meshes as constants takes long to compile.
        """
        pose = {"camera.to_world": to_world} if self.fixed_views else {}
        moved = scene.replace({**pose, **self.values(latents)})
        return render(moved, key, spp=spp, integrator=self.integrator)

    def target_image(
        self, scene: Scene, to_world: Float[Array, "4 4"], key: PRNGKeyArray, spp: int
    ) -> Float[Array, "H W 3"]:
        """The view of the target, which is given as `scene` likewise."""
        return render(scene.replace({"camera.to_world": to_world}), key, spp=spp, integrator=self.integrator)


def build_problem(config: RecoveryConfig) -> Problem:
    """Everything that a config describes. Raises ValueError that starts with the key of what can't be built or read."""
    source, aim = config.scene, config.target
    scene = _viewed(_placed("scene", load_scene, source.name, source.file, source.options), config)
    values = every_parameter(scene)
    parameters = {}
    for i, options in enumerate(config.parameters):
        place = f"parameters[{i}]"
        if options.name not in values:
            close = difflib.get_close_matches(options.name, values, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ValueError(f"{place}.name: unknown parameter {options.name!r}{hint} (known: {', '.join(values)})")
        parameters[options.name] = _placed(place, parametrization, scene, options)
    target, images = None, None
    if aim.images:
        images = np.stack([_read(i, file, scene) for i, file in enumerate(aim.images)])
    else:
        own = not (aim.name or aim.file)
        name, file = (source.name, source.file) if own else (aim.name, aim.file)
        target = load = _placed("target", load_scene, name, file, {**(source.options if own else {}), **aim.options})
        target = _viewed(load, config)
        shapes = [s.camera.film.window[2:] for s in (scene, target)]
        if shapes[0] != shapes[1]:
            raise ValueError(f"target: its images have {shapes[1]} pixels, those of the scene {shapes[0]}")
    if config.cameras is not None:
        views = camera_poses(config.cameras)
    else:
        views = np.asarray((scene if target is None else target).camera.to_world)[None]
    fixed = not any(name == "camera.to_world" for name in parameters)
    integrator = None if config.integrator.planned else config.integrator.build()
    return Problem(scene, parameters, target, images, views, fixed, integrator)


def parametrization(scene: Scene, options: Parameter) -> Parametrization:
    """How a parameter depends on latent numbers. Raises ValueError for an initial value that doesn't fit."""
    value = every_parameter(scene)[options.name]
    if options.moving:
        count = Motion.COUNTS[options.moving]
        offset = np.zeros(count)
        if options.initial is not None:
            offset = np.array(options.initial, float).reshape(count)
            if options.moving != "translation":
                offset[:3] = np.deg2rad(offset[:3])
        return Motion(value, jnp.asarray(offset, value.dtype), options.axis, options.moving)
    if options.is_vertices:
        mesh = scene.shapes[options.name.removesuffix(".vertices")].mesh
        return Smoothed(mesh, 19.0 if options.smoothing is None else options.smoothing)
    if options.initial is not None:
        try:
            value = jnp.broadcast_to(jnp.asarray(options.initial, value.dtype), value.shape)
        except ValueError:
            raise ValueError(
                f"initial: expected one number or a list that fits the shape {list(value.shape)} of {options.name}, "
                f"got {options.initial!r}"
            ) from None
    return Plain(value) if options.bounds is None else Bounded(value, options.bounds)


def _viewed(scene: Scene, config: RecoveryConfig) -> Scene:
    """The scene with the config's camera, if it has one."""
    cameras = config.cameras
    if cameras is None:
        return scene
    camera = Perspective(scene.camera.to_world, cameras.fov, Film(cameras.resolution, cameras.resolution))
    return Scene(scene.shapes, camera, scene.environment, scene.lights)


def _read(number: int, file: str, scene: Scene) -> Float[np.ndarray, "H W 3"]:
    image = _placed(f"target.images[{number}]", load_image, file)
    height, width = scene.camera.film.window[3], scene.camera.film.window[2]
    if image.shape[:2] != (height, width) or image.shape[2] < 3:
        raise ValueError(
            f"target.images[{number}]: {file} is {image.shape[1]} x {image.shape[0]} pixels with {image.shape[2]} "
            f"channels, expected {width} x {height} in colour"
        )
    return image[..., :3]


def _placed(place: str, function: Callable, *arguments):
    """What the function returns; its ValueErrors start with the place."""
    try:
        return function(*arguments)
    except ValueError as problem:
        separator = "." if str(problem).split(":")[0].isidentifier() else ": "
        raise ValueError(f"{place}{separator}{problem}") from None
