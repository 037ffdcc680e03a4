"""Bidirectional path tracing (Veach 1997, chapter 10; Lafortune and Willems 1993): one chunk of samples."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxdr.geometry import queries
from jaxdr.scene.film import Film
from jaxdr.scene.packed import PackedScene
from jaxdr.scene.splat import splat
from jaxdr.transport.connections import (
    Connections,
    ends,
    found_emission,
    with_camera,
    with_each_other,
    with_emitters,
)
from jaxdr.transport.emission import EmitterSample, sample_emitter
from jaxdr.transport.primary import Form, PrimarySamples, primary_samples
from jaxdr.transport.sampler import lattice, uniform
from jaxdr.transport.subpaths import Subpath, camera_start, light_start, trace_on

LIGHT_DIMENSIONS = 4  # point on the emitter, direction from there


class BidirectionalSettings(NamedTuple):
    """Static settings: `max_depth` in segments, `power` of the heuristic (1 balance, 2 power), query implementation."""

    max_depth: int
    power: int
    rays: str


class Drawn(NamedTuple):
    """Everything that was drawn for N pairs of subpaths.

    - `camera`, `light`: vertices x_1, x_2, ... from the camera [B, N] and from emitters [I, N].
    - `start`: the emitter samples [N] from which the subpaths `light` begin.
    - `direct`: the emitter samples [I, N] that the first I vertices from the camera are joined with.
    - `lens`: uniform numbers of lens points [I, N, 2]; None without an aperture.
    """

    camera: Subpath
    light: Subpath
    start: EmitterSample
    direct: EmitterSample
    lens: Float[Array, "I N 2"] | None


class Strategies(NamedTuple):
    """Contributions of N pairs of subpaths by each strategy, [C, N, ...]; weights are detached.

    `names` are (s, t). The first strategies contribute to the subpath's own pixel. The last `film_points.shape[0]`
    strategies have t = 1. They contribute to the film around `film_points`, per square pixel, as if every pixel had one
    such path. `drawn` is None if no vertices are joined.
    """

    names: tuple[tuple[int, int], ...]
    value: Float[Array, "C N 3"]
    weight: Float[Array, "C N"]
    film_points: Float[Array, "T N 2"] | None
    drawn: Drawn | None = None

    def image(
        self, film: Film, values: Float[Array, "C N 3"], share: Float[Array, " n"], moving: bool
    ) -> Float[Array, "H W 3"]:
        """Image of `values` of all strategies. `share`: weights of the samples of a pixel, which are in a row in N.

        The film points of t = 1 are differentiated if `moving`.
        """
        _, _, width, height = film.window
        pixels = width * height
        seen = 0 if self.film_points is None else self.film_points.shape[0]
        own = values[: values.shape[0] - seen].sum(0)
        image = (own.reshape(pixels, share.shape[0], 3) * share[:, None]).sum(1).reshape(height, width, 3)
        if self.film_points is None:
            return image
        spread = (values[values.shape[0] - seen :] * jnp.tile(share, pixels)[:, None]).reshape(-1, 3)
        return image + splat(film, self.film_points.reshape(-1, 2), spread, moving)


def bidirectional_paths(
    packed: PackedScene,
    samples: Int[Array, " n"],
    key: PRNGKeyArray,
    chunk_key: PRNGKeyArray,
    settings: BidirectionalSettings,
    moving: bool,
) -> tuple[PrimarySamples, Strategies]:
    """First hits of the samples numbered `samples` of every pixel, and the contributions of paths through them.

    `moving`: in the derivative, surfaces move relative to the camera. Then first hits are material points, and the
    pixel filter is differentiated.
    """
    _, _, width, height = packed.camera.film.window
    pixels = width * height
    primary = primary_samples(packed, samples, key, settings.rays, Form.MATERIAL if moving else Form.FIXED)
    number = (jnp.arange(pixels)[:, None] + samples[None] * pixels).reshape(-1)
    light = lattice(jax.random.fold_in(key, 1), 1, number, LIGHT_DIMENSIONS, packed.vertices.dtype)
    return primary, strategies(packed, primary, light, chunk_key, settings)


def strategies(
    packed: PackedScene,
    primary: PrimarySamples,
    u: Float[Array, "N 4"],
    key: PRNGKeyArray,
    settings: BidirectionalSettings,
) -> Strategies:
    """Every strategy for pairs of a camera subpath, from a first hit, and a subpath from an emitter, from numbers `u`.

    Shadow rays of all connections are cast at once: (depth - 1) (depth + 2) / 2 for each pair. The subpaths themselves
    need 2 depth - 1 rays.
    """
    depth, power, rays = settings.max_depth, settings.power, settings.rays
    paths, dtype = u.shape[0], u.dtype
    keys = jax.random.split(key, 5)
    start = camera_start(packed, primary)
    # Paths can only meet surfaces and the environment. If these emit nothing, the last vertex is not needed.
    met = packed.has_area_emitters or packed.environment is not None
    bounces = max(depth - 1 if met else depth - 2, 0)
    steps = uniform(keys[0], (bounces, paths, 2), dtype)
    steps = jnp.concatenate([primary.u[None, :, 2:], steps[1:]]) if bounces else steps
    camera = trace_on(packed, start, steps, False, power, rays)
    names, values, weights = [], [], []
    if met:
        value, weight = found_emission(packed, camera, power)
        names += [(0, t) for t in range(2, depth + 2)]
        values, weights = [value], [weight]
    if depth == 1:
        if not met:
            return Strategies(((0, 2),), jnp.zeros((1, paths, 3), dtype), jnp.ones((1, paths), dtype), None)
        return Strategies(tuple(names), value, weight, None)

    inner = depth - 1
    sample = sample_emitter(packed, u[:, :2])
    first = light_start(packed, sample, u[:, 2:], power, rays)
    light = trace_on(packed, first, uniform(keys[1], (inner - 1, paths, 2), dtype), True, power, rays)
    z, y = ends(packed, camera, inner), ends(packed, light, inner)
    direct = uniform(keys[2], (inner, paths, 2), dtype).at[0].set(primary.u[:, :2])
    samples = sample_emitter(packed, direct.reshape(-1, 2))
    joined = [with_emitters(packed, z, samples, power)]
    names += [(1, t) for t in range(2, depth + 1)]
    pairs = joined_vertices(inner)
    if pairs:
        joined.append(with_each_other(z.rows([i for i, _ in pairs]), y.rows([j for _, j in pairs]), power))
        names += [(j + 2, i + 2) for i, j in pairs]
    lens = uniform(keys[3], (inner * paths, 2), dtype) if packed.camera.aperture else None
    seen, film_points = with_camera(packed, y, lens, power)
    joined.append(seen)
    names += [(s, 1) for s in range(2, depth + 1)]

    every = Connections(*(jnp.concatenate(parts) for parts in zip(*joined, strict=True)))
    visible = _visible(packed, every, rays)
    value = jnp.where(visible[:, None], every.value, 0.0).reshape(-1, paths, 3)
    values, weights = [*values, value], [*weights, every.weight.reshape(-1, paths)]
    by_vertex = jax.tree.map(lambda a: a.reshape(inner, paths, *a.shape[1:]), (samples, film_points, lens))
    samples, film_points, lens = by_vertex
    drawn = Drawn(camera, light, sample, samples, lens)
    return Strategies(tuple(names), jnp.concatenate(values), jnp.concatenate(weights), film_points, drawn)


def joined_vertices(inner: int) -> list[tuple[int, int]]:
    """(i, j) for which vertex 1 + i from the camera is joined with vertex 1 + j from emitters, both below `inner`."""
    return [(i, j) for i in range(inner) for j in range(inner - 1 - i)]


def _visible(packed: PackedScene, joined: Connections, rays: str) -> Bool[Array, " C"]:
    """Which connections carry light and are not blocked."""
    reach = jnp.where(joined.carries, 1.0, 0.0).astype(joined.value.dtype)
    offset = joined.end - joined.start
    return joined.carries & ~queries.occluded(packed.geometry, queries.Rays(joined.start, offset, reach), rays)
