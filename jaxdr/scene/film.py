"""Film: resolution, crop window and reconstruction filter.

A reconstruction filter is a separable probability density over film offsets, in pixels. The image is the
expectation of the radiance at a film point drawn from the filter centred on the pixel, so no sample is
weighted and pixels at the border see beyond the film (Mitsuba's ``sample_border``).
"""

import math
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtri
from jaxtyping import Array, Float

from jaxdr.argument_kinds import checked


@runtime_checkable
class ReconstructionFilter(Protocol):
    """A separable density over film offsets, per square pixel: `sample` draws offsets from `pdf`.

    - `radius` and standard deviation `stddev`, in pixels.
    - `smooth`: whether the derivative of log `pdf` has finite variance, so that first hits can be material points.
    - `tiles`: whether `pdf` is constant on its own pixel and zero elsewhere.
    """

    @property
    def radius(self) -> float: ...

    @property
    def stddev(self) -> float: ...

    @property
    def tiles(self) -> bool: ...

    @property
    def smooth(self) -> bool: ...

    def sample(self, u: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]: ...

    def pdf(self, offset: Float[Array, "*n 2"]) -> Float[Array, "*n"]: ...


@checked
class Gaussian(eqx.Module):
    """Gaussian pixel filter, the default. It is cut off at four standard deviations, as in Mitsuba.

    `stddev` is in pixels. Raises ValueError unless it is positive.
    """

    stddev: float = eqx.field(static=True, default=0.5)

    def __check_init__(self):
        if not self.stddev > 0:
            raise ValueError(f"Gaussian: stddev must be positive (pixels), got {self.stddev}")

    @property
    def radius(self) -> float:
        return 4.0 * self.stddev

    @property
    def smooth(self) -> bool:
        return True

    @property
    def tiles(self) -> bool:
        return False

    def sample(self, u):
        """Film offsets [..., 2] (pixels) from uniform numbers, by inversion of the cut normal distribution."""
        tail = 0.5 * math.erfc(4.0 / math.sqrt(2.0))
        return self.stddev * ndtri(tail + (1.0 - 2.0 * tail) * u)

    def pdf(self, offset):
        """Density per square pixel at film offsets [..., 2]; zero outside the cut."""
        inside = (jnp.abs(offset) <= self.radius).all(-1)
        mass = math.erf(4.0 / math.sqrt(2.0)) ** 2
        value = jnp.exp(-0.5 * (offset**2).sum(-1) / self.stddev**2) / (2 * math.pi * self.stddev**2 * mass)
        return jnp.where(inside, value, 0.0)


@checked
class Box(eqx.Module):
    """Box pixel filter: constant within `radius` pixels. The default, 0.5, covers one pixel.

    Raises ValueError unless the radius is positive.
    """

    radius: float = eqx.field(static=True, default=0.5)

    def __check_init__(self):
        if not self.radius > 0:
            raise ValueError(f"Box: radius must be positive (pixels), got {self.radius}")

    @property
    def stddev(self) -> float:
        return self.radius / math.sqrt(3.0)

    @property
    def smooth(self) -> bool:
        return False

    @property
    def tiles(self) -> bool:
        return self.radius == 0.5

    def sample(self, u):
        """Film offsets [..., 2] (pixels) from uniform numbers."""
        return self.radius * (2.0 * u - 1.0)

    def pdf(self, offset):
        """Density per square pixel at film offsets [..., 2]; half open, so that boxes tile the film."""
        inside = ((offset >= -self.radius) & (offset < self.radius)).all(-1)
        return jnp.where(inside, 1.0 / (2.0 * self.radius) ** 2, 0.0)


@checked
class Tent(eqx.Module):
    """Tent pixel filter: it falls linearly to zero at `radius` pixels.

    Raises ValueError unless the radius is positive.
    """

    radius: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        if not self.radius > 0:
            raise ValueError(f"Tent: radius must be positive (pixels), got {self.radius}")

    @property
    def stddev(self) -> float:
        return self.radius / math.sqrt(6.0)

    @property
    def smooth(self) -> bool:
        return False

    @property
    def tiles(self) -> bool:
        return False

    def sample(self, u):
        """Film offsets [..., 2] (pixels) from uniform numbers, by inversion of the triangular distribution."""
        lower = u < 0.5
        root = jnp.sqrt(jnp.where(lower, 2.0 * u, 2.0 * (1.0 - u)))
        return self.radius * jnp.where(lower, root - 1.0, 1.0 - root)

    def pdf(self, offset):
        """Density per square pixel at film offsets [..., 2]."""
        return (jnp.maximum(1.0 - jnp.abs(offset) / self.radius, 0.0) / self.radius).prod(-1)


@checked
class Film(eqx.Module):
    """The pixels of an image: `width` x `height`, and the pixel filter.

    `crop` = (x0, y0, width, height) renders a window of them. Film points are in pixels, from the top left corner of
    the uncropped film. Raises ValueError for a film without pixels, and for a window that does not lie inside.
    """

    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    filter: ReconstructionFilter = eqx.field(static=True, default=Gaussian())
    crop: tuple[int, int, int, int] | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Film: width and height must be at least 1 pixel, got {self.width} x {self.height}")
        x0, y0, width, height = self.window
        if width < 1 or height < 1 or x0 < 0 or y0 < 0 or x0 + width > self.width or y0 + height > self.height:
            raise ValueError(f"Film: crop {self.crop} does not lie inside {self.width} x {self.height} pixels")

    @property
    def window(self) -> tuple[int, int, int, int]:
        """The rendered window (x0, y0, width, height) in pixels."""
        return self.crop or (0, 0, self.width, self.height)
