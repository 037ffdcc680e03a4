"""Small corrections of camera poses."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry.rotation import rotation_matrix
from jaxdr.views.record import Views


def corrected(to_world: Float[Array | np.ndarray, "4 4"], correction: Float[Array, "6"]) -> Float[Array, "4 4"]:
    """A pose (camera to world), turned and shifted in the frame of the camera.

    `correction`: axis times angle (radians), then the shift along left, up and forward.
    """
    turn, shift = correction[:3], correction[3:]
    moved = jnp.eye(4, dtype=correction.dtype).at[:3, :3].set(rotation_matrix(turn)).at[:3, 3].set(shift)
    return jnp.asarray(to_world, correction.dtype) @ moved


def with_corrections(views: Views, corrections: Float[Array, "N 6"], scale: float) -> Views:
    """The photographs, the fitted ones with corrected poses; shifts are in units of `scale`."""
    unit = jnp.asarray([1.0, 1.0, 1.0, scale, scale, scale], corrections.dtype)
    pairs = zip(views.fitted, corrections, strict=True)
    poses = (np.asarray(corrected(view.to_world, correction * unit), float) for view, correction in pairs)
    moved = tuple(view if view.held_out else replace(view, to_world=next(poses)) for view in views.views)
    return replace(views, views=moved)


def sizes(corrections: Float[Array, "N 6"], scale: float) -> dict[str, float]:
    """The largest turn (degrees) and the largest shift, whose unit is `scale`."""
    turn, shift = (np.linalg.norm(part, axis=1) for part in np.split(np.asarray(corrections, float), 2, axis=1))
    return {"largest_turn_degrees": float(np.degrees(turn.max())), "largest_shift": float(scale * shift.max())}
