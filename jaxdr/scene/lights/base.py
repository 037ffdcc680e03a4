"""The interface of lights without area, which shine from a point or from one direction."""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.arrays import as_array, traced
from jaxdr.scene.ranges import Parametric
from jaxdr.scene.sampling import uniform_sphere


class DeltaLight(Parametric, eqx.Module):
    """A light without area: no ray meets it, and its shadows are hard. The base class of such lights.

    A light is `infinite` if it shines from infinitely far away, in one direction. When its methods are called, its
    fields have one row for each point, since `PackedScene` gathers them by light. The fields stay as they are if
    `stackable` is off, or if the light has borders. Shadows move with every parameter that `place` or `borders`
    depends on.
    """

    infinite: ClassVar[bool] = False
    stackable: ClassVar[bool] = True

    @abc.abstractmethod
    def place(self) -> Float[Array, "*#n 3"]:
        """World position; for an `infinite` light the unit direction towards it."""

    @abc.abstractmethod
    def intensity_in(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*#n 3"]:
        """RGB intensity (W / sr) in unit world directions away from the light; its irradiance (W / m^2) if `infinite`.

        It is continuous in the direction, except at `borders`.
        """

    @abc.abstractmethod
    def power(self, radius: Float[Array, ""]) -> Float[Array, ""]:
        """Approximate magnitude of the power (W) that a scene of this radius receives from one light."""

    def sample(self, u: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
        """Unit world directions away from the light, drawn from `pdf`; detached. Light paths start in them.

        By default all directions are equally likely. `infinite` lights have only one direction, and don't use this.
        """
        return uniform_sphere(u)

    def pdf(self, direction: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of `sample` (solid angle), detached; positive wherever there is light."""
        return jnp.full(direction.shape[:-1], 0.25 / math.pi, direction.dtype)

    @abc.abstractmethod
    def borders(self) -> Float[Array, "K 3 3"] | None:
        """Where the light ends abruptly: K triples of points, the two ends of a border line and a point inside.

        The points are in the world, relative to `place`. None for a light that fades out, that shines in all
        directions, or that is `infinite`.
        """


def check_direction(direction: Array, name: str) -> None:
    """Raises ValueError for a concrete direction that can't be normalised: lengths are squared, in float32."""
    if not traced(direction) and not 1e-18 < np.linalg.norm(np.asarray(direction, float)) < 1e18:
        raise ValueError(f"{name} must not be zero, nor of an extreme length (1e-18 to 1e18), got {direction}")


def vector(value: ArrayLike, name: str) -> Float[Array, "3"]:
    """An array of three numbers. Raises ValueError, with the parameter's name, for another shape."""
    array = as_array(value)
    if array.shape != (3,):
        raise ValueError(f"{name} must be three numbers, got shape {array.shape}")
    return array
