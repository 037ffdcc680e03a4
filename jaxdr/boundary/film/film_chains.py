"""Edges seen in mirrors and through smooth glass: lines on the film, by line sampling (docs/delta_visibility.md).

A film point and the random numbers that choose lobes fix a chain of rays. The image jumps where one of its segments
touches the edge (a, b). Let o and d be the segment's origin and direction, functions of the film point x and the scene
θ. Then the image jumps at the curve

    g(x, θ) = d × (b - a) · (a - o) = 0,    of normal velocity  -∂g/∂θ / |∂g/∂x|.

Newton's method finds where chords on the film cross the curve. A crossing x* on a chord of half-length r has the weight
(π / 2) / (2 r p P). Here p is the density of chords, and P is the share of the centres along the chord from which
Newton's method finds x*. The number of trials until the first success is 1 / P on average (Booth 2007; Zeltner et al.
2020, "Specular manifold sampling"), so it replaces 1 / P without bias. A trial that meets another face, another lobe or
another solution, or does not converge, is a failure.
"""

import math
import warnings
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxdr import loops
from jaxdr.boundary.shared.allocation import allocate, capacity, pixel_importance, shares
from jaxdr.boundary.shared.blocks import map_over_blocks, sum_over_blocks
from jaxdr.boundary.shared.edge_table import edge_table
from jaxdr.boundary.shared.term import Chunk, Context, streams
from jaxdr.geometry.bundles import Bundles, may_cross, passes, volume
from jaxdr.geometry.queries import EdgeTable, draw_edges
from jaxdr.geometry.vector import corners, from_components, norm, scale
from jaxdr.safe_divide import safe_divide
from jaxdr.scene.camera import Camera, View
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.delta_chain import ChainSegments, delta_chain
from jaxdr.transport.interaction import SurfacePoint, on_fixed_ray
from jaxdr.transport.radiance import Answers, Requests, joined, request
from jaxdr.transport.sampler import LENS_DIMENSIONS, lattice, path_numbers, uniform

REACH = 2.0  # half-length of the chords, pixels
PILOTS = 0.25  # pilot chords for each other chord; they tell where the others should go
FLOOR = 0.2  # importance that every pixel keeps, relative to the mean
STEPS = 5  # of Newton's method
CONVERGED = 1e-3  # pixels: largest last step of Newton's method, and largest distance between equal solutions
TRIALS = 256  # at most; a warning reports crossings that need more
PLACES, LEAST_PLACES = 16, 4096  # a round makes one trial for every 16 chords, and at least so many
NEAR = 1e-3  # a hit beside an edge may be nearer than the edge by this share of the distance
CONTACT = 4e-5  # an edge nearer than this share of the coordinates belongs to the mirror itself
BESIDE_ON_FILM = 2e-5  # distance of both rays from the edge, as a share of the film's larger side


class FilmChords(NamedTuple):
    """C chords from `centre` along the unit `towards`; detached.

    `u` are the random numbers of the paths with the numbers `stream`. `lens` are the random numbers of the camera's
    aperture (None without). `inverse` is one over the density of centres (per square pixel).
    """

    centre: Float[Array, "C 2"]
    towards: Float[Array, "C 2"]
    stream: UInt32[Array, " C"]
    u: Float[Array, "C B 4"]
    lens: Float[Array, "C 2"] | None
    inverse: Float[Array, " C"]


class ChainCrossings(NamedTuple):
    """A candidate of each chord: segment `number` of its chain, and an `edge`. `weight`: 1 / chance of this choice."""

    chords: FilmChords
    number: Int[Array, " C"]
    edge: Int[Array, " C"]
    weight: Float[Array, " C"]


class Found(NamedTuple):
    """Results of Newton's method: film points, and whether they are solutions."""

    film_point: Float[Array, "C 2"]
    valid: Bool[Array, " C"]


