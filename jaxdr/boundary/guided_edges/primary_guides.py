"""Densities over the primary numbers of boundary segments (Yan et al. 2022, 4.1): protocol, no guide, and a grid."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.scene.sampling import search_sorted_rows

# Candidates for the share of segments that is drawn without the guide. With the least share, a segment where the guide
# is zero has ten times its unguided weight.
SHARES = 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0
COMPARED = 1 << 15  # evaluations of the target from which the share is chosen
BATCH = 1 << 16  # evaluations of the target at once

# The function that a guide's density should follow: primary numbers to values, not negative.
Target = Callable[[Float[Array, "n 3"]], Float[Array, " n"]]


@runtime_checkable
class Guide(Protocol):
    """A density over the unit cube, with exact sampling and an exact pdf. It may be zero in places; see `Defended`."""

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones. Well stratified numbers stay so as far as possible."""
        ...

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of primary numbers."""
        ...

    def refitted(self, target: Target, samples: int, key: PRNGKeyArray) -> "Guide":
        """The same boxes with densities that follow another target, from `samples` evaluations in each."""
        ...


class Defended(NamedTuple):
    """A guide, and the share of samples without it. These are the first samples, so that both parts stay stratified."""

    guide: Guide
    share: Float[Array, ""]

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones, all samples at once."""
        alone = jnp.arange(u.shape[0]) < self._alone(u.shape[0])
        return jnp.where(alone[:, None], u, self.guide.sample(u))

    def pdf(self, primary: Float[Array, "n 3"], count: int) -> Float[Array, " n"]:
        """Mean density over `count` samples: that of the balance heuristic."""
        share = self._alone(count) / count
        return share + (1 - share) * self.guide.pdf(primary)

    def _alone(self, count: int) -> Int[Array, ""]:
        return jnp.clip(jnp.round(self.share * count).astype(jnp.int32), 1, count)


def defended(guide: Guide, target: Target, key: PRNGKeyArray, dtype) -> Defended:
    """A guide, with the unguided share for which the second moment of target / density is least.

    The moment is estimated from new evaluations, half of them at the guide's own samples. So a guide that missed a part
    of the target is used little: it would add more noise than it takes away.
    """
    half = COMPARED // 2
    trial = Defended(guide, jnp.asarray(0.5, dtype))
    drawn = trial.sample(jax.random.uniform(key, (2 * half, 3), dtype))
    density, values = guide.pdf(drawn), evaluate(target, drawn)
    share = jnp.asarray(SHARES, dtype)[:, None]
    moment = (values**2 / (trial.pdf(drawn, 2 * half) * (share + (1 - share) * density))).mean(1)
    return Defended(guide, share[moment.argmin(), 0])


class Unguided(NamedTuple):
    """The uniform density."""

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """The numbers themselves."""
        return u

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """One."""
        return jnp.ones_like(primary[:, 0])

    def refitted(self, target: Target, samples: int, key: PRNGKeyArray) -> "Unguided":
        """There is nothing to fit."""
        return self


class Choice(NamedTuple):
    """Probabilities of K entries, in rows of about sqrt(K): in two short sums small probabilities stay exact."""

    rows: Float[Array, "1 R"]
    columns: Float[Array, "R C"]

    def sample(self, u: Float[Array, " n"]) -> tuple[Int[Array, " n"], Float[Array, " n"]]:
        """(entries, new uniform numbers from what the choice leaves of `u`)."""
        row, left = search_sorted_rows(self.rows, jnp.zeros(u.shape, jnp.int32), u)
        column, left = search_sorted_rows(self.columns, row, left)
        return row * self.columns.shape[1] + column, left

    def probability(self, entry: Int[Array, " n"]) -> Float[Array, " n"]:
        """The probabilities with which `sample` chooses entries."""
        row, column = jnp.divmod(entry, self.columns.shape[1])
        return _probability(self.rows, jnp.zeros_like(row), row) * _probability(self.columns, row, column)


def choice(weight: Float[Array, " K"]) -> Choice:
    """Probabilities in proportion to weights, which are not negative; uniform if all weights are zero."""
    count = weight.shape[0]
    columns = max(1, round(count**0.5))
    rows = jnp.pad(weight, (0, -count % columns)).reshape(-1, columns)
    return Choice(cumulative(rows.sum(1)[None]), cumulative(rows))


