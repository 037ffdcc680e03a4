"""Edges seen in mirrors and through smooth glass: lines on the film, by line sampling (docs/delta_visibility.md).

A film point and the random numbers that choose lobes fix a chain of rays. Where one of its segments touches the edge
(a, b), the image jumps; with (o, d) the segment as a function of the film point x and the scene θ, that is the curve

    g(x, θ) = d × (b - a) · (a - o) = 0,    of normal velocity  -∂g/∂θ / |∂g/∂x|.

Chords on the film cross the curve where Newton's method finds it. A crossing x* on the chord of half-length r weighs
(π / 2) / (2 r p P), p the density of chords and P the share of the centres along the chord from which x* is found. Trials
until the first success, T on average 1 / P (Booth 2007; Zeltner et al. 2020, Specular manifold sampling, Eq. 10), make
that unbiased whatever else mirrors do: other faces, other lobes, other solutions, no convergence are failures.
"""

import math
import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.boundary.blocks import sum_over_blocks
from jaxdr.boundary.edge_reservoir import Bundles, EdgeTable, draw_edges, edge_table, may_cross, passes, volume
from jaxdr.geometry.vector import dot, norm
from jaxdr.scene.camera import View
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.delta_chain import ChainSegments, delta_chain
from jaxdr.transport.interaction import intersect, on_fixed_ray
from jaxdr.transport.path import PathSettings, trace_paths
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice, uniform

REACH = 1.0  # half-length of the chords, pixels
STEPS = 5  # of Newton's method
CONVERGED = 1e-3  # pixels: last step of Newton's method, and how far apart two solutions are
TRIALS = 256  # at most; what is lost beyond is reported
NEAR = 1e-3  # share of the distance by which what is beside an edge may be nearer than the edge
CONTACT = 4e-5  # share of the coordinates below which an edge is one of the mirror's own
BESIDE = 2e-5  # how far beside the edge both sides are looked at, as a share of the film's larger side


class Crossings(NamedTuple):
    """C crossings to be: chords from `centre` along the unit `towards`, segment `number` of the chain, the edge.

    `u` are the random numbers of the paths, `lens` those of the camera's aperture; `weight` all but 1 / P.
    """

    centre: Float[Array, "C 2"]
    towards: Float[Array, "C 2"]
    u: Float[Array, "C B 4"]
    lens: Float[Array, "C 2"] | None
    number: Int[Array, " C"]
    edge: Int[Array, " C"]
    weight: Float[Array, " C"]


class Found(NamedTuple):
    """What Newton's method came to: film points, and whether they count."""

    film_point: Float[Array, "C 2"]
    valid: Bool[Array, " C"]


def chain_edges(packed: PackedScene, moving: tuple[bool, ...], rays: str) -> EdgeTable:
    """The edges that may jump in the image as it is seen over delta lobes; `moving` shapes, relative to the camera."""
    flags, turns = jnp.asarray(moving), jnp.asarray(False)
    for group in packed.bsdfs:
        if group.bsdf.delta:
            turns = turns | (group.member & flags).any()
    return edge_table(packed, flags[packed.edges.shape] | turns, rays)


def film_chain_term(
    packed: PackedScene, table: EdgeTable, count: int, key: PRNGKeyArray, settings: PathSettings
) -> Float[Array, "H W 3"]:
    """Image of the edges seen over delta lobes, zero in value and right in derivative, from `count` chords."""
    settings = settings._replace(attached=0.0)  # of values alone all forms are one
    crossings, valid = _crossings(packed, table, count, key, settings)
    order = jnp.argsort(~valid, stable=True)
    slots = jax.tree.map(lambda x: x[order], (crossings, valid))
    key_trials, key_path = jax.random.split(jax.random.fold_in(key, 1))
    used = valid.sum()

    def image(slots, number):
        crossings, valid = slots
        key = jax.random.fold_in(key_trials, number[0])
        return _image(packed, table, crossings, valid & (number < used), key, key_path, settings)

    return sum_over_blocks(image, slots, used)