def edges_of_chains(packed: PackedScene, moving: tuple[bool, ...], rays: str) -> EdgeTable:
    """Edges that may move in the image where delta lobes show them.

    `moving`: which shapes move relative to the camera.
    """
    flags, turns = jnp.asarray(moving), jnp.asarray(False)
    for group in packed.bsdfs:
        if group.bsdf.delta:
            turns = turns | (group.member & flags).any()
    return edge_table(packed, flags[packed.edges.shape] | turns, rays)


class Jumps(NamedTuple):
    """Points of the film at which the image jumps; detached.

    `weight` is the weight of the crossing over |∂g/∂x|, zero where there is no jump. `faces` are those that the chain
    hits.
    """

    crossings: ChainCrossings
    film_point: Float[Array, "C 2"]
    weight: Float[Array, " C"]
    faces: Int[Array, "C B"]


class FilmChains:
    """Term of the edges seen over delta lobes. It draws a chord for every path sample.

    Additional pilot chords are spread evenly over the film. They tell where the other chords go.
    """

    name = "chains"

    def prepare(self, context: Context, key) -> EdgeTable | None:
        """The edges that may move in the image where delta lobes show them; None if there can be none."""
        del key
        packed, seen = context.packed, context.moving.seen
        if not (any(seen) and packed.has_delta_lobes and context.settings.max_depth > 1):
            return None
        return edges_of_chains(packed, seen, context.settings.rays)

    def draw(self, context: Context, state: EdgeTable, chunk: Chunk, key):
        """Where chords cross edges, and requests for the radiance on both sides."""
        packed, settings, count = context.packed, context.settings, chunk.paths
        key_pilot, key_cells, key_chords, key_trials = jax.random.split(key, 4)
        _, _, width, height = packed.camera.film.window
        margin = _margin(packed)
        shape = (height + 2 * margin, width + 2 * margin)
        cells = shape[0] * shape[1]
        pilots = max(1, round(PILOTS * count / cells))
        cell = jnp.repeat(jnp.arange(cells), pilots)
        even = jnp.full(cells * pilots, 1.0 / pilots, packed.vertices.dtype)
        pilot = _chords(packed, cell, even, key_pilot, chunk.key, settings)
        _, score = _candidates(packed, state, pilot, key_pilot, settings)
        importance = pixel_importance(score, cell, score >= 0, shape, FLOOR)
        expected = shares(importance[None, :, None], float(count))
        cell, inverse = allocate(expected, capacity(count, cells), key_cells)
        chords = _chords(packed, jnp.maximum(cell, 0), inverse, key_chords, chunk.key, settings)
        crossings, score = _candidates(packed, state, chords, key_chords, settings)
        valid = (score > 0) & (cell >= 0)
        order, used = jnp.argsort(~valid, stable=True), valid.sum()
        slots = jax.tree.map(lambda x: x[order], (crossings, valid))

        def find(slots, number):
            crossings, valid = slots
            return _jumps(packed, state, crossings, valid & (number < used), settings)

        jumps, one, two = map_over_blocks(find, slots, used)
        trials = _trials(packed, state, jumps, key_trials, settings)  # 1 / P
        return joined([one, two]), (jumps._replace(weight=jumps.weight * trials), used)

    def image(self, context: Context, state, chunk: Chunk, held, answers: Answers | None) -> Float[Array, "H W 3"]:
        """Jumps x normal velocities."""
        assert answers is not None  # `draw` always asks
        packed, settings = context.packed, context.settings
        jumps, used = held
        one, two = answers.total.reshape(2, -1, 3)

        def image(block, number):
            jumps, jump = block
            moved = _volume(packed, jumps.crossings, jumps.film_point, jumps.faces.T, settings)
            displacement = jnp.where(number < used, jumps.weight, 0.0) * (stop_gradient(moved) - moved)
            return splat(packed.camera.film, jumps.film_point, scale(jump, displacement))

        return chunk.share * sum_over_blocks(image, (jumps, one - two), used)


def _margin(packed: PackedScene) -> int:
    """How many pixels outside the film's window the centres of chords may lie."""
    return math.ceil(packed.camera.film.filter.radius + REACH)


