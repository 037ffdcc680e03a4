"""The interface of a light without area: it shines from a point, or from one direction."""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.arrays import as_array
from jaxdr.scene.sampling import uniform_sphere


class DeltaLight(eqx.Module):
    """A light without area: no ray meets it, and its shadows are hard. The base class of such lights.

    A light is `infinite` if it shines from infinitely far away, in one direction. Its methods are called with fields
    that hold one row for each point, since `PackedScene` gathers them by light. With `stackable` off, and where there
    are borders, the fields stay as they are. Shadows move with all that `place` and `borders` depend on.
    """

    infinite: ClassVar[bool] = False
    stackable: ClassVar[bool] = True

    @abc.abstractmethod
    def place(self) -> Float[Array, "*#n 3"]:
        """Position (world); where `infinite` the unit direction towards the light."""

    @abc.abstractmethod
    def intensity_in(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*#n 3"]:
        """RGB intensity (W / sr) in unit world directions away from the light; its irradiance (W / m^2) if `infinite`.

        Continuous in the direction but for `borders`.
        """

    @abc.abstractmethod
    def power(self, radius: Float[Array, ""]) -> Float[Array, ""]:
        """Luminance of the power (W) that a scene of this radius receives, about; of one light."""

    def sample(self, u: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
        """Unit world directions away from the light, drawn from `pdf`; detached. Light paths leave in them.

        By default all directions are as likely. Not for `infinite` ones, whose direction is given.
        """
        return uniform_sphere(u)

    def pdf(self, direction: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of `sample` (solid angle), detached; positive wherever there is light."""
        return jnp.full(direction.shape[:-1], 0.25 / math.pi, direction.dtype)

    @abc.abstractmethod
    def borders(self) -> Float[Array, "K 3 3"] | None:
        """World points on the border of what is lit, where that ends abruptly: both ends of K lines and a point inside.

        None for a light that fades or shines to all sides.
        """


def vector(value: ArrayLike, name: str) -> Float[Array, "3"]:
    """Three numbers; ValueError names the parameter otherwise."""
    array = as_array(value)
    if array.shape != (3,):
        raise ValueError(f"{name} must be three numbers, got shape {array.shape}")
    return array
