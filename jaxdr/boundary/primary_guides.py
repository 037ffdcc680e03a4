"""Densities over the primary numbers of boundary segments (Yan et al. 2022, 4.1): what a guide is, and none."""

from typing import NamedTuple, Protocol

import jax.numpy as jnp
from jaxtyping import Array, Float


class Guide(Protocol):
    """A density over the unit cube that is drawn from, and known, exactly."""

    def sample(self, u: Float[Array, "n 4"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones."""
        ...

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Their density."""
        ...


class Unguided(NamedTuple):
    """The uniform density."""

    def sample(self, u: Float[Array, "n 4"]) -> Float[Array, "n 3"]:
        """The numbers themselves."""
        return u[:, :3]

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """One."""
        return jnp.ones_like(primary[:, 0])
