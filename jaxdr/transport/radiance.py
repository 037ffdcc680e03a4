"""The radiance wavefront: one loop that answers all requests for detached radiance.

A term of a derivative requests the radiance that leaves surface points in given directions. The requests of all terms
of a chunk go through one loop over bounces. At every bounce the paths that go on are moved to the front, and only
blocks with such paths are computed. So paths that have ended, and requests for nothing, cost nothing.
"""

import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt32

from jaxdr import loops
from jaxdr.geometry.vector import scale
from jaxdr.scene.packed import PackedScene
from jaxdr.sizes import at_once
from jaxdr.transport.compaction import rows_where
from jaxdr.transport.emission import emitted
from jaxdr.transport.interaction import SurfacePoint, material_point
from jaxdr.transport.near_field import Footprint
from jaxdr.transport.path import Lobe, Onwards, TwoForms, Vertex, ends_early, scatter
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.sampler import path_numbers

# Paths in a block. On CPUs there are enough for all threads of the ray queries, and few enough for the caches. For GPUs
# see `sizes`.
CPU_BLOCK = 8192 * max(2, os.cpu_count() or 1)
GPU_BLOCK = 1 << 19


class Requests(NamedTuple):
    """Requests for the radiance of R material points in the directions `wi`. All of it is detached.

    - `face` [R], `barycentric` [R, 3]: the points.
    - `valid` [R]: whether there is a point. If not, the request is for the environment's radiance.
    - `wi` [R, 3]: unit directions, world space.
    - `u` [R, 4]: uniform numbers of the first bounce.
    - `bounces` [R]: how often a path scatters at most.
    - `stream` [R]: gives the random numbers of later bounces. Paths of one stream share them.
    - `emission` [R]: share of the point's own emission that counts.
    - `seen`: footprints of a pixel, of size zero at points whose radiance has one form; None if all have one form.
    - `given`: directions that replace the first BSDF samples where their density is positive.
    """

    face: Int[Array, " R"]
    barycentric: Float[Array, "R 3"]
    valid: Bool[Array, " R"]
    wi: Float[Array, "R 3"]
    u: Float[Array, "R 4"]
    bounces: Int[Array, " R"]
    stream: UInt32[Array, " R"]
    emission: Float[Array, " R"]
    seen: Footprint | None = None
    given: Lobe | None = None


class Answers(NamedTuple):
    """Answers to `Requests`, detached: RGB radiance `total` [R, 3].

    `near` [R, 3] is the part of `total` that is taken in material form; zero without footprints.
    """

    total: Float[Array, "R 3"]
    near: Float[Array, "R 3"]


class _Paths(NamedTuple):
    """Paths at a vertex, in rows. `share`: the share of their light in material form. `number`: of their requests."""

    face: Int[Array, " N"]
    barycentric: Float[Array, "N 3"]
    wi: Float[Array, "N 3"]
    throughput: Float[Array, "N 3"]
    share: Float[Array, " N"] | None
    number: Int[Array, " N"]
    alive: Bool[Array, " N"]


def request(
    point: SurfacePoint,
    wi: Float[Array, "R 3"],
    u: Float[Array, "R 4"],
    bounces: Int[Array, "*#R"] | int,
    stream: UInt32[Array, " R"],
    emission: Float[Array, " R"] | float = 1.0,
) -> Requests:
    """Requests for the radiance of surface points. Paths scatter at valid points only."""
    count, dtype = wi.shape[:1], wi.dtype
    bounces = jnp.where(point.valid, jnp.asarray(bounces, jnp.int32), 0)
    emission = jnp.broadcast_to(jnp.asarray(emission, dtype), count)
    return stop_gradient(Requests(point.face, point.barycentric, point.valid, wi, u, bounces, stream, emission))


def joined(requests: Sequence[Requests]) -> Requests:
    """Several lists of requests as one."""
    if len(requests) == 1:
        return requests[0]
    footprints, lobes = (any(getattr(r, name) is not None for r in requests) for name in ("seen", "given"))

    def whole(r):
        zeros = jnp.zeros_like(r.emission)
        seen = Footprint(zeros, zeros) if footprints and r.seen is None else r.seen
        return r._replace(seen=seen, given=Lobe(r.wi, zeros) if lobes and r.given is None else r.given)

    return jax.tree.map(lambda *x: jnp.concatenate(x), *(whole(r) for r in requests))


def split(answers: Answers, requests: Sequence[Requests]) -> list[Answers]:
    """The answers to each of the lists that `joined` has concatenated."""
    counts = [r.emission.shape[0] for r in requests]
    parts = (jax.lax.split(table, counts) for table in answers)
    return [Answers(*part) for part in zip(*parts, strict=True)]


