"""Emitters: surfaces that glow, the interface of environments, and the constant environment."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.argument_kinds import checked
from jaxdr.scene.bsdf.parameters import Color, Value, color
from jaxdr.scene.color import as_rgb, magnitude
from jaxdr.scene.ranges import Parametric, ranged
from jaxdr.scene.sampling import uniform_sphere, uniform_sphere_numbers


@checked
class AreaEmitter(Parametric, eqx.Module):
    """Emits RGB `radiance` (W / m^2 sr) from the side of the surface that its normal points to.

    `radiance` is a number, three numbers, or a texture. A texture varies over the surface and moves with it. Raises
    ValueError for another shape, and for radiance that is negative or not finite.
    """

    radiance: Color = eqx.field(metadata=ranged(0.0, math.inf))

    def __init__(self, radiance: Value):
        self.radiance = color(radiance, "AreaEmitter: radiance")


class DirectionSampler(eqx.Module):
    """Draws directions from which an environment sends light. It is detached from the radiance."""

    @abc.abstractmethod
    def sample(self, u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """World directions with density `pdf`, drawn by uniform numbers in [0, 1)^2; detached."""

    @abc.abstractmethod
    def numbers(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """The uniform numbers from which `sample` draws these unit world directions; detached."""

    @abc.abstractmethod
    def pdf(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Density (solid angle) at unit world directions.

        It is differentiable in the directions, and in the rotation of the environment.
        """

    @abc.abstractmethod
    def extent(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Angle (radians) around each direction within which the density is comparable to that there; detached."""

    @abc.abstractmethod
    def reach(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Upper bound (radians) of the `extent` of all directions whose extents contain this direction; detached."""

    @abc.abstractmethod
    def mean(self) -> Float[Array, ""]:
        """Approximate mean magnitude of the radiance over the sphere; detached."""


class Environment(Parametric, eqx.Module):
    """Light from infinitely far away. A new kind is a file with a look-up by direction, a sampler and a turn.

    `uniform`: whether radiance and density are the same in all directions.

    The derivative by a parameter that `turn` depends on is taken at directions that turn with the environment. The
    derivative by any other parameter is taken at fixed directions. For it the radiance has to be continuous, in the
    parameter and in the direction.
    """

    uniform: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def eval(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*#n 3"]:
        """RGB radiance (W / m^2 sr) that comes from unit world directions; differentiable in them."""

    @abc.abstractmethod
    def sampler(self) -> DirectionSampler:
        """The sampler that draws directions to this environment."""

    @abc.abstractmethod
    def turn(self) -> Float[Array, "3 3"]:
        """The identity matrix, with the derivative of the rotation by which the environment turns.

        Directions times this matrix turn with the environment. A jump of the radiance, such as the rim of a sun, has
        to turn with them. An environment that can't turn returns `jnp.eye(3)`.
        """


class UniformDirections(DirectionSampler):
    """All directions are equally likely, and have the same `radiance`."""

    radiance: Float[Array, "3"]

    def sample(self, u):
        return uniform_sphere(u)

    def numbers(self, direction):
        return uniform_sphere_numbers(direction)

    def pdf(self, direction):
        del direction
        return 1.0 / (4.0 * math.pi)

    def extent(self, direction):
        del direction
        return math.pi

    def reach(self, direction):
        del direction
        return math.pi

    def mean(self):
        return magnitude(self.radiance)


@checked
class ConstantEnvironment(Environment):
    """Light of the same RGB `radiance` (W / m^2 sr) from every direction.

    Raises ValueError for another shape, and for radiance that is not finite.
    """

    radiance: Float[Array, "3"]
    uniform = True

    def __init__(self, radiance: ArrayLike = 1.0):
        self.radiance = as_rgb(radiance, "ConstantEnvironment: radiance")

    def eval(self, direction):
        del direction
        return self.radiance

    def sampler(self):
        return UniformDirections(stop_gradient(self.radiance))

    def turn(self):
        return jnp.eye(3, dtype=self.radiance.dtype)
