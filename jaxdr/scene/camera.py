"""Perspective camera: film point -> ray, and world point -> film point."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxdr.geometry.vector import normalize
from jaxdr.scene.film import Film

FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


def look_at(origin, target, up) -> Float[np.ndarray, "4 4"]:
    """Camera-to-world matrix that looks from `origin` to `target`; columns left, up, forward, origin (Mitsuba's).

    Raises ValueError when origin and target coincide or `up` is parallel to the line between them.
    """
    origin, target, up = (np.asarray(v, float) for v in (origin, target, up))
    forward = target - origin
    left = np.cross(up, forward)
    if not np.linalg.norm(left) > 1e-12 * max(np.linalg.norm(up) * np.linalg.norm(forward), 1e-300):
        raise ValueError(f"look_at: up {up} is parallel to the view direction {forward}, or one of them is zero")
    forward, left = forward / np.linalg.norm(forward), left / np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


class Perspective(eqx.Module):
    """Pinhole camera. It looks along +z of its frame, x to the left, y up, as in Mitsuba.

    `to_world` [4, 4] camera-to-world (rotation, translation and uniform scale), `fov` in degrees along `fov_axis`.
    """

    to_world: Float[Array, "4 4"]
    fov: Float[Array, ""]
    film: Film
    fov_axis: str = eqx.field(static=True)
    near_clip: float = eqx.field(static=True)
    far_clip: float = eqx.field(static=True)

    def __init__(self, to_world, fov, film: Film, fov_axis: str = "x", near_clip: float = 1e-2, far_clip: float = 1e4):
        self.to_world = jnp.asarray(to_world, float)
        self.fov = jnp.asarray(fov, float)
        self.film = film
        self.fov_axis = fov_axis
        self.near_clip = float(near_clip)
        self.far_clip = float(far_clip)
        if self.to_world.shape != (4, 4):
            raise ValueError(f"Perspective: to_world must be a 4 x 4 matrix, got shape {self.to_world.shape}")
        if fov_axis not in FOV_AXES:
            raise ValueError(f"Perspective: fov_axis must be one of {', '.join(FOV_AXES)}; got {fov_axis!r}")
        if not 0 < self.near_clip < self.far_clip:
            raise ValueError(f"Perspective: need 0 < near_clip < far_clip, got {near_clip} and {far_clip}")

    @property
    def position(self) -> Float[Array, "3"]:
        """Centre of projection in world space."""
        return self.to_world[:3, 3]

    @property
    def pixels_per_tangent(self) -> Float[Array, ""]:
        """Focal length in pixels: film distance from the centre per unit tangent."""
        film = self.film
        axis = self.fov_axis
        if axis in ("smaller", "larger"):
            wide = film.width >= film.height
            axis = "x" if wide == (axis == "larger") else "y"
        length = {"x": film.width, "y": film.height, "diagonal": math.hypot(film.width, film.height)}[axis]
        return 0.5 * length / jnp.tan(jnp.deg2rad(self.fov) / 2)

    def rays(self, film_points: Float[Array, "*n 2"]) -> tuple[Float[Array, "3"], Float[Array, "*n 3"]]:
        """Origin [3] and unit directions [..., 3] of the rays through film points (pixels)."""
        centre = jnp.asarray([0.5 * self.film.width, 0.5 * self.film.height], film_points.dtype)
        tangent = (centre - film_points) / self.pixels_per_tangent
        local = jnp.concatenate([tangent, jnp.ones_like(tangent[..., :1])], -1)
        return self.position, normalize(local @ self.to_world[:3, :3].T)

    def local(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """World points in the camera frame (left, up, forward)."""
        rotation = self.to_world[:3, :3]
        squared_scale = (rotation[:, 2] ** 2).sum()
        return (points - self.position) @ rotation / squared_scale

    def project(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Film points (pixels) of world points in front of the camera."""
        return self.project_local(self.local(points))

    def project_local(self, local: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """Film points (pixels) of points in the camera frame with positive depth."""
        centre = jnp.asarray([0.5 * self.film.width, 0.5 * self.film.height], local.dtype)
        return centre - self.pixels_per_tangent * local[..., :2] / local[..., 2:]
