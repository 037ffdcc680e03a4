"""Radiance of paths in value alone: no records, no derivative, and paths that have ended cost nothing."""

import os
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.near_field import NearField
from jaxdr.transport.path import PathSettings, ends_early, scatter, scatter_last
from jaxdr.transport.sampler import path_numbers
from jaxdr.transport.shading import Scatterer, ScatteringJump

# Paths that go on together: enough for all threads of the ray queries, few enough for what they need to stay in caches.
BLOCK = 8192 * max(2, os.cpu_count() or 1)


class _Paths(NamedTuple):
    """Rows of paths at a vertex, the random numbers there, and the numbers of the paths they belong to."""

    point: SurfacePoint
    wi: Float[Array, "N 3"]
    throughput: Float[Array, "N 3"]
    u: Float[Array, "N 4"]
    number: Int[Array, " N"]


class FirstBounce(NamedTuple):
    """What the first vertices of paths add, and where the paths go from there.

    `near_light` and `near_beyond` are the shares of the light sample and of everything behind the next segment that the
    first hit takes in material form.
    """

    emission: Float[Array, "*S N 3"]
    light: Float[Array, "*S N 3"]
    found: Float[Array, "*S N 3"]
    near_light: Float[Array, "*S N"]
    near_beyond: Float[Array, "*S N"]
    following: tuple[SurfacePoint, Float[Array, "*S N 3"], Float[Array, "*S N 3"]]