def _chords(packed: PackedScene, cell: Int[Array, " C"], inverse, key, key_paths, settings) -> FilmChords:
    """Chords with random centres in `cell`, a pixel of the window or of the margin around it.

    Their paths use the same random numbers as the wavefront, which draws them from `key_paths` and the streams.
    """
    x0, y0, width, _ = packed.camera.film.window
    margin, dtype = _margin(packed), inverse.dtype
    aperture = LENS_DIMENSIONS if packed.camera.aperture else 0
    drawn = lattice(key, 1, jnp.arange(cell.shape[0]), 3 + aperture, dtype)
    row, column = jnp.divmod(cell, width + 2 * margin)
    corner = jnp.stack([column + x0 - margin, row + y0 - margin], -1).astype(dtype)
    angle, stream = math.pi * drawn[:, 2], streams(FilmChains.name, cell.shape[0])
    return FilmChords(
        centre=corner + drawn[:, :2],
        towards=from_components(jnp.cos(angle), jnp.sin(angle)),
        stream=stream,
        u=jnp.stack([path_numbers(key_paths, stream, b, dtype) for b in range(settings.max_depth)], 1),
        lens=drawn[:, 3:] if aperture else None,
        inverse=inverse,
    )


def _candidates(
    detached: PackedScene, table: EdgeTable, chords: FilmChords, key, settings
) -> tuple[ChainCrossings, Float[Array, " C"]]:
    """(one candidate of each chord, the summed importance of all its candidates: zero if it has none)."""
    count, dtype = chords.inverse.shape[0], chords.inverse.dtype
    key_seed, key_choice = jax.random.split(jax.random.fold_in(key, 2))
    chain, rate = _moved(detached, chords, jnp.zeros(count, dtype), settings)
    bundles = _bundles(detached, chain, rate)
    segments = settings.max_depth - 1
    seeds = jax.random.bits(key_seed, (segments, count), jnp.uint32)
    rows = jax.tree.map(lambda x: x[1:].reshape(segments * count, *x.shape[2:]), (bundles, chain.reached))
    reached = rows[0]._replace(end=jnp.where(rows[1], rows[0].end, 0.0))
    found = draw_edges(table, reached, seeds.reshape(-1), REACH, settings.rays)
    found = jax.tree.map(lambda x: x.reshape(segments, count), found)
    # Choose one of the segments, in proportion to the importance of its candidates.
    cumulative = jnp.cumsum(found.total, 0)
    total = cumulative[-1]
    target = uniform(key_choice, (count,), dtype) * total
    number = jnp.minimum((cumulative <= target).sum(0), segments - 1)
    edge, importance = (x[number, jnp.arange(count)] for x in (found.edge, found.importance))
    weight = safe_divide(total, importance, otherwise=0.0)
    return ChainCrossings(chords, number + 1, edge, detached.edges.shared(edge, weight)), total


def _view(camera: Camera, chords: FilmChords) -> View:
    return camera.view(chords.lens)


class _Rate(NamedTuple):
    """Derivatives of the segments of a chain."""

    origin: Float[Array, "*B C 3"]
    direction: Float[Array, "*B C 3"]


def _moved(detached, chords: FilmChords, t, settings) -> tuple[ChainSegments, _Rate]:
    """Chains from the points at t of chords, and their derivatives along the chords."""
    view, u = _view(detached.camera, chords), chords.u.swapaxes(0, 1)

    def rays(t):
        chain = delta_chain(detached, view, chords.centre + scale(chords.towards, t), u, settings.rays)
        return (chain.origin, chain.direction), chain

    _, rates, chain = jax.jvp(rays, (t,), (jnp.ones_like(t),), has_aux=True)
    return chain, _Rate(*rates)


def _segment(crossings: ChainCrossings, *tables):
    """Rows of tables [B, C, ...] for the segment of each crossing."""
    return jax.tree.map(lambda x: x[crossings.number, jnp.arange(x.shape[1])], tables)


