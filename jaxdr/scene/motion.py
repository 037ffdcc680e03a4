"""One-parameter motions of a scene by name, for derivative images: `spot.translate.x`, `camera.rotate.z`, …"""

import difflib
from collections.abc import Iterable

import numpy as np
from jaxtyping import Array, Float

from jaxdr.arrays import as_array
from jaxdr.scene.scene import Scene, every_parameter

EPSILON = float(np.finfo(np.float32).eps)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def rounding_step(value: Float[Array, "*n"], speed: float) -> float:
    """Step of a motion that changes the largest component of `value` by four units in the last place (float32).

    `speed` is the size of the value's derivative. Such a step changes no picture. But acceleration structures are
    cached by the content of the scene, so they are built anew.
    """
    return 4 * EPSILON * float(np.abs(np.asarray(value)).max()) / max(speed, 1e-12)


def closest(name: str, known: Iterable[str]) -> str:
    """Words for a message about an unknown name: the known one that is most like it, if there is one."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def members(scene: Scene, owner: str) -> tuple[str, ...]:
    """Ids of the shapes that a name of a motion begins with: one, or a group such as `ball+hat`; else nothing."""
    ids = (owner,) if owner in scene.shapes else tuple(owner.split("+"))
    return ids if set(ids) <= set(scene.shapes) and len(set(ids)) == len(ids) else ()


def motion(scene: Scene, name: str) -> dict[str, tuple[Float[Array, "*n"], Float[Array, "*n"]]]:
    """What a motion changes: name of the parameter -> (its value, its derivative with respect to the motion).

    - `<shape>.translate.x|y|z`: world-space translation of the vertices, in scene units;
    - `<shape>.rotate.x|y|z`: right-handed rotation, in radians, about a world axis through the centre of the shape's
      bounding box;
    - `<shape>+<shape>.translate.x`, …: several shapes as one, about the centre of their common box;
    - `camera.translate.x|y|z`, `camera.rotate.x|y|z`: the same for the camera, about its position;
    - any other parameter of `scene.parameters()` (`spot.bsdf.reflectance`, `camera.fov`, …), or a tie: all its
      components grow together, by one per unit.

    Raises ValueError for any other name.
    """
    parameters = every_parameter(scene)
    owners = {owner: f"{owner}.vertices" for owner in scene.shapes} | {"camera": "camera.to_world"}

    owner, _, rest = name.partition(".")
    kind, _, axis = rest.partition(".")
    shapes = members(scene, owner)
    if (shapes or owner == "camera") and kind in ("translate", "rotate") and axis in AXES:
        keys = [owners[each] for each in shapes or ("camera",)]
        values = [np.asarray(parameters[key]) for key in keys]
        direction = np.asarray(AXES[axis], values[0].dtype)
        moved = (_vertex_derivatives if shapes else _camera_derivatives)(kind, values, direction)
        return {key: (parameters[key], as_array(by, by.dtype)) for key, by in zip(keys, moved, strict=True)}

    plain = [key for key in parameters if key not in owners.values()]
    if name in plain:
        return {name: (parameters[name], as_array(np.ones(parameters[name].shape), parameters[name].dtype))}
    moves = [f"{o}.{k}.{a}" for o in owners for k in ("translate", "rotate") for a in AXES]
    hint = closest(name, [*moves, *plain])
    known = [f"{o}.translate|rotate.x|y|z" for o in owners]
    raise ValueError(
        f"{name!r} is not a motion or parameter of this scene{hint} (known: {', '.join([*known, *plain])})"
    )


def _vertex_derivatives(kind, group, direction):
    if kind == "translate":
        return [np.broadcast_to(direction, vertices.shape) for vertices in group]
    low, high = np.min([vertices.min(0) for vertices in group], 0), np.max([vertices.max(0) for vertices in group], 0)
    return [np.cross(direction, vertices - (low + high) / 2) for vertices in group]


def _camera_derivatives(kind, poses, direction):
    (to_world,) = poses
    derivative = np.zeros_like(to_world)
    if kind == "translate":
        derivative[:3, 3] = direction
    else:
        derivative[:3, :3] = np.cross(direction, to_world[:3, :3].T).T
    return [derivative]
