"""How long paths have to be. A pilot of long paths measures light and its derivative by the number of segments."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxdr.compilation import jit
from jaxdr.plan.directions import Direction
from jaxdr.scene.packed import pack
from jaxdr.scene.scene import Scene
from jaxdr.transport.depths import radiance_by_depth
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples

DEEPEST = 16  # segments of the pilot's paths
KEYS, SAMPLES = 8, 4  # independent calls, and samples per pixel of each


class Share(NamedTuple):
    """The share that paths of `max_depth` 1, 2, …, D leave out (`rest`), and its standard error."""

    rest: Float[np.ndarray, " D"]
    error: Float[np.ndarray, " D"]


class DepthChoice(NamedTuple):
    """The smallest `max_depth` that leaves out no more than `tolerance`; `reached` is False if noise hides that.

    `energy` is the share of the light, and `gradient` that of the derivative's interior term, or None if that is all
    noise.
    """

    max_depth: int
    tolerance: float
    reached: bool
    energy: Share
    gradient: Share | None

    def line(self) -> str:
        """One line that says why."""
        index, deepest = self.max_depth - 1, len(self.energy.rest)
        left = f"{self.energy.rest[index]:.1%} of the light"
        if self.gradient is not None:
            left += f" and {self.gradient.rest[index]:.1%} of the derivative"
        else:
            left += " (the interior derivative is too small to tell)"
        what = f"depth: {self.max_depth} segments; longer paths, up to {deepest}, carry {left}"
        if self.reached:
            return f"{what}, within {self.tolerance:.1%}"
        return f"{what}; the pilot's noise hides whether that is within {self.tolerance:.1%}"


def choose_depth(scene: Scene, along: Direction, tolerance: float, key: PRNGKeyArray) -> DepthChoice:
    """Measure the shares and choose a depth. Raises ValueError for a tolerance that is not positive."""
    if not tolerance > 0:
        raise ValueError(f"plan: depth_tolerance must be positive (a share), got {tolerance}")

    @jit
    def program(scene, along, key):
        def images(t):
            return images_by_depth(along.at(scene, t), key)

        return jax.jvp(images, (jnp.zeros(()),), (jnp.ones(()),))

    found = [jax.tree.map(np.asarray, program(scene, along, k)) for k in jax.random.split(key, KEYS)]
    values, derivatives = (np.stack(part).astype(np.float64) for part in zip(*found, strict=True))
    return depth_choice(energy_share(values), derivative_share(derivatives), tolerance)


def images_by_depth(scene: Scene, key: PRNGKeyArray) -> Float[Array, "D H W 3"]:
    """Images of the light of paths of exactly 1, 2, …, `DEEPEST` segments, with few samples."""
    packed = pack(scene)
    _, _, width, height = packed.camera.film.window
    key_film, key_path = jax.random.split(key)
    settings = PathSettings(DEEPEST, True, "auto")
    primary = primary_samples(packed, jnp.arange(SAMPLES), key_film, settings.rays, Form.FIXED)
    rows = radiance_by_depth(packed, primary.first, primary.direction, primary.u, key_path, settings)
    return rows.reshape(DEEPEST, height, width, SAMPLES, 3).mean(3)


def energy_share(images: Float[np.ndarray, "K D H W 3"]) -> Share:
    """The share of the image's mean that longer paths add."""
    by_depth = images.mean((2, 3, 4))
    total = by_depth.sum(1).mean()
    if not total > 0:
        return Share(np.zeros(by_depth.shape[1]), np.zeros(by_depth.shape[1]))
    rest = _after(by_depth) / total
    return Share(rest.mean(0), rest.std(0, ddof=1) / math.sqrt(len(rest)))


def derivative_share(images: Float[np.ndarray, "K D H W 3"]) -> Share | None:
    """Root mean square of what longer paths add to the derivative image, relative to that of the whole image.

    Products of independent calls estimate the squares, so that noise adds nothing. It is None if the square of the
    whole image is within two standard errors of zero.
    """
    rest = _after(images)
    whole, whole_error = _square(images.sum(1)[:, None])
    if not whole[0] > 2.0 * whole_error[0]:
        return None
    square, error = _square(rest)
    size = np.sqrt(np.maximum(square, 0.0) / whole[0])
    above = np.sqrt(np.maximum(square + error, 0.0) / whole[0])
    return Share(size, above - size)


def depth_choice(energy: Share, gradient: Share | None, tolerance: float) -> DepthChoice:
    """The smallest depth that leaves out no more than the tolerance.

    A standard error is added to what it leaves out. If no depth fits then, it is not added.
    """
    shares = [energy] if gradient is None else [energy, gradient]
    for errors in (1.0, 0.0):
        fits = np.all([share.rest + errors * share.error <= tolerance for share in shares], axis=0)
        fits[-1] = False  # the pilot knows nothing about deeper paths
        if fits.any():
            return DepthChoice(int(fits.argmax()) + 1, tolerance, errors > 0, energy, gradient)
    return DepthChoice(len(energy.rest), tolerance, False, energy, gradient)


def _after(rows: Float[np.ndarray, "K D *rest"]) -> Float[np.ndarray, "K D *rest"]:
    """For every depth the sum over all larger depths."""
    return rows[:, ::-1].cumsum(1)[:, ::-1] - rows


def _square(values: Float[np.ndarray, "K D *rest"]) -> tuple[np.ndarray, np.ndarray]:
    """(mean square of the expected values, its standard error by the jackknife over calls), from pairs of calls."""
    axes = tuple(range(2, values.ndim))

    def pairs(some):
        count = len(some)
        products = (some.sum(0) ** 2 - (some**2).sum(0)) / (count * (count - 1))
        return products.mean(tuple(axis - 1 for axis in axes))

    count = len(values)
    without = np.stack([pairs(np.delete(values, k, 0)) for k in range(count)])
    error = np.sqrt((count - 1) / count * ((without - without.mean(0)) ** 2).sum(0))
    return pairs(values), error
