"""Views: projections of the world onto the film, through a pinhole or in parallel.

A camera without an aperture is one view; one with a lens is a view for every point of the lens, row by row. All lengths
on the film are in pixels. The frame of a view looks along +z, x to the left and y up, as in Mitsuba.
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
    """A frame in the world, and how it is projected onto the film.

    - `matrix` [3, 3]: takes directions of the frame to the world.
    - `position`: origin of the frame.
    - `pixels`: pixels per unit of x / z (pinhole) or of x (parallel).
    - `centre`: film point of the frame's axis.
    - `near`, `far`: depths z between which things are seen. Rays start on the plane z = 0.
    - `film`: that of the camera.

    `position` and `centre` may have one row for every point, or film point, that the methods are called with.
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
        """Vector products of two of the axes: y x z, z x x, x x y."""
        axes = self.matrix.T
        return cross(jnp.roll(axes, -1, 0), jnp.roll(axes, 1, 0))

    @property
    def determinant(self) -> Float[Array, ""]:
        """World volume per volume of the frame, signed."""
        return jnp.vdot(self.matrix[:, 0], self._cofactors[0])

    @property
    def inverse(self) -> Float[Array, "3 3"]:
        """Takes directions of the world to the frame."""
        cofactors = self._cofactors
        return cofactors / jnp.vdot(self.matrix[:, 0], cofactors[0])

    def local(self, points: Float[Array, "*#n 3"]) -> Float[Array, "*#n 3"]:
        """World points in the frame (left, up, forward)."""
        return transform(self.inverse, points - self.position)

    def project(self, points: Float[Array, "*#n 3"]) -> Float[Array, "*#n 2"]:
        """Film points of world points; those in front of a pinhole."""
        return self.project_local(self.local(points))

    def clipped(
        self, origin: Float[Array, "*#n 3"], direction: Float[Array, "*n 3"]
    ) -> tuple[Float[Array, "*n 3"], Float[Array, "*n"]]:
        """Where unit rays enter what is seen, and how far it reaches from there; detached."""
        origin, direction = stop_gradient((origin, direction))
        depth = direction @ stop_gradient(self.inverse[2])
        return origin + scale(direction, self.near / depth), (self.far - self.near) / depth

    def row(self, index: Int[Array, " m"]) -> "View":
        """The views of some rows, where every row has its own."""
        if self.position.ndim == 1:
            return self
        return replace(self, position=self.position[index], centre=self.centre[index])

    @abc.abstractmethod
    def rays(self, film_points: Float[Array, "*n 2"]) -> tuple[Float[Array, "*#n 3"], Float[Array, "*n 3"]]:
        """Origins and unit directions of the rays through film points."""

    @abc.abstractmethod
    def project_local(self, local: Float[Array, "*#n 3"]) -> Float[Array, "*#n 2"]:
        """Film points of points in the frame; those in front of a pinhole."""

    @abc.abstractmethod
    def homogeneous(self, local: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Denominator of the projection: equal steps on the film are equal steps of (x, y, z, 1) over it."""

    @abc.abstractmethod
    def towards(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Unit directions from world points to the view."""

    @abc.abstractmethod
    def film_area(self, local: Float[Array, "*n 3"], normal: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Square pixels of film per area of surface (scene units), at points in the frame with unit world normals."""

    @abc.abstractmethod
    def pixel_size(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
        """Length (scene units) across the ray that a pixel covers at world points."""


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
        # |n · (x - o)| / depth^3 times the squared focal length, in the frame: n turns with the inverse of `matrix`.
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
        # Where x and y are scaled apart, the side of a square of the same area.
        x, y, _ = self.matrix.T
        return jnp.broadcast_to(jnp.sqrt(norm(cross(x, y))) / self.pixels, points.shape[:-1])
