"""Shapes and the camera, translated, turned and scaled by name: the motions of `motion`, by more than a little."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.arrays import as_numbers, traced
from jaxdr.geometry.rotation import rotation_matrix
from jaxdr.scene.motion import AXES, closest, members
from jaxdr.scene.scene import Scene

KINDS = ("scale", "rotate", "translate")  # in the order in which they are done


class _Motion(NamedTuple):
    """One motion: its kind, its axis ("" for all three), and its value, a number or a vector [3]."""

    kind: str
    axis: str
    value: Array

    def vector(self) -> Float[Array, "3"]:
        """Translation, or axis times angle."""
        return self.value * jnp.asarray(AXES[self.axis], self.value.dtype) if self.axis else self.value

    def factors(self) -> Float[Array, "3"]:
        """Factors of scale along the three axes."""
        if not self.axis:
            return jnp.broadcast_to(self.value, (3,))
        return 1.0 + (self.value - 1.0) * jnp.asarray(AXES[self.axis], self.value.dtype)


@checked
def move(scene: Scene, motions: Mapping[str, ArrayLike]) -> Scene:
    """The scene with shapes and the camera moved; pure, traceable, and differentiable by the motions.

    - `SHAPE.translate`: [3], in scene units; `SHAPE.translate.x` (`y`, `z`) is one number.
    - `SHAPE.rotate`: [3], axis times angle in radians, right-handed about a world axis through the centre of the
      shape's bounding box; `SHAPE.rotate.x` is an angle.
    - `SHAPE.scale`: a factor or three, from that centre; `SHAPE.scale.x` is one factor.
    - `SHAPE+SHAPE.rotate`, …: several shapes as one, about the centre of their common box.
    - `camera.translate`, `camera.rotate`, with axes as well: the camera turns about its position.

    A shape is scaled first, then turned (by the vector, about x, y, z), then translated, whatever the order of the
    names. Groups move after the shapes in them, larger groups last. Small motions are those of `jaxdr gradient --wrt`.
    Raises ValueError for unknown names, for values of another shape, and as `Scene.replace` does.
    """
    if not traced(scene, dict(motions)):  # concrete values are moved to the same ones inside `jit`
        with jax.ensure_compile_time_eval():
            return _moved(scene, motions)
    return _moved(scene, motions)


def _moved(scene: Scene, motions: Mapping[str, ArrayLike]) -> Scene:
    moves: dict[str, list[_Motion]] = {}
    for name, value in motions.items():
        owner, motion = _parsed(scene, name, value)
        moves.setdefault(owner, []).append(motion)
    parameters, new = scene.parameters(), {}
    for owner, done in sorted(moves.items(), key=lambda item: (len(members(scene, item[0])), item[0])):
        done.sort(key=lambda motion: (KINDS.index(motion.kind), motion.axis))
        if owner == "camera":
            new["camera.to_world"] = _moved_pose(parameters["camera.to_world"], done)
            continue
        keys = [f"{each}.vertices" for each in members(scene, owner)]
        group = [new.get(key, parameters[key]) for key in keys]
        new |= zip(keys, _moved_vertices(group, done), strict=True)
    return scene.replace(new)


def _parsed(scene: Scene, name: str, value: ArrayLike) -> tuple[str, _Motion]:
    owner = name.partition(".")[0]
    owners = [*scene.shapes, *([owner] if owner not in scene.shapes and members(scene, owner) else [])]
    known = {f"{owner}.{kind}": owner for owner in owners for kind in KINDS}
    known |= {f"camera.{kind}": "camera" for kind in KINDS if kind != "scale"}
    names = {f"{start}{axis}": (start, axis[1:]) for start in known for axis in ("", *(f".{a}" for a in AXES))}
    if name not in names:
        hint = closest(name, names)
        raise ValueError(f"move: {name!r} is no motion of this scene{hint} (known: {', '.join(known)}; .x, .y, .z)")
    start, axis = names[name]
    kind, array = start.rpartition(".")[2], as_numbers(value, f"move: {name}")
    expected = [()] if axis else [(), (3,)] if kind == "scale" else [(3,)]
    if array.shape not in expected:
        shapes = " or ".join(str(list(shape)) for shape in expected)
        raise ValueError(f"move: {name} has shape {shapes}, got {list(array.shape)}")
    return known[start], _Motion(kind, axis, array)


def _moved_vertices(group: list[Float[Array, "_ 3"]], motions: list[_Motion]) -> list[Float[Array, "_ 3"]]:
    """The vertices of shapes that move as one."""
    low = jnp.stack([vertices.min(0) for vertices in group]).min(0)
    high = jnp.stack([vertices.max(0) for vertices in group]).max(0)
    about = (low + high) / 2
    local = [motion for motion in motions if motion.kind != "translate"]
    found = []
    for vertices in group:
        moved = vertices - about
        for motion in local:
            moved = moved * motion.factors() if motion.kind == "scale" else moved @ rotation_matrix(motion.vector()).T
        start = moved + about if local else vertices
        found.append(sum((motion.vector() for motion in motions if motion.kind == "translate"), start=start))
    return found


def _moved_pose(to_world: Float[Array, "4 4"], motions: list[_Motion]) -> Float[Array, "4 4"]:
    for motion in motions:
        if motion.kind == "rotate":
            to_world = to_world.at[:3, :3].set(rotation_matrix(motion.vector()) @ to_world[:3, :3])
        else:
            to_world = to_world.at[:3, 3].add(motion.vector())
    return to_world
