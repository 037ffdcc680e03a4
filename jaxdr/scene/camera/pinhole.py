"""The base class of cameras with a field of view."""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxdr.arrays import as_array
from jaxdr.scene.camera.base import Camera, checked_clip, checked_pose
from jaxdr.scene.camera.view import PinholeView
from jaxdr.scene.film import Film
from jaxdr.scene.ranges import ranged, within

FOV = 0.0, 180.0  # degrees, without the ends
FOV_COMPUTED = 1e-4, 180.0 - 1e-3  # nearer to the ends the film is a point or infinite in float32
FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


class PinholeCamera(Camera):
    """A camera with central projection. Its parameters are those of `Perspective`."""

    to_world: Float[Array, "4 4"]
    fov: Float[Array, ""] = eqx.field(metadata=ranged(*FOV, open=True, unit="degrees"))
    principal_point: Float[Array, "2"]
    film: Film
    fov_axis: str = eqx.field(static=True)
    near_clip: float = eqx.field(static=True)
    far_clip: float = eqx.field(static=True)

    def __init__(self, to_world, fov, film: Film, fov_axis, near_clip, far_clip, principal_point):
        name = type(self).__name__
        self.to_world = checked_pose(name, to_world, scales=False)
        self.fov = as_array(fov)
        self.principal_point = as_array(principal_point)
        self.film = film
        self.fov_axis = fov_axis
        self.near_clip, self.far_clip = checked_clip(name, near_clip, far_clip)
        if fov_axis not in FOV_AXES:
            raise ValueError(f"{name}: fov_axis must be one of {', '.join(FOV_AXES)}; got {fov_axis!r}")
        if self.fov.shape != ():
            raise ValueError(f"{name}: fov must be a number (degrees), got shape {self.fov.shape}")
        if self.principal_point.shape != (2,):
            raise ValueError(
                f"{name}: principal_point must be two numbers, x and y, got shape {self.principal_point.shape}"
            )

    def check_together(self):
        checked_pose(type(self).__name__, self.to_world, scales=False)

    @property
    def position(self) -> Float[Array, "3"]:
        """Centre of projection in world space."""
        return self.to_world[:3, 3]

    @property
    def pixels_per_tangent(self) -> Float[Array, ""]:
        """Focal length in pixels: film distance from the principal point per tangent of the angle to the axis."""
        film = self.film
        axis = self.fov_axis
        if axis in ("smaller", "larger"):
            wide = film.width >= film.height
            axis = "x" if wide == (axis == "larger") else "y"
        length = {"x": film.width, "y": film.height, "diagonal": math.hypot(film.width, film.height)}[axis]
        return 0.5 * length / jnp.tan(jnp.deg2rad(within(self.fov, *FOV_COMPUTED)) / 2)

    def view(self, u=None) -> PinholeView:
        size = jnp.asarray([self.film.width, self.film.height], self.principal_point.dtype)
        centre = size * (0.5 - self.principal_point)
        rotation, focal = self.to_world[:3, :3], self.pixels_per_tangent
        return PinholeView(rotation, self.position, focal, centre, self.film, self.near_clip, self.far_clip)
