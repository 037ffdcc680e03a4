"""Chains of boundary segments whose density is in proportion to their light (Metropolis et al. 1953; Hastings 1970).

They start without bias, as in Metropolis light transport (Veach 1997, chapter 11.3). Seeds x with known densities p are
drawn, and chains start at seeds that are chosen in proportion to w = f(x) / p(x). All chains have the mean of w as
their weight, which estimates the integral b of f. Then b h(x) / f(x) at any later state x is an unbiased estimate of
the integral of h, for chains of any length. A step that proposes y with the probability a of going there counts y with
a, and the old state with 1 - a: the mean over the decision (Veach 1997, 11.5).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxdr import loops
from jaxdr.boundary.baselines.markov_chains.segments import ANY, Lines, Space, States, fresh_lines, states_of
from jaxdr.boundary.baselines.markov_chains.walks import walk
from jaxdr.boundary.guided_edges.edge_lunes import LunePoints
from jaxdr.boundary.guided_edges.primary_guides import below_one, choice
from jaxdr.geometry.vector import normalize, orthonormal_basis, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.transport.sampler import lattice, uniform

NUMBERS = 6  # uniform numbers of a step
SHORTEST = 2.0**-8  # shortest walk over the longest one
WIDEST, NARROWEST = 0.5, 1e-3  # turns, in radian


class Steps(NamedTuple):
    """How many `chains`, how many steps each (`length`), and from how many `seeds`; `large`: share of fresh lines."""

    chains: int
    length: int
    seeds: int
    large: float


class Visits(NamedTuple):
    """The states that C chains start from and all that they proposed, [T + 1, C].

    `weight` times a contribution, summed, is an unbiased estimate of the integral of the contribution, per length of
    edge and solid angle. It is zero where nothing counts.
    """

    point: LunePoints
    towards: Float[Array, "T1 C 3"]
    weight: Float[Array, "T1 C"]


class Chains(NamedTuple):
    """Visits, the `last` states of C chains, their weights (`total`), and how likely their steps were taken."""

    visits: Visits
    last: States
    total: Float[Array, " C"]
    accepted: Float[Array, "T C"]


def run_chains(space: Space, steps: Steps, key: PRNGKeyArray) -> Chains:
    """Draw seeds, start chains from them, and let them step."""
    key_seeds, key_start, key_steps = jax.random.split(key, 3)
    dtype = space.lunes.start.dtype
    seeds = states_of(space, fresh_lines(space, lattice(key_seeds, 1, jnp.arange(steps.seeds), 4, dtype)))
    value = safe_divide(seeds.magnitude, seeds.density, seeds.density > 0, 0.0)
    chosen = choice(value)
    u = (jnp.arange(steps.chains) + uniform(key_start, (), dtype)) / steps.chains
    entry, _ = chosen.sample(below_one(u))
    # The mean of w, but for rounding: w / (number of seeds x probability).
    probability = chosen.probability(entry)
    total = safe_divide(value[entry], steps.seeds * probability, probability > 0, 0.0)
    start = jax.tree.map(lambda table: table[entry], seeds)

    def step(state, number):
        now, at = state
        u = uniform(jax.random.fold_in(key_steps, number), (steps.chains, NUMBERS), dtype)
        proposed, accepted = propose(space, now, steps.large, u[:, :-1])
        taken = u[:, -1] < accepted
        after = _either(taken, proposed, now)
        seen = proposed.point, proposed.towards, proposed.magnitude
        return (after, jnp.where(taken, number + 1, at)), (seen, accepted, at)

    numbers = jnp.arange(steps.length, dtype=jnp.int32)
    (last, _), (seen, accepted, at) = loops.scan(step, (start, jnp.zeros_like(start.source)), numbers)
    first = start.point, start.towards, start.magnitude
    point, towards, light = jax.tree.map(lambda one, more: jnp.concatenate([one[None], more]), first, seen)
    counted = jnp.zeros_like(light).at[at, jnp.arange(steps.chains)].add(1.0 - accepted).at[1:].add(accepted)
    share = counted * (total / (steps.chains * steps.length))
    weight = safe_divide(share, light, light > 0, 0.0)
    return Chains(Visits(point, towards, weight), last, total, accepted)


def propose(space: Space, now: States, large: float, u: Float[Array, "n 5"]) -> tuple[States, Float[Array, " n"]]:
    """(states that chains may go to, the probabilities of going there).

    A step is a fresh line (`large` of them), a walk along the silhouette that the source sees, or a turn about the
    edge's point. Walks are symmetric per length of edge and area of the source, turns per solid angle.
    """
    kind, size, side, other = u[:, 0], u[:, 1], u[:, 2], u[:, 3]
    is_large, is_walk = kind < large, kind < 0.5 * (1.0 + large)
    fresh = fresh_lines(space, u[:, 1:])
    length = space.reach * SHORTEST**size
    point, arrived = walk(
        space.lunes, space.rings, now.point, now.seen, jnp.where(side < 0.5, length, -length), other < 0.5
    )
    walked = Lines(point, normalize(now.seen.towards(point.position(space.lunes))), now.source, arrived)
    turned = Lines(
        now.point, _turned(now.towards, size, side), jnp.full_like(now.source, ANY), jnp.full_like(arrived, True)
    )
    lines = _either(is_large, fresh, _either(is_walk, walked, turned))
    there = states_of(space, lines)

    def in_measure(state: States) -> Float[Array, " n"]:
        inverse = safe_divide(1.0, state.density, state.density > 0, 0.0)
        return state.magnitude * jnp.where(is_large, inverse, jnp.where(is_walk, state.spread, 1.0))

    before, after = in_measure(now), in_measure(there)
    return there, jnp.minimum(safe_divide(after, before, before > 0, 0.0), 1.0)


def _turned(
    direction: Float[Array, "n 3"], size: Float[Array, " n"], around: Float[Array, " n"]
) -> Float[Array, "n 3"]:
    """Directions at random angles from others. How likely one is depends on the angle alone, so it is symmetric."""
    angle = WIDEST * (NARROWEST / WIDEST) ** size
    one, two = orthonormal_basis(direction)
    phi = 2.0 * math.pi * around
    across = scale(one, jnp.cos(phi)) + scale(two, jnp.sin(phi))
    return normalize(scale(direction, jnp.cos(angle)) + scale(across, jnp.sin(angle)))


def _either(condition: Bool[Array, " n"], one, two):
    """Row by row, one or the other."""

    def pick(a: Array, b: Array) -> Array:
        return jnp.where(condition.reshape(-1, *[1] * (a.ndim - 1)), a, b)

    return jax.tree.map(pick, one, two)
