"""Emitters: surfaces that glow, and the constant environment."""

import equinox as eqx
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxdr.scene.color import as_rgb


class AreaEmitter(eqx.Module):
    """Emits RGB `radiance` (W / m^2 sr) from the side of the surface its normal points to."""

    radiance: Float[Array, "3"]

    def __init__(self, radiance: ArrayLike):
        self.radiance = as_rgb(radiance, "AreaEmitter: radiance")


class ConstantEnvironment(eqx.Module):
    """The same RGB `radiance` from every direction."""

    radiance: Float[Array, "3"]

    def __init__(self, radiance: ArrayLike = 1.0):
        self.radiance = as_rgb(radiance, "ConstantEnvironment: radiance")