def _bundles(detached, chain: ChainSegments, rate: _Rate) -> Bundles:
    end = jnp.where(jnp.isinf(chain.distance), 4.0 * detached.size, chain.distance)
    return Bundles(chain.origin, chain.direction, rate.origin, rate.direction, end)


def _find(detached, table: EdgeTable, crossings: ChainCrossings, settings) -> Found:
    """Where the chords cross the edges, by Newton's method from their centres.

    `_trials` relies on two properties: the result is a function of the arguments alone, and it is valid only if the
    edge is among the candidates of the chord's centre.
    """
    chords = crossings.chords
    start = table.ends[crossings.edge, 0]
    side = table.ends[crossings.edge, 1] - start

    def step(state, number):
        t, _, valid = state
        chain, rate = _segment(crossings, *_moved(detached, chords, t, settings))
        bundles = _bundles(detached, chain, rate)
        change, candidate = may_cross(bundles, start, side, REACH)
        valid = valid & chain.reached & ((number > 0) | candidate)
        change = jnp.where(valid, jnp.clip(change, -2.0 * REACH, 2.0 * REACH), 0.0)
        return (t + change, jnp.abs(change), valid), None

    nothing = jnp.zeros_like(crossings.weight)
    state = (nothing, nothing, jnp.ones_like(nothing, bool))
    (t, change, valid), _ = loops.scan(step, state, jnp.arange(STEPS))
    valid = valid & (change < CONVERGED) & (jnp.abs(t) <= REACH)
    return Found(chords.centre + scale(chords.towards, t), valid)


