"""How a parameter of the scene depends on the numbers that are optimised.

Every parametrisation starts at some latent numbers, turns latent numbers into a value of the parameter, differentiably,
and has an optax transformation for Adam.
"""

import abc
import math
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float

from jaxdr.geometry.mesh import Mesh
from jaxdr.geometry.rotation import rotation_matrix
from jaxdr.optimize.adam import adam_uniform
from jaxdr.optimize.preconditioner import LargeSteps


class Parametrization(eqx.Module):
    """A parameter as a function of latent numbers."""

    @abc.abstractmethod
    def start(self) -> Float[Array, "*n"]:
        """Latent numbers at the start."""

    @abc.abstractmethod
    def value(self, latent: Float[Array, "*n"]) -> Float[Array, "*m"]:
        """Value of the parameter."""

    def adam(self, learning_rate: optax.ScalarOrSchedule) -> optax.GradientTransformation:
        """The optax transformation that moves the latent numbers."""
        return optax.adam(learning_rate)


class Plain(Parametrization):
    """The parameter itself."""

    initial: Float[Array, "*n"]

    def start(self):
        return self.initial

    def value(self, latent):
        return latent


class Bounded(Parametrization):
    """low + (high - low) / (1 + exp(-latent)): always strictly between the bounds.

    Raises ValueError unless the bounds increase and the initial value lies strictly between them.
    """

    initial: Float[Array, "*n"]
    bounds: tuple[float, float] = eqx.field(static=True)

    def __check_init__(self):
        low, high = self.bounds
        if not low < high:
            raise ValueError(f"bounds: must be two increasing numbers, got {[low, high]}")
        least, most = float(self.initial.min()), float(self.initial.max())
        if not low < least <= most < high:
            span = f"{least:g}" if least == most else f"{least:g} to {most:g}"
            raise ValueError(f"initial: must lie strictly between the bounds {low:g} and {high:g}, is {span}")

    def start(self):
        low, high = self.bounds
        share = (self.initial - low) / (high - low)
        return jnp.log(share) - jnp.log1p(-share)

    def value(self, latent):
        low, high = self.bounds
        return low + (high - low) * jax.nn.sigmoid(latent)


class Smoothed(Parametrization):
    """Vertices in the latent coordinates of `LargeSteps`, moved by `adam_uniform`."""

    initial: Float[Array, "V 3"]
    steps: LargeSteps

    def __init__(self, mesh: Mesh, smoothing: float):
        self.initial = mesh.vertices
        self.steps = LargeSteps(mesh, smoothing)

    def start(self):
        return self.steps.to_latent(self.initial)

    def value(self, latent):
        return self.steps.from_latent(latent)

    def adam(self, learning_rate):
        return adam_uniform(learning_rate)


class Motion(Parametrization):
    """A motion of a matrix [4, 4] or of vertices [V, 3] from where the scene has them, in world space.

    "rigid" is a rotation vector (radians) and a translation (scene units), "rotation" and "translation" one of them,
    "angle" (radians) one number about `axis`. Turns are about the translation of the matrix, or the centre of the
    vertices' bounding box. `offset` is where the latent numbers start.
    """

    rest: Float[Array, "n m"]
    offset: Float[Array, " k"]
    axis: tuple[float, float, float] = eqx.field(static=True)
    kind: str = eqx.field(static=True)

    COUNTS: ClassVar[dict[str, int]] = {"rigid": 6, "rotation": 3, "translation": 3, "angle": 1}

    def start(self):
        return self.offset

    def value(self, latent):
        turn, shift = jnp.zeros(3, latent.dtype), jnp.zeros(3, latent.dtype)
        if self.kind == "angle":
            axis = np.asarray(self.axis) / np.linalg.norm(self.axis)
            turn = latent[0] * jnp.asarray(axis, latent.dtype)
        elif self.kind == "translation":
            shift = latent
        else:
            turn, shift = latent[:3], latent[3:] if self.kind == "rigid" else shift
        rotation = rotation_matrix(turn)
        if self.rest.shape == (4, 4):
            moved = self.rest.at[:3, :3].set(rotation @ self.rest[:3, :3])
            return moved.at[:3, 3].add(shift)
        centre = (self.rest.min(0) + self.rest.max(0)) / 2
        return (self.rest - centre) @ rotation.T + centre + shift


def angle_between(first: Float[np.ndarray, "4 4"], second: Float[np.ndarray, "4 4"]) -> float:
    """Angle in degrees of the rotation between the frames of two matrices, whatever their scales."""
    a, b = (np.asarray(m, np.float64)[:3, :3] for m in (first, second))
    a, b = a / np.linalg.norm(a[:, 0]), b / np.linalg.norm(b[:, 0])
    return 2 * math.degrees(math.asin(min(np.linalg.norm(a - b) / math.sqrt(8), 1.0)))
