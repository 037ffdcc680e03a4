"""Views: projections of the world onto the film, through a pinhole or in parallel.

A camera without an aperture is one view. A camera with a lens has a view for every point of the lens, one in each row.
All lengths on the film are in pixels. The frame of a view looks along +z, with x to the left and y up, as in Mitsuba.
"""

import abc
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int

from jaxdr.geometry.vector import components, cross, dot, from_components, norm, normalize, scale, transform, z_of
from jaxdr.scene.film import Film


class View(eqx.Module):
    """A frame in the world, and its projection onto the film.

    - `matrix` [3, 3]: maps directions of the frame to the world.
    - `position`: origin of the frame.
    - `pixels`: pixels per unit of x / z (pinhole) or of x (parallel).
    - `centre`: film point of the frame's axis.
    - `near`, `far`: the depths z between which things are seen. Rays start on the plane z = 0.
    - `film`: that of the camera.

    `position` and `centre` may have one row for every point, or film point, that the methods get.
    """

    matrix: Float[Array, "3 3"]
    position: Float[Array, "*#n 3"]
    pixels: Float[Array, ""]
    centre: Float[Array, "*#n 2"]
    film: Film
    near: float = eqx.field(static=True)
    far: float = eqx.field(static=True)

    @property
    def _cofactors(self) -> Float[Array, "3 3"]:
        """Cross products of the axes, two by two: y × z, z × x, x × y."""
        axes = self.matrix.T
        return cross(jnp.roll(axes, -1, 0), jnp.roll(axes, 1, 0))

    @property
    def determinant(self) -> Float[Array, ""]:
        """Determinant of `matrix`: signed world volume per unit volume of the frame."""
        return jnp.vdot(self.matrix[:, 0], self._cofactors[0])

    @property
    def inverse(self) -> Float[Array, "3 3"]:
        """Inverse of `matrix`: it maps directions of the world to the frame."""
        cofactors = self._cofactors
        return cofactors / jnp.vdot(self.matrix[:, 0], cofactors[0])

    def local(self, points: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """World points in the frame (left, up, forward)."""
        return transform(self.inverse, points - self.position)

    def project(self, points: Float[Array, "*#n 3"]) -> Float[Array, "*#n 2"]:
        """Film points of world points. For a pinhole the points have to be in front of it."""
        return self.project_local(self.local(points))

    def clipped(
        self, origin: Float[Array, "*#n 3"], direction: Float[Array, "*n 3"]
    ) -> tuple[Float[Array, "*n 3"], Float[Array, "*n"]]:
        """(points where unit rays meet the near plane, distances from there to the far plane); detached."""
        origin, direction = stop_gradient((origin, direction))
        depth = direction @ stop_gradient(self.inverse[2])
        return origin + scale(direction, self.near / depth), (self.far - self.near) / depth

    def row(self, index: Int[Array, " m"]) -> "View":
        """The views of some rows; this view if all rows share it."""
        if self.position.ndim == 1:
            return self
        return replace(self, position=self.position[index], centre=self.centre[index])

    @abc.abstractmethod
    def rays(self, film_points: Float[Array, "*n 2"]) -> tuple[Float[Array, "*#n 3"], Float[Array, "*n 3"]]:
        """Origins and unit directions of the rays through film points."""

    @abc.abstractmethod
    def project_local(self, local: Float[Array, "*#n 3"]) -> Float[Array, "*#n 2"]:
        """Film points of points in the frame. For a pinhole the points have to be in front of it."""

    @abc.abstractmethod
    def homogeneous(self, local: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Denominator w of the projection: along a line, (x, y, z, 1) / w is linear in the position on the film."""

    @abc.abstractmethod
    def towards(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Unit directions from world points to the view."""

    @abc.abstractmethod
    def film_area(self, local: Float[Array, "*n 3"], normal: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Square pixels of film per area of surface (square scene units), at frame points with unit world normals."""

    @abc.abstractmethod
    def pixel_size(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Side (scene units), across the ray, of what a pixel covers at world points."""


class PinholeView(View):
    """Central projection; `position` is the pinhole."""

    def rays(self, film_points):
        tangent = (self.centre - film_points) / self.pixels
        x, y = components(tangent)
        local = from_components(x, y, jnp.ones_like(x))
        return self.position, normalize(transform(self.matrix, local))

    def project_local(self, local):
        x, y, z = components(local)
        return self.centre - self.pixels * from_components(x / z, y / z)

    def homogeneous(self, local):
        return z_of(local)

    def towards(self, points):
        return normalize(self.position - points)

    def film_area(self, local, normal):
        # The squared focal length times |n · (x - o)| / depth^3, in the frame. There the normal, times its area, is
        # `matrix`.T @ n / |determinant|.
        facing = jnp.abs(dot(transform(self.matrix.T, normal), local))
        return self.pixels**2 * facing / (jnp.abs(self.determinant) * z_of(local) ** 3)

    def pixel_size(self, points):
        return norm(points - self.position) / self.pixels


class ParallelView(View):
    """Parallel projection along the frame's axis."""

    def rays(self, film_points):
        across = (self.centre - film_points) / self.pixels
        origin = self.position + across @ self.matrix[:, :2].T
        return origin, jnp.broadcast_to(normalize(self.matrix[:, 2]), origin.shape)

    def project_local(self, local):
        x, y, _ = components(local)
        return self.centre - self.pixels * from_components(x, y)

    def homogeneous(self, local):
        return jnp.ones(local.shape[:-1], local.dtype)

    def towards(self, points):
        return jnp.broadcast_to(-normalize(self.matrix[:, 2]), points.shape)

    def film_area(self, local, normal):
        facing = jnp.abs(dot(normal, self.matrix[:, 2]))
        return self.pixels**2 * facing / jnp.abs(self.determinant)

    def pixel_size(self, points):
        # Where x and y have different scales, it is the side of a square of the same area.
        x, y, _ = self.matrix.T
        return jnp.broadcast_to(jnp.sqrt(norm(cross(x, y))) / self.pixels, points.shape[:-1])