def arriving_radiance(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Radiance that rays of `direction` find, `first` being what they hit: that of `trace_paths`, detached."""
    packed, first, direction = stop_gradient((packed, first, direction))
    radiance, bounces = emitted(packed, first, -direction), settings.max_depth - 1
    if bounces == 0:
        return radiance
    return radiance + gathered_radiance(packed, first, direction, u, key, settings, bounces)


def first_bounce(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    settings: PathSettings,
    near: NearField | None,
) -> FirstBounce:
    """The first bounce of paths that `radiance_by_form` goes on with; `near` the other form of the first hits.

    It may be mapped over several first hits that share their random numbers.
    """
    packed, first, direction, near = stop_gradient((packed, first, direction, near))
    emission, scatterer = emitted(packed, first, -direction), Scatterer(packed, first, -direction)
    return _first_bounce(packed, emission, scatterer, -direction, u, settings, near)


def first_bounce_of_jump(
    packed: PackedScene,
    one: SurfacePoint,
    two: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    settings: PathSettings,
    near: tuple[NearField, NearField] | None,
) -> FirstBounce:
    """The same of the radiance from points `one` less that from `two` beside them, across a crease: a path for both.

    With `near`, of the two sides, only the share that is not in material form.
    """
    packed, one, two, direction, near = stop_gradient((packed, one, two, direction, near))
    emission = emitted(packed, one, -direction) - emitted(packed, two, -direction)
    first, second = Scatterer(packed, one, -direction), Scatterer(packed, two, -direction)
    jump = ScatteringJump(first, second, near)
    return _first_bounce(packed, emission, jump, -direction, u, settings, None)


def _first_bounce(packed, emission, scatterer, wi, u, settings, near) -> FirstBounce:
    throughput, nothing = jnp.ones_like(wi), jnp.zeros_like(wi)
    nowhere = (scatterer.point, wi, throughput)
    if settings.max_depth == 1:
        return FirstBounce(emission, nothing, nothing, nothing[:, 0], nothing[:, 0], nowhere)
    if settings.max_depth == 2 and ends_early(packed, settings):
        following, added = nowhere, scatter_last(packed, scatterer, throughput, u, settings, near)
    else:
        following, added = scatter(packed, scatterer, throughput, u, settings, near)
    return FirstBounce(emission, added.light, added.emission, added.near_light, added.near_beyond, following)


def radiance_by_form(
    packed: PackedScene, begun: FirstBounce, key: PRNGKeyArray, settings: PathSettings
) -> tuple[Float[Array, "*S N 3"], Float[Array, "*S N 3"]]:
    """(radiance, what of it first hits take in material form) of paths after their first bounce, detached.

    Paths of the same N share their random numbers.
    """
    packed, begun = stop_gradient((packed, begun))
    beyond = jnp.zeros_like(begun.light)
    if settings.max_depth > 2:
        shape, count = begun.light.shape, begun.light.shape[-2]
        flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[len(shape) - 1 :]), begun.following)
        stream = jnp.tile(jnp.arange(count), flat[1].shape[0] // count)
        u = path_numbers(key, stream, 0, begun.light.dtype)
        bounces = settings.max_depth - 2
        beyond = _followed(packed, flat, u, key, settings, bounces, stream=stream, first=1).reshape(shape)
    radiance = begun.emission + begun.light + begun.found + beyond
    return radiance, begun.near_light[..., None] * begun.light + begun.near_beyond[..., None] * (begun.found + beyond)


def gathered_radiance(
    packed: PackedScene,
    point: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
    bounces: int,
    remaining: Int[Array, " N"] | None = None,
    stream: Int[Array, " N"] | None = None,
) -> Float[Array, "N 3"]:
    """Radiance that valid surface points scatter back against `direction`, without what they emit; detached.

    Paths scatter `remaining` times, at most `bounces`. `u` are the random numbers of the first bounce; those of later
    ones are the same for paths of the same `stream` (by default all have their own). From bounce to bounce the rows of
    paths that go on are gathered in front, and blocks of rows are worked on as far as there are any.
    """
    packed, point, direction = stop_gradient((packed, point, direction))
    start = (point, -direction, jnp.ones_like(direction))
    return _followed(packed, start, u, key, settings, bounces, remaining, stream)


def _followed(
    packed,
    start: tuple[SurfacePoint, Array, Array],
    u,
    key,
    settings,
    bounces: int,
    remaining=None,
    stream=None,
    first: int = 0,
):
    """Light that paths gather in `bounces` bounces, the first of them number `first`.

    `start`: their points there, directions back and throughputs.
    """
    count = u.shape[0]
    size = min(BLOCK, count)
    room = -(-count // size) * size
    remaining = jnp.full(count, bounces) if remaining is None else remaining
    stream = jnp.arange(count) if stream is None else stream
    paths = _Paths(*start, u, jnp.arange(count))
    paths = jax.tree.map(lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], room - count, axis=0)]), paths)

    def alive(paths, rows, number):
        """(rows of paths that scatter once more, in front, and how many there are)."""
        goes_on = rows & paths.point.valid & (number - first < remaining[paths.number])
        return jnp.nonzero(goes_on, size=room, fill_value=0)[0], goes_on.sum()

    def step(at_vertex, state, number):
        paths, rows, used, radiance = state

        def block(i, state):
            after, radiance = state
            here = jax.lax.dynamic_slice_in_dim(rows, i * size, size)
            live = i * size + jnp.arange(size) < used
            before = jax.tree.map(lambda x: x[here], paths)
            before = before._replace(point=before.point._replace(valid=before.point.valid & live))
            following, added = at_vertex(before, number)
            added = jnp.where(live[:, None], added, 0.0)
            radiance = radiance.at[before.number].add(added)
            after = jax.tree.map(lambda t, x: jax.lax.dynamic_update_slice_in_dim(t, x, i * size, 0), after, following)
            return after, radiance

        after, radiance = jax.lax.fori_loop(0, -(-used // size), block, (paths, radiance))
        return (after, *alive(after, jnp.arange(room) < used, number + 1), radiance), None

    def full(before: _Paths, number):
        scatterer = Scatterer(packed, before.point, before.wi)
        state, added = scatter(packed, scatterer, before.throughput, before.u, settings)
        u = path_numbers(key, stream[before.number], number, before.u.dtype)
        return _Paths(*state, u, before.number), added.light + added.emission

    def last(before: _Paths, number):
        del number
        scatterer = Scatterer(packed, before.point, before.wi)
        return before, scatter_last(packed, scatterer, before.throughput, before.u, settings).light

    ends = ends_early(packed, settings)
    state: Any = (paths, *alive(paths, jnp.arange(room) < count, first), jnp.zeros_like(start[1]))
    state = jax.lax.scan(partial(step, full), state, first + jnp.arange(bounces - ends))[0]
    if ends:
        state = step(last, state, first + bounces - 1)[0]
    return state[-1]
