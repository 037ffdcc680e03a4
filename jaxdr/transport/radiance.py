"""Scattered radiance of paths in value alone: no records, no derivative, and paths that have ended cost nothing."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxdr.scene.packed import PackedScene
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint
from jaxdr.transport.path import PathSettings, scatter, scatter_last
from jaxdr.transport.sampler import path_numbers
from jaxdr.transport.shading import Scatterer

BLOCK = 1 << 14  # paths that go on together: enough for all threads, few enough for what they need to stay in caches


class _Paths(NamedTuple):
    """Rows of paths at a vertex, and the numbers of the paths they belong to."""

    point: SurfacePoint
    wi: Float[Array, "N 3"]
    throughput: Float[Array, "N 3"]
    u: Float[Array, "N 4"]
    number: Int[Array, " N"]


def arriving_radiance(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Radiance that rays of `direction` find, `first` being what they hit: that of `trace_paths`, detached."""
    packed, first, direction = jax.tree.map(stop_gradient, (packed, first, direction))
    radiance, bounces = emitted(packed, first, -direction), settings.max_depth - 1
    if bounces == 0:
        return radiance
    return radiance + gathered_radiance(packed, first, direction, u, key, settings, bounces)


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
    packed, point, direction = jax.tree.map(stop_gradient, (packed, point, direction))
    settings = settings._replace(attached=0.0)  # of values alone all forms are one
    count = direction.shape[0]
    size = min(BLOCK, count)
    room = -(-count // size) * size
    remaining = jnp.full(count, bounces) if remaining is None else remaining
    stream = jnp.arange(count) if stream is None else stream
    paths = _Paths(point, -direction, jnp.ones_like(direction), u, jnp.arange(count))
    paths = jax.tree.map(lambda x: jnp.concatenate([x, jnp.repeat(x[-1:], room - count, axis=0)]), paths)

    def alive(paths, rows, number):
        """(rows of paths that scatter once more, in front, and how many there are)."""
        goes_on = rows & paths.point.valid & (number < remaining[paths.number])
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

    # Without MIS the last bounce needs no BSDF ray, if there is no delta lobe.
    ends_early = not (settings.mis or packed.has_delta_lobes)
    state: Any = (paths, *alive(paths, jnp.arange(room) < count, 0), jnp.zeros_like(direction))
    state = jax.lax.scan(partial(step, full), state, jnp.arange(bounces - ends_early))[0]
    if ends_early:
        state = step(last, state, bounces - 1)[0]
    return state[-1]
