"""Kd-trees over the primary numbers of boundary segments, with trilinear fits in their leaves (Yan et al. 2022, 4.1).

Algorithm 1, breadth first: every round splits a fixed number of leaves, those of the largest errors. So all array
shapes are static. If the budget of leaves does not suffice for the threshold, the guide is coarser. Samples are drawn
from the fit itself, so that their density is known exactly. The fit is at least a share of the leaf's mean.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr import loops
from jaxdr.boundary.guided_edges.primary_guides import Choice, Target, below_one, choice, evaluate
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.sampling import linear
from jaxdr.transport.compaction import rows_where

ROUNDS = 10  # of splitting leaves
LEAST = 0.1  # smallest value of a fit, as a share of the leaf's mean


class Leaves(NamedTuple):
    """Boxes of n nodes and their fits.

    - `level`: mean of the fit.
    - `corners`: the fit at the corners over `level` (z fastest); ones where the level is zero.
    - `error`: root mean square of the residuals times the volume.
    """

    lower: Float[Array, "*n 3"]
    upper: Float[Array, "*n 3"]
    level: Float[Array, "*n"]
    corners: Float[Array, "*n 8"]
    error: Float[Array, "*n"]

    def mass(self) -> Float[Array, "*n"]:
        """Integrals of the fits over the boxes."""
        return self.volume() * self.level

    def volume(self) -> Float[Array, "*n"]:
        """Volumes of the boxes."""
        return (self.upper - self.lower).prod(-1)


class KdTree(NamedTuple):
    """Trees over intervals of the first primary number, one root for each interval. All nodes are in one table.

    A node's children are `first` and `first` + 1; they halve the node along its `axis`. `first` of a leaf is -1.
    `borders` are the lower ends of the roots' intervals. `leaves` chooses among the leaves.
    """

    nodes: Leaves
    first: Int[Array, " N"]
    axis: Int[Array, " N"]
    borders: Float[Array, " R"]
    leaves: Choice

    def sample(self, u: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Primary numbers from uniform ones: choose a leaf by its mass, then invert its fit axis by axis."""
        node, left = self.leaves.sample(u[:, 0])
        corners = self.nodes.corners[node]
        x = linear(left, corners[:, :4].mean(-1), corners[:, 4:].mean(-1))
        corners = corners[:, :4] + x[:, None] * (corners[:, 4:] - corners[:, :4])
        y = linear(u[:, 1], corners[:, :2].mean(-1), corners[:, 2:].mean(-1))
        corners = corners[:, :2] + y[:, None] * (corners[:, 2:] - corners[:, :2])
        z = linear(u[:, 2], corners[:, 0], corners[:, 1])
        lower, upper = self.nodes.lower[node], self.nodes.upper[node]
        return below_one(lower + jnp.stack([x, y, z], -1) * (upper - lower))

    def pdf(self, primary: Float[Array, "n 3"]) -> Float[Array, " n"]:
        """Density of primary numbers."""
        node = self.find(primary)
        lower, upper, corners = self.nodes.lower[node], self.nodes.upper[node], self.nodes.corners[node]
        size = upper - lower
        there = size.prod(-1) > 0
        x = safe_divide(primary - lower, size, there[:, None])
        value = safe_divide((_basis(x) * corners).sum(-1), size.prod(-1), there)
        return jnp.where(there, self.leaves.probability(node) * value, 0.0)

    def refitted(self, target: Target, samples: int, key: PRNGKeyArray) -> "KdTree":
        """The same leaves, fitted to another target."""
        capacity, roots = self.first.shape[0], self.borders.shape[0]
        parent = self.first >= 0
        used = jnp.arange(capacity) < roots
        for child in (self.first, self.first + 1):
            used = used.at[jnp.where(parent, child, capacity)].set(True, mode="drop")
        leaf = used & ~parent
        slots = rows_where(leaf, (capacity + roots) // 2, capacity)
        fitted = fit(target, self.nodes.lower[slots], self.nodes.upper[slots], samples)
        nodes = jax.tree.map(lambda a, new: a.at[slots].set(new, mode="drop"), self.nodes, fitted)
        return self._replace(nodes=nodes, leaves=_leaf_choice(nodes, leaf))

    def find(self, primary: Float[Array, "n 3"]) -> Int[Array, " n"]:
        """The leaves that points lie in."""
        node = jnp.clip(jnp.searchsorted(self.borders, primary[:, 0], side="right") - 1, 0, self.borders.shape[0] - 1)

        def descend(_, node):
            axis = self.axis[node]
            middle = _middle(self.nodes.lower[node], self.nodes.upper[node])
            above = jnp.take_along_axis(primary >= middle, axis[:, None], 1)[:, 0]
            first = self.first[node]
            return jnp.where(first >= 0, first + above, node)

        return loops.fori_loop(0, ROUNDS, descend, node)


def _middle(lower, upper):
    return 0.5 * (lower + upper)


def _basis(x) -> Float[Array, "*n 8"]:
    """Trilinear basis functions of the corners of the unit cube."""
    parts = [jnp.stack([1.0 - x[..., k], x[..., k]], -1) for k in range(3)]
    outer = parts[0][..., :, None, None] * parts[1][..., None, :, None] * parts[2][..., None, None, :]
    return outer.reshape(*x.shape[:-1], 8)


def build_kdtree(target: Target, borders: Float[Array, " R1"], leaves: int, samples: int, threshold: float) -> KdTree:
    """Fit the target with `samples` evaluations a node.

    `borders` are those of the roots' intervals, 0 and 1 included. A node is split while there are fewer than `leaves`
    leaves, and while its error is above `threshold` times a mean error. That mean is the error of each of `leaves`
    leaves, if all errors add up to the mass.
    """
    roots = borders.shape[0] - 1
    lower = jnp.zeros((roots, 3), borders.dtype).at[:, 0].set(borders[:-1])
    upper = jnp.ones((roots, 3), borders.dtype).at[:, 0].set(borders[1:])
    count = max(1, (leaves - roots) // ROUNDS)
    capacity = roots + 2 * count * ROUNDS
    nodes = jax.tree.map(
        lambda a: jnp.zeros((capacity, *a.shape[1:]), a.dtype).at[:roots].set(a), fit(target, lower, upper, samples)
    )
    first, axis = jnp.full(capacity, -1), jnp.zeros(capacity, jnp.int32)
    used = jnp.arange(capacity) < roots

    def step(state, start):
        nodes, first, axis, used = state
        error = jnp.where(used & (first < 0), nodes.error, -1.0)
        worst, chosen = jax.lax.top_k(error, count)
        whole = jnp.where(used & (first < 0), nodes.mass(), 0.0).sum()
        split = worst > threshold * whole / leaves
        lower, upper = nodes.lower[chosen], nodes.upper[chosen]
        middle, unit = _middle(lower, upper)[:, None], jnp.eye(3, dtype=bool)
        # [node, axis, half, 3]
        low = jnp.stack([jnp.broadcast_to(lower[:, None], (count, 3, 3)), jnp.where(unit, middle, lower[:, None])], 2)
        high = jnp.stack([jnp.where(unit, middle, upper[:, None]), jnp.broadcast_to(upper[:, None], (count, 3, 3))], 2)
        halves = fit(target, low, high, samples)
        along = halves.error.sum(-1).argmax(-1)
        halves = jax.tree.map(lambda a: a[jnp.arange(count), along].reshape(2 * count, *a.shape[3:]), halves)
        nodes = jax.tree.map(lambda t, a: jax.lax.dynamic_update_slice_in_dim(t, a, start, 0), nodes, halves)
        child = start + 2 * jnp.arange(count)
        first = first.at[chosen].set(jnp.where(split, child, first[chosen]))
        axis = axis.at[chosen].set(along.astype(jnp.int32))
        used = jax.lax.dynamic_update_slice_in_dim(used, jnp.repeat(split, 2), start, 0)
        return (nodes, first, axis, used), None

    starts = roots + 2 * count * jnp.arange(ROUNDS)
    nodes, first, axis, used = loops.scan(step, (nodes, first, axis, used), starts)[0]
    leaf = used & (first < 0)
    return KdTree(nodes, first, axis, borders[:-1], _leaf_choice(nodes, leaf))


def fit(target: Target, lower: Float[Array, "*n 3"], upper: Float[Array, "*n 3"], samples: int) -> Leaves:
    """Trilinear fits of the target in boxes, least squares of `samples` evaluations in each."""
    pattern = _pattern(samples)
    with jax.ensure_compile_time_eval():
        basis = np.asarray(_basis(jnp.asarray(pattern)), float)
    inverse, pattern, basis = (jnp.asarray(a, lower.dtype) for a in (np.linalg.pinv(basis), pattern, basis))
    points = lower[..., None, :] + pattern * (upper - lower)[..., None, :]
    values = evaluate(target, points.reshape(-1, 3)).reshape(*lower.shape[:-1], samples)
    corners = values @ inverse.T
    left = values - corners @ basis.T
    error = jnp.sqrt((left**2).mean(-1)) * (upper - lower).prod(-1)
    corners = jnp.maximum(corners, LEAST * values.mean(-1, keepdims=True))
    level = corners.mean(-1)
    corners = jnp.where(level[..., None] > 0, corners / jnp.where(level > 0, level, 1.0)[..., None], 1.0)
    return Leaves(lower, upper, level, corners, error)


def _leaf_choice(nodes: Leaves, leaf: Bool[Array, " N"]) -> Choice:
    """A choice of leaves by their mass; by their volume if all masses are zero."""
    mass, volume = jnp.where(leaf, nodes.mass(), 0.0), jnp.where(leaf, nodes.volume(), 0.0)
    return choice(jnp.where(mass.sum() > 0, mass, volume))


def _pattern(samples: int) -> Float[np.ndarray, "n 3"]:
    """Points that fill the unit cube evenly: Roberts' sequence (2018)."""
    root = 1.2207440846057596
    return (0.5 + np.arange(1, samples + 1)[:, None] * root ** -np.arange(1.0, 4.0)) % 1.0


def root_borders(cdf: Float[Array, " E"], most: int) -> Float[Array, " R1"]:
    """Borders of the intervals of edges or, if there are more than `most` edges, of runs of edges of equal number."""
    run = -(-cdf.shape[0] // most)
    ends = cdf[run - 1 :: run]
    return jnp.concatenate([jnp.zeros(1, cdf.dtype), ends[: -(-cdf.shape[0] // run) - 1], jnp.ones(1, cdf.dtype)])
