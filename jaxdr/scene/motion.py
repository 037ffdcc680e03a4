"""One-parameter motions of a scene by name, for derivative images: `spot.translate.x`, `camera.rotate.z`, …"""

import difflib

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry.vector import cross
from jaxdr.scene.scene import Scene

EPSILON = float(np.finfo(np.float32).eps)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def rounding_step(value: Float[Array, "*n"], speed: float) -> float:
    """How far to go for a move of four units in the last place of the largest component of `value` (float32).

    `speed`: size of the value's derivative. Acceleration structures are kept by their content; after such a step
    they are built anew, and nothing else changes.
    """
    return 4 * EPSILON * float(jnp.abs(value).max()) / max(speed, 1e-12)


def motion(scene: Scene, name: str) -> tuple[str, Float[Array, "*n"], Float[Array, "*n"]]:
    """Scene parameter that a motion changes, its value, and its derivative with respect to the motion.

    - `<shape>.translate.x|y|z`: world-space translation of the vertices, in scene units;
    - `<shape>.rotate.x|y|z`: right-handed rotation, in radians, about a world axis through the centre of the shape's
      bounding box;
    - `camera.translate.x|y|z`, `camera.rotate.x|y|z`: the same for the camera, about its position;
    - any other parameter of `scene.parameters()` (`spot.bsdf.reflectance`, `camera.fov`, …): all its components
      grow together, by one per unit.

    Raises ValueError for any other name.
    """
    parameters = scene.parameters()
    geometric = {key: key.removesuffix(".vertices") for key in parameters if key.endswith(".vertices")}
    owners = {owner: key for key, owner in geometric.items()} | {"camera": "camera.to_world"}

    owner, _, rest = name.partition(".")
    kind, _, axis = rest.partition(".")
    if owner in owners and kind in ("translate", "rotate") and axis in AXES:
        key = owners[owner]
        value = parameters[key]
        direction = jnp.asarray(AXES[axis], value.dtype)
        if key == "camera.to_world":
            return key, value, _camera_derivative(kind, value, direction)
        centre = (value.min(0) + value.max(0)) / 2
        turning = cross(direction, value - centre)
        return key, value, jnp.broadcast_to(direction, value.shape) if kind == "translate" else turning

    plain = [key for key in parameters if key not in owners.values()]
    if name in plain:
        return name, parameters[name], jnp.ones_like(parameters[name])
    moves = [f"{o}.{k}.{a}" for o in owners for k in ("translate", "rotate") for a in AXES]
    close = difflib.get_close_matches(name, [*moves, *plain], n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    known = [f"{o}.translate|rotate.x|y|z" for o in owners]
    raise ValueError(
        f"{name!r} is not a motion or parameter of this scene{hint} (known: {', '.join([*known, *plain])})"
    )


def _camera_derivative(kind, to_world, direction):
    if kind == "translate":
        return jnp.zeros_like(to_world).at[:3, 3].set(direction)
    return jnp.zeros_like(to_world).at[:3, :3].set(jnp.cross(direction[:, None], to_world[:3, :3], axis=0))