def _crossings(packed: PackedScene, table: EdgeTable, count, key, settings) -> tuple[Crossings, Bool[Array, " N"]]:
    """(one candidate of each chord, whether there is one); detached."""
    detached = jax.tree.map(stop_gradient, packed)
    camera, film, dtype = packed.camera, packed.camera.film, packed.vertices.dtype
    key_film, key_path, key_seed = jax.random.split(key, 3)
    x0, y0, width, height = film.window
    margin = film.filter.radius + REACH
    size = jnp.asarray([width + 2 * margin, height + 2 * margin], dtype)
    aperture = LENS_DIMENSIONS if camera.aperture else 0
    drawn = lattice(key_film, 1, jnp.arange(count), 3 + aperture, dtype)[0]
    centre = jnp.asarray([x0 - margin, y0 - margin], dtype) + drawn[:, :2] * size
    angle = math.pi * drawn[:, 2]
    towards = jnp.stack([jnp.cos(angle), jnp.sin(angle)], -1)
    u = uniform(key_path, (count, settings.max_depth, 4), dtype)
    lens = drawn[:, 3:] if aperture else None
    weight = jnp.full(count, 0.5 * math.pi / (2 * REACH) / count, dtype) * size.prod()
    nowhere = jnp.zeros(count, jnp.int32)
    chords = Crossings(centre, towards, u, lens, nowhere, nowhere, weight)

    chain, rate = _moved(detached, chords, jnp.zeros(count, dtype), settings)
    seeds = jax.random.bits(key_seed, (settings.max_depth, count), jnp.uint32)
    total = jnp.zeros(count, dtype)
    importance, edge, number = jnp.ones(count, dtype), nowhere, nowhere
    for i in range(1, settings.max_depth):
        bundles = _bundles(detached, *jax.tree.map(lambda x, i=i: x[i], (chain, rate)))
        found = draw_edges(table, bundles, chain.reached[i], seeds[i], REACH)
        total = total + found.total
        chance = found.total / jnp.where(total > 0, total, 1.0)
        taken = uniform(jax.random.fold_in(key_seed, i), (count,), dtype) < chance
        importance = jnp.where(taken, found.importance, importance)
        edge, number = jnp.where(taken, found.edge, edge), jnp.where(taken, i, number)
    valid = total > 0
    weight = jnp.where(valid, weight * total / jnp.where(importance > 0, importance, 1.0), 0.0)
    return chords._replace(number=number, edge=edge, weight=weight), valid


def _view(camera, crossings: Crossings) -> View:
    return camera.view(crossings.lens)


class _Rate(NamedTuple):
    """Derivatives of the segments of a chain."""

    origin: Float[Array, "*B C 3"]
    direction: Float[Array, "*B C 3"]


def _moved(detached, crossings: Crossings, t, settings) -> tuple[ChainSegments, _Rate]:
    """Chains from the points at t of chords, and their derivatives along the chords."""
    view, u = _view(detached.camera, crossings), crossings.u.swapaxes(0, 1)

    def rays(t):
        chain = delta_chain(detached, view, crossings.centre + t[:, None] * crossings.towards, u, settings.rays)
        return (chain.origin, chain.direction), chain

    _, rates, chain = jax.jvp(rays, (t,), (jnp.ones_like(t),), has_aux=True)
    return chain, _Rate(*rates)


def _segment(crossings: Crossings, *tables):
    """Rows of tables [B, C, ...] for the segments that cross."""
    return jax.tree.map(lambda x: x[crossings.number, jnp.arange(x.shape[1])], tables)


def _bundles(detached, chain: ChainSegments, rate: _Rate) -> Bundles:
    end = jnp.where(jnp.isinf(chain.distance), 4.0 * detached.size(), chain.distance)
    return Bundles(chain.origin, chain.direction, rate.origin, rate.direction, end)


def _find(detached, table: EdgeTable, crossings: Crossings, settings) -> Found:
    """Where the chords cross the edges, by Newton's method from their centres.

    A function of the arguments alone, and false unless the edge is among the centre's candidates: trials rely on it.
    """
    start, end = table.ends[crossings.edge, 0], table.ends[crossings.edge, 1]
    chain, rate = _segment(crossings, *_moved(detached, crossings, jnp.zeros_like(crossings.weight), settings))
    candidate, t = may_cross(_bundles(detached, chain, rate), start, end - start, REACH)

    def step(state, _):
        t, _, valid = state
        chain, rate = _segment(crossings, *_moved(detached, crossings, t, settings))
        o, d = chain.origin, chain.direction
        side = end - start
        slope = dot(jnp.cross(rate.direction, side), start - o) - dot(jnp.cross(d, side), rate.origin)
        change = -volume(o, d, start, side) / jnp.where(slope == 0, 1.0, slope)
        change = jnp.clip(jnp.where(slope == 0, 0.0, change), -REACH, REACH)
        valid = valid & chain.reached & (slope != 0)
        return (jnp.where(valid, t + change, t), jnp.abs(change), valid), None

    state = (t, jnp.zeros_like(t), candidate & chain.reached)
    (t, change, valid), _ = jax.lax.scan(step, state, None, length=STEPS)
    valid = valid & (change < CONVERGED) & (jnp.abs(t) <= REACH)
    return Found(crossings.centre + t[:, None] * crossings.towards, valid)


