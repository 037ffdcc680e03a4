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


def motion(scene: Scene, name: str) -> tuple[str, Float[Array, "*n"], Float[Array, "*n"]]:
    """(name of the scene parameter that a motion changes, its value, its derivative with respect to the motion).

    - `<shape>.translate.x|y|z`: world-space translation of the vertices, in scene units;
    - `<shape>.rotate.x|y|z`: right-handed rotation, in radians, about a world axis through the centre of the shape's
      bounding box;
    - `camera.translate.x|y|z`, `camera.rotate.x|y|z`: the same for the camera, about its position;
    - any other parameter of `scene.parameters()` (`spot.bsdf.reflectance`, `camera.fov`, …), or a tie: all its
      components grow together, by one per unit.

    Raises ValueError for any other name.
    """
    parameters = every_parameter(scene)
    geometric = {key: key.removesuffix(".vertices") for key in parameters if key.endswith(".vertices")}
    owners = {owner: key for key, owner in geometric.items()} | {"camera": "camera.to_world"}

    owner, _, rest = name.partition(".")
    kind, _, axis = rest.partition(".")
    if owner in owners and kind in ("translate", "rotate") and axis in AXES:
        key = owners[owner]
        value = np.asarray(parameters[key])
        direction = np.asarray(AXES[axis], value.dtype)
        derive = _camera_derivative if key == "camera.to_world" else _vertex_derivative
        return key, parameters[key], as_array(derive(kind, value, direction), value.dtype)

    plain = [key for key in parameters if key not in owners.values()]
    if name in plain:
        return name, parameters[name], as_array(np.ones(parameters[name].shape), parameters[name].dtype)
    moves = [f"{o}.{k}.{a}" for o in owners for k in ("translate", "rotate") for a in AXES]
    hint = closest(name, [*moves, *plain])
    known = [f"{o}.translate|rotate.x|y|z" for o in owners]
    raise ValueError(
        f"{name!r} is not a motion or parameter of this scene{hint} (known: {', '.join([*known, *plain])})"
    )


def _vertex_derivative(kind, vertices, direction):
    if kind == "translate":
        return np.broadcast_to(direction, vertices.shape)
    return np.cross(direction, vertices - (vertices.min(0) + vertices.max(0)) / 2)


def _camera_derivative(kind, to_world, direction):
    derivative = np.zeros_like(to_world)
    if kind == "translate":
        derivative[:3, 3] = direction
    else:
        derivative[:3, :3] = np.cross(direction, to_world[:3, :3].T).T
    return derivative
