"""The direction in parameter space along which derivatives are measured, and what moves along it."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.moving import Moving, moving_in
from jaxdr.scene.motion import motion, rounding_step
from jaxdr.scene.scene import Scene, every_parameter


class Direction(NamedTuple):
    """Parameters of a scene by name, and a velocity for each."""

    values: dict[str, Array]
    velocities: dict[str, Array]

    def at(self, scene: Scene, t: Float[Array, ""]) -> Scene:
        """The scene at time t, which may be traced."""
        return scene.replace({name: value + t * self.velocities[name] for name, value in self.values.items()})

    def nudge(self) -> float:
        """A time in which all moving vertices move by rounding; 0 if no vertices move."""
        moved = [name for name in self.values if name.endswith(".vertices")]
        speeds = {name: float(jnp.abs(self.velocities[name]).max()) for name in moved}
        return max((rounding_step(self.values[name], speeds[name]) for name in moved), default=0.0)


def direction(scene: Scene, params: Sequence[str] | None, key: PRNGKeyArray) -> Direction:
    """A direction in which all of some parameters change.

    `params`: names of `scene.parameters()`, or motions such as `spot.translate.x` (see `jaxdr.scene.motion`); None for
    the vertices of all shapes. Motions have their own velocity. Other parameters get a random one in proportion to
    their size: vertices move as a whole, turn and grow; cameras and other frames move and turn; numbers change
    independently. Raises ValueError for an unknown name, for no name, and if two names mean the same parameter.
    """
    parameters = every_parameter(scene)
    names = [name for name in scene.parameters() if name.endswith(".vertices")] if params is None else list(params)
    if not names:
        raise ValueError("plan: params is empty; name at least one parameter, or leave it out for all vertices")
    values, velocities = {}, {}
    for number, asked in enumerate(names):
        value = parameters.get(asked)
        if value is None:
            moved = motion(scene, asked)
        else:
            moved = {asked: (value, _random(scene, asked, value, jax.random.fold_in(key, number)))}
        for name, (value, velocity) in moved.items():
            if name in values:
                raise ValueError(f"plan: params name {name} twice, the second time as {asked!r}")
            values[name], velocities[name] = value, velocity
    return Direction(values, velocities)


def moving_along(scene: Scene, names: Sequence[str]) -> Moving:
    """What moves in the scene when the parameters `names` change."""
    parameters = every_parameter(scene)
    replaced = scene.replace({name: parameters[name] + 0 for name in names})
    return moving_in(scene, jax.tree.map(lambda new, old: new is not old, replaced, scene))


def _random(scene: Scene, name: str, value, key):
    keys = jax.random.split(key, 3)
    if name.endswith(".vertices"):
        low, high = value.min(0), value.max(0)
        size, arm = jnp.linalg.norm(high - low), value - (low + high) / 2
        shift, turn = (jax.random.normal(k, (3,), value.dtype) for k in keys[:2])
        growth = jax.random.normal(keys[2], (), value.dtype)
        return size * shift + jnp.cross(turn, arm) + growth * arm
    if name.endswith(".to_world"):
        size = _scene_size(scene)
        shift, turn = (jax.random.normal(k, (3,), value.dtype) for k in keys[:2])
        turned = jnp.cross(turn[:, None], value[:3, :3], axis=0)
        return jnp.zeros_like(value).at[:3, :3].set(turned).at[:3, 3].set(size * shift)
    typical = jnp.sqrt(jnp.mean(value**2))
    return jnp.where(typical > 0, typical, 1.0) * jax.random.normal(keys[0], value.shape, value.dtype)


def _scene_size(scene: Scene):
    low = jnp.stack([shape.mesh.vertices.min(0) for shape in scene.shapes.values()]).min(0)
    high = jnp.stack([shape.mesh.vertices.max(0) for shape in scene.shapes.values()]).max(0)
    return jnp.linalg.norm(high - low)