def radiance(packed: PackedScene, requests: Requests, key: PRNGKeyArray, settings: PathSettings) -> Answers:
    """Answer requests: emission, emitter sampling and BSDF sampling as in `trace_paths`; detached."""
    packed, requests = stop_gradient((packed, requests))
    point = material_point(packed, requests.face, requests.barycentric, requests.valid)
    total = scale(emitted(packed, point, requests.wi), requests.emission)
    bounces, near = settings.max_depth - 1, jnp.zeros_like(total)
    if bounces == 0:
        return Answers(total, near)
    sums = _followed(packed, requests, key, settings, bounces)
    return Answers(total + sums[0], near if requests.seen is None else sums[1])


def _followed(packed: PackedScene, requests: Requests, key, settings: PathSettings, bounces: int) -> list[Array]:
    """[the light that paths gather and, with footprints, the part of it in material form]."""
    count = requests.emission.shape[0]
    size = min(at_once(CPU_BLOCK, GPU_BLOCK), count)
    room = -(-count // size) * size
    early, forms = ends_early(packed, settings), 1 if requests.seen is None else 2
    start = _Paths(
        face=requests.face,
        barycentric=requests.barycentric,
        wi=requests.wi,
        throughput=jnp.ones_like(requests.wi),
        share=None if requests.seen is None else jnp.zeros_like(requests.emission),
        number=jnp.arange(count),
        alive=requests.bounces > 0,
    )
    start = jax.tree.map(lambda x: jnp.pad(x, [(0, room - count)] + [(0, 0)] * (x.ndim - 1)), start)

    def step(state, bounce):
        paths, sums = state
        used = paths.alive.sum()
        rows = rows_where(paths.alive)

        def block(i, state):
            after, sums = state
            here = jax.lax.dynamic_slice_in_dim(rows, i * size, size)
            live = i * size + jnp.arange(size) < used
            following, added = at_vertices(jax.tree.map(lambda x: x[here], paths), live, bounce)
            number = following.number
            sums = [s.at[number].add(jnp.where(live[:, None], a, 0.0)) for s, a in zip(sums, added, strict=True)]
            after = jax.tree.map(lambda t, x: jax.lax.dynamic_update_slice_in_dim(t, x, i * size, 0), after, following)
            return after, sums

        nobody = paths._replace(alive=jnp.zeros_like(paths.alive))
        return loops.fori_loop(0, -(-used // size), block, (nobody, sums)), None

    def at_vertices(paths, live, bounce):
        own = jax.tree.map(lambda x: x[paths.number], requests._replace(face=None, barycentric=None, wi=None))
        first = bounce == 0
        u = jnp.where(first, own.u, path_numbers(key, own.stream, bounce, own.u.dtype))
        forms = given = None
        if own.seen is not None:
            forms = TwoForms(own.seen._replace(size2=jnp.where(first, own.seen.size2, 0.0)))
        if own.given is not None:
            given = own.given._replace(pdf=jnp.where(first, own.given.pdf, 0.0))
        more = live & (bounce + 1 < own.bounces)
        onwards = Onwards((False if bounces == 1 else more) if early else True, given)
        at = Vertex(material_point(packed, paths.face, paths.barycentric, live), paths.wi, paths.throughput)
        after, added = scatter(packed, at, u, settings._replace(records=False), onwards, forms)
        light, found, share = added.light, added.emission, paths.share
        values = [light + found]
        if forms is not None:
            assert added.light_share is not None  # set with footprints
            light_share = jnp.where(first, added.light_share, paths.share)
            beyond = added.beyond_share  # None if no path goes on
            share = light_share if beyond is None else jnp.where(first, beyond, paths.share)
            values.append(scale(light, light_share) + scale(found, share))
        if after is None:
            return paths._replace(alive=jnp.zeros_like(live), share=share), values
        point = after.point
        ahead = _Paths(
            point.face, point.barycentric, after.wi, after.throughput, share, paths.number, more & point.valid
        )
        return ahead, values

    state: Any = (start, [jnp.zeros_like(requests.wi) for _ in range(forms)])
    if bounces == 1:
        return step(state, 0)[0][1]
    return loops.scan(step, state, jnp.arange(bounces))[0][1]


def arriving_radiance(
    packed: PackedScene,
    first: SurfacePoint,
    direction: Float[Array, "N 3"],
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: PathSettings,
) -> Float[Array, "N 3"]:
    """Detached radiance along rays of `direction` that hit `first`: that of `trace_paths`."""
    stream = jnp.arange(u.shape[0], dtype=jnp.uint32)
    return radiance(packed, request(first, -direction, u, settings.max_depth - 1, stream), key, settings).total