def cumulative(weight: Float[Array, "R K"]) -> Float[Array, "R K"]:
    """Cumulative probabilities in every row; uniform in a row whose weights are all zero."""
    weight = jnp.where(weight.sum(1, keepdims=True) > 0, weight, 1.0)
    total = jnp.cumsum(weight, axis=1)
    return total / total[:, -1:]


class Grid(NamedTuple):
    """A density that is constant in every cell of a regular grid over the unit cube (Zhang et al. 2020).

    The fields are cumulative probabilities along x, along y for every x, and along z for every x and y.
    """

    x: Float[Array, "1 X"]
    y: Float[Array, "X Y"]
    z: Float[Array, "XY Z"]

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones, by inversion axis by axis."""
        x, left_x = search_sorted_rows(self.x, jnp.zeros(u.shape[0], jnp.int32), u[:, 0])
        y, left_y = search_sorted_rows(self.y, x, u[:, 1])
        z, left_z = search_sorted_rows(self.z, x * self.y.shape[1] + y, u[:, 2])
        cell, left = jnp.stack([x, y, z], -1), jnp.stack([left_x, left_y, left_z], -1)
        return below_one((cell + left) / jnp.asarray(self._size, u.dtype))

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of primary numbers."""
        size = jnp.asarray(self._size)
        cell = jnp.clip(jnp.floor(primary * size).astype(jnp.int32), 0, size - 1)
        x, y, z = cell[:, 0], cell[:, 1], cell[:, 2]
        along_x = _probability(self.x, jnp.zeros_like(x), x)
        along_y = _probability(self.y, x, y)
        along_z = _probability(self.z, x * self.y.shape[1] + y, z)
        return along_x * along_y * along_z * size.prod()

    def refitted(self, target: Target, samples: int, key: PRNGKeyArray) -> "Grid":
        """The mean of the old density and of one from new evaluations: one may find what the other missed."""
        new = build_grid(target, self._size, samples, key)
        return grid_of(0.5 * (self.probabilities() + new.probabilities()))

    def probabilities(self) -> Float[Array, "X Y Z"]:
        """The probability of each cell."""
        x, y, z = (jnp.diff(cdf, axis=1, prepend=0.0) for cdf in (self.x, self.y, self.z))
        return x[0][:, None, None] * y[:, :, None] * z.reshape(self._size)

    @property
    def _size(self) -> tuple[int, int, int]:
        return self.x.shape[1], self.y.shape[1], self.z.shape[1]


def _probability(cdf: Float[Array, "R K"], row: Int[Array, " n"], entry: Int[Array, " n"]) -> Float[Array, " n"]:
    """Probabilities of entries in rows: differences of the same sums that `sample` searches."""
    flat, index = cdf.reshape(-1), row * cdf.shape[1] + entry
    return flat[index] - jnp.where(entry > 0, flat[index - 1], 0.0)


def below_one(u):
    """Keep numbers below 1, which rounding may reach."""
    return jnp.minimum(u, 1.0 - jnp.finfo(u.dtype).epsneg)


def grid_of(values: Float[Array, "X Y Z"]) -> Grid:
    """A grid whose density is in proportion to the values of its cells."""
    columns = values.reshape(-1, values.shape[2])
    rows = columns.sum(1).reshape(values.shape[:2])
    return Grid(cumulative(rows.sum(1)[None]), cumulative(rows), cumulative(columns))


def build_grid(target: Target, size: tuple[int, int, int], samples: int, key: PRNGKeyArray) -> Grid:
    """A grid of the means of `samples` random evaluations of the target in every cell."""
    lower = jnp.stack(jnp.meshgrid(*(jnp.arange(n) for n in size), indexing="ij"), -1).reshape(-1, 3)
    u = jax.random.uniform(key, (samples, *lower.shape))
    points = ((lower + u) / jnp.asarray(size)).reshape(-1, 3)
    values = evaluate(target, points).reshape(samples, *size).mean(0)
    return grid_of(values)


def evaluate(target: Target, points: Float[Array, "n 3"]) -> Float[Array, " n"]:
    """The target at many points, in batches."""
    count = points.shape[0]
    batches = -(-count // BATCH)
    size = -(-count // batches)
    padded = jnp.pad(points, ((0, batches * size - count), (0, 0)))
    return jax.lax.map(target, padded.reshape(batches, size, 3)).reshape(-1)[:count]