def _trials(detached, table, jumps: Jumps, key, settings) -> Float[Array, " C"]:
    """How many random centres on a chord it takes until one finds its jump: 1 / P on average. 0 where there is none.

    Most chords need a few trials, some need hundreds. So the trials of a round are made for those chords alone that
    have not found their jump. When few are left, each of them makes several trials at once.
    """
    valid = jumps.weight > 0
    count, dtype = valid.shape[0], jumps.weight.dtype
    places = min(count, max(count // PLACES, LEAST_PLACES))
    place = jnp.arange(places)

    def searching(trials, found):
        return valid & ~found & (trials < TRIALS)

    def trial(state):
        trials, found = state
        left = searching(trials, found)
        several = jnp.clip(places // jnp.maximum(left.sum(), 1), 1, TRIALS)
        (rows,) = jnp.nonzero(left, size=places, fill_value=0)
        rank, ahead = place // several, place % several
        row = rows[rank]
        number = trials[row] + ahead
        crossings, x = jax.tree.map(lambda table: table[row], (jumps.crossings, jumps.film_point))
        u = path_numbers(key, row, number, dtype)[:, 0]
        centre = x + scale(crossings.chords.towards, REACH * (2 * u - 1))
        again = _find(detached, table, crossings._replace(chords=crossings.chords._replace(centre=centre)), settings)
        same = again.valid & (norm(again.film_point - x) < CONVERGED) & (number < TRIALS)
        first = jnp.full(places, several).at[rank].min(jnp.where(same, ahead, several))
        worked = place < jnp.minimum(left.sum(), places // several)
        target = jnp.where(worked, rows, count)  # out of range: nothing is written
        done = jnp.minimum(trials[rows] + jnp.minimum(first + 1, several), TRIALS)
        return trials.at[target].set(done, mode="drop"), found.at[target].set(first < several, mode="drop")

    start = jnp.zeros(count, jnp.int32), jnp.zeros(count, bool)
    trials, found = loops.while_loop(lambda state: searching(*state).any(), trial, start)
    lost = (valid & ~found).sum()
    loops.cond(lost > 0, lambda: jax.debug.callback(_report, lost, valid.sum()), lambda: None)
    return trials.astype(dtype)


def _report(lost, total):
    if not lost:  # under `vmap` this function runs in any case
        return
    # Round to a power of ten. The exact number differs from call to call, and Python shows each new text again.
    share = 10.0 ** math.ceil(math.log10(lost / total))
    warnings.warn(
        f"jaxdr: up to {100 * share:g} % of the edges seen in mirrors or through glass were not found again in "
        f"{TRIALS} trials; their share of the derivative is too small. Mirrors of faces larger than a pixel avoid it.",
        stacklevel=2,
    )


def _volume(packed, crossings: ChainCrossings, film_point, faces, settings) -> Float[Array, " C"]:
    """g at film points, for chains that meet these faces."""
    chords = crossings.chords
    chain = delta_chain(packed, _view(packed.camera, chords), film_point, chords.u.swapaxes(0, 1), settings.rays, faces)
    (origin, direction) = _segment(crossings, chain.origin, chain.direction)
    start, end = corners(packed.ends_of(crossings.edge))
    return volume(origin, direction, start, end - start)


def _jumps(packed, table: EdgeTable, crossings: ChainCrossings, valid, settings) -> tuple[Jumps, Requests, Requests]:
    """(where chords cross edges, requests for the radiance on both sides). The factor 1 / P is not in the weights."""
    chords = crossings.chords
    found = _find(packed, table, crossings, settings)
    valid = valid & found.valid
    x, view = found.film_point, _view(packed.camera, chords)
    faces = delta_chain(packed, view, x, chords.u.swapaxes(0, 1), settings.rays).face

    def slope(axis):
        along = jnp.broadcast_to(axis, x.shape)
        return jax.jvp(lambda x: _volume(packed, crossings, x, faces, settings), (x,), (along,))[1]

    gradient = jax.vmap(slope)(jnp.eye(2, dtype=x.dtype)).T
    steepness = norm(gradient)
    valid = valid & (steepness > 0)
    steepness = jnp.where(valid, steepness, 1.0)
    step = scale(gradient, BESIDE_ON_FILM * max(packed.camera.film.width, packed.camera.film.height) / steepness)
    sides = jax.vmap(lambda x: _side(packed, table, crossings, view, x, settings))(jnp.stack([x - step, x + step]))
    valid = valid & sides.valid.all(0) & (sides.volume[0] < 0) & (sides.volume[1] > 0)
    # (pi / 2) k / p, with k = 1 / (2 r P).
    weight = 0.25 * math.pi / REACH * chords.inverse * crossings.weight
    jumps = Jumps(crossings, x, jnp.where(valid, weight / steepness, 0.0), faces.T)
    one, two = (
        request(
            point._replace(valid=point.valid & valid), -direction, chords.u[:, 0], settings.max_depth - 1, chords.stream
        )
        for point, direction in (jax.tree.map(lambda x, k=k: x[k], (sides.first, sides.direction)) for k in (0, 1))
    )
    return jumps, one, two


class _Side(NamedTuple):
    """Chains beside a crossing: their first hit and direction, g there, and whether they pass the edge unhidden."""

    first: SurfacePoint
    direction: Float[Array, "C 3"]
    volume: Float[Array, " C"]
    valid: Bool[Array, " C"]


def _side(packed, table: EdgeTable, crossings: ChainCrossings, view, film_points, settings) -> _Side:
    """Follow chains from film points beside crossings."""
    start = table.ends[crossings.edge, 0]
    side = table.ends[crossings.edge, 1] - start
    whole = delta_chain(packed, view, film_points, crossings.chords.u.swapaxes(0, 1), settings.rays)
    (chain,) = _segment(crossings, whole)
    at = passes(chain.origin, chain.direction, start, side)
    neighbours = packed.edges.faces[crossings.edge]
    own = ((chain.face[:, None] == neighbours) & (neighbours >= 0)).any(-1)
    # A face at the edge may tilt towards the chain's origin: its hits count as clear. Hidden edges have no jump anyway.
    clear = own | (chain.distance >= (1.0 - NEAR) * at.distance)
    ahead = at.distance > CONTACT * jnp.abs(chain.origin).max(-1)
    meets = (at.along >= 0) & (at.along <= 1) & ahead & clear & chain.reached
    first = on_fixed_ray(packed, whole.origin[0], whole.direction[0], whole.face[0])
    return _Side(first, whole.direction[0], volume(chain.origin, chain.direction, start, side), meets)
