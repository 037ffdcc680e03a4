"""Emitters: surfaces that glow, what an environment is, and the constant one."""

import abc
import math

import equinox as eqx
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.scene.bsdf.parameters import Color, Value, rgb
from jaxdr.scene.color import as_rgb, luminance
from jaxdr.scene.sampling import uniform_sphere, uniform_sphere_numbers


class AreaEmitter(eqx.Module):
    """Emits RGB `radiance` (W / m^2 sr) from the side of the surface that its normal points to.

    `radiance` is a number, three numbers, or a texture. A texture varies over the surface and moves with it. Raises
    ValueError for another shape, and for radiance that is negative or not finite.
    """

    radiance: Color

    def __init__(self, radiance: Value):
        self.radiance = rgb(radiance, "AreaEmitter: radiance", 0.0, math.inf)


class DirectionSampler(eqx.Module):
    """Draws directions from which an environment sends light; detached from the radiance."""

    @abc.abstractmethod
    def sample(self, u: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """World directions drawn from `pdf`, from uniform numbers; detached."""

    @abc.abstractmethod
    def numbers(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n 2"]:
        """The uniform numbers from which `sample` draws unit world directions; detached."""

    @abc.abstractmethod
    def pdf(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Density (solid angle) at unit world directions; differentiable in them, and turns with the environment."""

    @abc.abstractmethod
    def extent(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Angle (radians) around directions within which the density stays comparable to that there; detached."""

    @abc.abstractmethod
    def reach(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*n"] | float:
        """Angle (radians) that no `extent` of another direction exceeds which goes as far as this one; detached."""

    @abc.abstractmethod
    def mean(self) -> Float[Array, ""]:
        """Luminance of the mean radiance over the sphere, about; detached."""


class Environment(eqx.Module):
    """Light from infinitely far away. A new one is a file with a look-up by direction, a sampler and a turn.

    `uniform`: whether radiance and density are the same in all directions.

    By a parameter that `turn` depends on, everything is differentiated in directions that turn along. By any other it
    is in fixed ones: there the radiance has to be continuous, in the parameter and in the direction.
    """

    uniform: eqx.AbstractClassVar[bool]

    @abc.abstractmethod
    def eval(self, direction: Float[Array, "*n 3"]) -> Float[Array, "*#n 3"]:
        """RGB radiance (W / m^2 sr) that comes from unit world directions; differentiable in them."""

    @abc.abstractmethod
    def sampler(self) -> DirectionSampler:
        """What directions are drawn from."""

    @abc.abstractmethod
    def turn(self) -> Float[Array, "3 3"]:
        """The identity, differentiable as the rotation that takes directions along as the environment turns.

        Where the radiance jumps, as at the rim of a sun, that has to go along; `jnp.eye(3)` if nothing turns.
        """


class UniformDirections(DirectionSampler):
    """Every direction is as likely, and has the same `radiance`."""

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
        return jnp.maximum(luminance(self.radiance), 0.0)


class ConstantEnvironment(Environment):
    """Light of the same RGB `radiance` (W / m^2 sr) from every direction. Raises ValueError for another shape."""

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