def _trials(detached, table, crossings: Crossings, target: Found, key, settings) -> Float[Array, " C"]:
    """Numbers of centres on the chords until one finds `target`: 1 / P on average."""

    def unfinished(state):
        number, done, _ = state
        return (number < TRIALS) & ~done.all()

    def trial(state):
        number, done, count = state
        u = uniform(jax.random.fold_in(key, number), done.shape, target.film_point.dtype)
        centre = target.film_point + (REACH * (2 * u - 1))[:, None] * crossings.towards
        again = _find(detached, table, crossings._replace(centre=centre), settings)
        same = again.valid & (norm(again.film_point - target.film_point) < CONVERGED)
        return number + 1, done | same, count + ~done

    nothing = jnp.zeros_like(crossings.weight)
    _, done, count = jax.lax.while_loop(unfinished, trial, (jnp.int32(0), ~target.valid, nothing))
    lost = (~done).sum()
    jax.lax.cond(lost > 0, lambda: jax.debug.callback(_report, lost, target.valid.sum()), lambda: None)
    return count


def _report(lost, total):
    warnings.warn(
        f"jaxdr: {int(lost)} of {int(total)} edges seen in mirrors or through glass were not found again in {TRIALS} "
        "trials; their share of the derivative is too small. Mirrors of faces larger than a pixel avoid it.",
        stacklevel=2,
    )


def _image(packed, table: EdgeTable, crossings: Crossings, valid, key, key_path, settings) -> Float[Array, "H W 3"]:
    detached = jax.tree.map(stop_gradient, packed)
    found = _find(detached, table, crossings, settings)
    valid = valid & found.valid
    x, u = found.film_point, crossings.u.swapaxes(0, 1)
    view = _view(detached.camera, crossings)
    chain = delta_chain(detached, view, x, u, settings.rays)

    def at(packed, x):
        """g for the scene and film points, along the faces of these chains."""
        moving = delta_chain(packed, _view(packed.camera, crossings), x, u, settings.rays, chain.face)
        (origin, direction) = _segment(crossings, moving.origin, moving.direction)
        ends = packed.vertices[packed.edges.vertices[crossings.edge]]
        return volume(origin, direction, ends[:, 0], ends[:, 1] - ends[:, 0])

    axes = jnp.eye(2, dtype=x.dtype)
    gradient = jnp.stack(
        [jax.jvp(lambda x: at(detached, x), (x,), (jnp.broadcast_to(axis, x.shape),))[1] for axis in axes], -1
    )
    steepness = norm(gradient)
    valid = valid & (steepness > 0)
    steepness = jnp.where(valid, steepness, 1.0)
    normal = gradient / steepness[:, None]

    film = packed.camera.film
    step = BESIDE * max(film.width, film.height)
    sides = jnp.stack([x - step * normal, x + step * normal])
    valid = valid & _in_sight(detached, table, crossings, view, sides, u, settings)
    radiance = [_radiance(detached, view, side, u, key_path, settings) for side in sides]
    trials = _trials(detached, table, crossings, Found(x, valid), key, settings)
    weight = stop_gradient(jnp.where(valid, crossings.weight * trials / steepness, 0.0))
    moved = at(packed, x)
    displacement = stop_gradient(moved) - moved
    return splat(film, x, stop_gradient(radiance[0] - radiance[1]) * (weight * displacement)[:, None])


def _in_sight(detached, table, crossings: Crossings, view, sides, u, settings) -> Bool[Array, " C"]:
    """Whether the chains beside crossings pass the edge on either side, and nothing is in front of it."""
    start = table.ends[crossings.edge, 0]
    side = table.ends[crossings.edge, 1] - start
    volumes, clear = [], []
    for points in sides:
        chain = delta_chain(detached, view, points, u, settings.rays)
        (chain,) = _segment(crossings, chain)
        at = passes(chain.origin, chain.direction, start, side)
        # A face at the edge may be tilted towards the chain; what is hidden after all has no jump.
        tolerance = NEAR * at.distance
        neighbours = detached.edges.faces[crossings.edge]
        own = ((chain.face[:, None] == neighbours) & (neighbours >= 0)).any(-1)
        ahead = at.distance > CONTACT * jnp.abs(chain.origin).max(-1)
        there = (at.along >= 0) & (at.along <= 1)
        clear.append(chain.reached & ahead & there & (own | (chain.distance >= at.distance - tolerance)))
        volumes.append(volume(chain.origin, chain.direction, start, side))
    return clear[0] & clear[1] & (volumes[0] < 0) & (volumes[1] > 0)


def _radiance(detached, view: View, film_points, u, key, settings) -> Float[Array, "C 3"]:
    """Radiance that arrives at film points, by the paths of these numbers."""
    origin, direction = view.rays(film_points)
    origin = jnp.broadcast_to(origin, direction.shape)
    begin, reach = view.clipped(origin, direction)
    active = jnp.ones(direction.shape[0], bool)
    face = intersect(detached, begin, direction, active, settings.rays, reach)
    first = on_fixed_ray(detached, origin, direction, face)
    return trace_paths(detached, first, direction, u, key, settings).radiance
