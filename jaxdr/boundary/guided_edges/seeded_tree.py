"""Trees over the primary numbers of boundary segments, built around seeds: points at which the target is positive.

Every node is divided at the median of its seeds, along the axis in which they extend furthest. So all leaves hold about
as many seeds. The target may be positive in a millionth of the unit cube only. Then a leaf's cell is mostly empty, so
samples are drawn from a box around the leaf's seeds, and a small share from the whole cell. Boxes do not overlap and
cells do not overlap. So the density is known exactly.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.boundary.guided_edges.primary_guides import SHARES, Choice, Defended, Target, below_one, choice, evaluate
from jaxdr.safe_divide import safe_divide
from jaxdr.transport.sampler import lattice, uniform

AROUND = 0.1  # share of a leaf's samples that is drawn from its whole cell
SEARCH = 0.5  # the same share while more seeds are searched
GAPS = 4.0  # a box reaches beyond its seeds by so many mean distances of seeds
SEEDS = 32  # for each leaf, of each origin: given, evenly spread, drawn from the tree
ALONG = 2 / 3  # extents along the edges are scaled by this power of their number: the target jumps from edge to edge
MOST = 0.7  # a box that takes this share of its cell along an axis takes the whole axis
ROUNDS = 2  # of drawing more seeds from the tree so far
BLUR = 2.0**-13  # seeds move at random by up to so much: then boxes have a width in float32, and no two seeds coincide


class SeededTree(NamedTuple):
    """A complete binary tree of L leaves; node i has the children 2 i + 1 and 2 i + 2.

    A node is divided at `split` along its `axis`. The leaves' cells, from `cell_lower` to `cell_upper`, fill the unit
    cube. A leaf's box, from `lower` to `upper`, lies in its cell. The share `around` of a leaf's samples is drawn from
    its cell, the rest from its box.
    """

    axis: Int[Array, " N"]
    split: Float[Array, " N"]
    cell_lower: Float[Array, "L 3"]
    cell_upper: Float[Array, "L 3"]
    lower: Float[Array, "L 3"]
    upper: Float[Array, "L 3"]
    leaves: Choice
    around: Float[Array, ""]

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones: choose a leaf by its mass, then a point of its box or its cell."""
        leaf, left = self.leaves.sample(u[:, 0])
        around = left < self.around
        left = jnp.where(around, left / self.around, (left - self.around) / (1 - self.around))
        lower = jnp.where(around[:, None], self.cell_lower[leaf], self.lower[leaf])
        upper = jnp.where(around[:, None], self.cell_upper[leaf], self.upper[leaf])
        point = lower + jnp.stack([left, u[:, 1], u[:, 2]], -1) * (upper - lower)
        # Rounding may put a point on the upper side, which belongs to the next leaf.
        return jnp.minimum(point, upper * below_one(jnp.ones_like(upper)))

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of primary numbers."""
        leaf = self.find(primary)
        lower, upper = self.lower[leaf], self.upper[leaf]
        inside = ((primary >= lower) & (primary < upper)).all(-1)
        density = jnp.where(inside, (1 - self.around) * _over_volume(lower, upper), 0.0)
        density += self.around * _over_volume(self.cell_lower[leaf], self.cell_upper[leaf])
        return self.leaves.probability(leaf) * density

    def refitted(self, target: Target, samples: int, key: PRNGKeyArray) -> "SeededTree":
        """The same boxes, with the masses of another target."""
        squares = _squares(target, self.lower, self.upper, samples, key)
        mass = (self.upper - self.lower).prod(-1) * jnp.sqrt(squares / samples)
        whole = (self.cell_upper - self.cell_lower).prod(-1)
        return self._replace(leaves=choice(jnp.where(mass.sum() > 0, mass, whole)))

    def find(self, primary: Float[Array, "n 3"]) -> Int[Array, " n"]:
        """The leaves that points lie in."""
        levels = (self.split.shape[0] + 1).bit_length() - 1

        def descend(_, node):
            along = jnp.take_along_axis(primary, self.axis[node][:, None], 1)[:, 0]
            return 2 * node + 1 + (along >= self.split[node])

        node = loops.fori_loop(0, levels, descend, jnp.zeros(primary.shape[0], jnp.int32))
        return node - self.split.shape[0]


def _over_volume(lower, upper):
    volume = (upper - lower).prod(-1)
    return safe_divide(1.0, volume, otherwise=0.0)


def build_seeded_tree(
    target: Target,
    seeds: Float[Array, "n 3"],
    usable: Bool[Array, " n"],
    edges: int,
    leaves: int,
    samples: int,
    key: PRNGKeyArray,
) -> SeededTree:
    """A tree of `leaves` (a power of two, at least 2) around the `usable` seeds at which the target is positive.

    The first primary number runs over so many `edges`. Evenly spread points are tried as seeds, too, and then points
    drawn from the tree so far. A leaf's mass is its box's volume times the root mean square of the target, over
    `samples` evaluations in the box and the values at the seeds.
    """
    scale = edges ** jnp.asarray([ALONG, 0.0, 0.0])
    count, dtype = SEEDS * leaves, seeds.dtype
    key_even, key_drawn, *keys = jax.random.split(key, 6)
    even = lattice(key_even, 1, jnp.arange(count), 4, dtype)[:, :3]
    points = _moved(jnp.concatenate([seeds, even]), keys[0])
    tried = jnp.concatenate([usable, jnp.ones(count, bool)])
    least = jnp.asarray(SHARES[0], dtype)
    values = jnp.where(tried, evaluate(target, points), 0.0)
    for key_round in jax.random.split(key_drawn, ROUNDS):
        key_tree, key_shift = jax.random.split(key_round)
        tree = _grown(target, points, values, scale, leaves, samples, key_tree)
        tree = tree._replace(around=jnp.asarray(SEARCH, dtype))
        drawn = Defended(tree, least).sample(lattice(key_shift, 1, jnp.arange(count), 4, dtype)[:, :3])
        points, values = jnp.concatenate([points, drawn]), jnp.concatenate([values, evaluate(target, drawn)])
    return _grown(target, points, values, scale, leaves, samples, keys[1])


def _moved(points, key):
    moved = points + BLUR * (2.0 * uniform(key, points.shape, points.dtype) - 1.0)
    return below_one(jnp.clip(moved, 0.0, 1.0))


def _grown(target: Target, points, values, scale, leaves: int, samples: int, key) -> SeededTree:
    """The tree around those points whose value is positive."""
    levels = leaves.bit_length() - 1
    real, slots = values > 0, jnp.arange(leaves)

    def extents(slot):
        """(number, lowest, highest coordinates) of the seeds in every slot; other points have the slot `leaves`."""
        number = jax.ops.segment_sum(real.astype(jnp.int32), slot, leaves)
        return number, jax.ops.segment_min(points, slot, leaves), jax.ops.segment_max(points, slot, leaves)

    def divide(state, _):
        slot, lower, upper = state
        number, least, most = extents(slot)
        several = number >= 2
        axis = (jnp.where(several[:, None], most - least, upper - lower) * scale).argmax(-1)
        along = jnp.take_along_axis(points, axis[jnp.minimum(slot, leaves - 1)][:, None], 1)[:, 0]
        ordered = along[jnp.lexsort((along, slot))]
        middle = jnp.cumsum(number) - number + number // 2
        median = 0.5 * (ordered[jnp.maximum(middle - 1, 0)] + ordered[jnp.minimum(middle, along.shape[0] - 1)])
        centre = jnp.take_along_axis(0.5 * (lower + upper), axis[:, None], 1)[:, 0]
        split = jnp.where(several, median, centre)
        above = along >= split[jnp.minimum(slot, leaves - 1)]
        slot = jnp.where(real, 2 * slot + above, leaves)
        parent, second = slots // 2, slots % 2 == 1
        divided = jnp.arange(3) == axis[parent][:, None]
        lower = jnp.where(divided & second[:, None], split[parent][:, None], lower[parent])
        upper = jnp.where(divided & ~second[:, None], split[parent][:, None], upper[parent])
        return (slot, lower, upper), (axis, split)

    start = jnp.where(real, 0, leaves), jnp.zeros((leaves, 3), points.dtype), jnp.ones((leaves, 3), points.dtype)
    (slot, cell_lower, cell_upper), (axis, split) = loops.scan(divide, start, None, levels)
    axis, split = (jnp.concatenate([a[level, : 1 << level] for level in range(levels)]) for a in (axis, split))

    number, least, most = extents(slot)
    several = (number >= 2)[:, None]
    beyond = GAPS * (most - least) / jnp.maximum(number - 1, 1)[:, None]
    lower, upper = jnp.maximum(least - beyond, cell_lower), jnp.minimum(most + beyond, cell_upper)
    fills = ~several | (upper - lower > MOST * (cell_upper - cell_lower))
    lower, upper = jnp.where(fills, cell_lower, lower), jnp.where(fills, cell_upper, upper)
    squares = _squares(target, lower, upper, samples, key) + jax.ops.segment_sum(values**2, slot, leaves)
    volume, whole = (upper - lower).prod(-1), (cell_upper - cell_lower).prod(-1)
    mass = volume * jnp.sqrt(squares / (samples + number))
    leaf = choice(jnp.where(mass.sum() > 0, mass, whole))
    share = jnp.asarray(AROUND, points.dtype)
    return SeededTree(axis, split, cell_lower, cell_upper, lower, upper, leaf, share)


def _squares(target: Target, lower, upper, samples: int, key) -> Float[Array, " L"]:
    """Sums of the squares of `samples` random evaluations in boxes."""
    u = uniform(key, (lower.shape[0], samples, 3), lower.dtype)
    points = lower[:, None] + u * (upper - lower)[:, None]
    return (evaluate(target, points.reshape(-1, 3)).reshape(-1, samples) ** 2).sum(1)
