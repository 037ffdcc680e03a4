"""A query's answer depends on its arguments alone: nobody ever gets the hits of another geometry, or of an older one.

Geometry: parallel squares, known by the height at which a ray along z meets them. Each test asks for heights.
"""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import warp as wp

from jaxdr.geometry import queries
from jaxdr.geometry.edges import INTERIOR
from jaxdr.geometry.queries import (
    IMPLEMENTATIONS,
    EdgePoints,
    EdgeSet,
    Geometry,
    Lines,
    Rays,
    StripQuery,
    bvh_cache,
)
from jaxdr.geometry.queries.warp import structures as warp_structures
from jaxdr.geometry.queries.warp.device_arrays import DeviceArrays
from jaxdr.geometry.shapes import sphere

SQUARE = jnp.asarray([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
FACES = jnp.asarray([[0, 1, 2], [0, 2, 3]], jnp.int32)
RAYS = 8
ORIGIN = jnp.zeros((RAYS, 3)).at[:, 0].set(jnp.linspace(-0.9, 0.8, RAYS)) - jnp.asarray([0.0, 0.03, 100.0])
UP = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), (RAYS, 3))
REACH = jnp.full(RAYS, 1e30)

both = pytest.mark.parametrize("implementation", IMPLEMENTATIONS)


def square(height):
    return SQUARE.at[:, 2].set(height)


def height(vertices, implementation="warp", origin=ORIGIN, faces=FACES):
    """Height of the square that rays from below meet; 1e9 for a miss."""
    hit = queries.closest_hit(Geometry(vertices, faces), Rays(origin, UP, REACH), implementation)
    return jnp.where(hit.face >= 0, origin[:, 2] + hit.t, 1e9)


def same(heights, expected):
    """Whether all rays of a batch (row) report the height of theirs."""
    rows = np.reshape(heights, (np.size(expected), -1))
    return np.allclose(rows, np.reshape(expected, (-1, 1)), atol=1e-4)


def updates_and_traces(implementation):
    """A jitted function that moves vertices, called with many motions, old ones among them."""
    moved = jax.jit(lambda h: height(SQUARE + jnp.asarray([0.0, 0.0, 1.0]) * h, implementation))
    return all(same(moved(h), h) for h in (0.0, 1.0, 2.0, 0.0, -3.0, 2.0, 5.0, 1.0))


def interleaves(implementation):
    """Two geometries of one topology, in turn within one program."""

    @jax.jit
    def trace(a, b):
        return jnp.concatenate([height(v, implementation) for v in (square(a), square(b), square(a), square(b))])

    return same(trace(1.0, 2.0), [1, 2, 1, 2]) and same(trace(2.0, 1.0), [2, 1, 2, 1])


def swaps_between_calls(implementation):
    """Two scenes of one topology that change places from call to call."""
    trace = jax.jit(lambda v: height(v, implementation))
    low, high = square(1.0), square(2.0)
    return all(same(trace(v), h) for _ in range(5) for v, h in ((low, 1.0), (high, 2.0)))


def updates_in_a_loop(implementation):
    """Vertices move inside of a scan."""

    def step(vertices, h):
        vertices = vertices + jnp.asarray([0.0, 0.0, 1.0]) * h
        return vertices, height(vertices, implementation)

    steps = jnp.asarray([1.0, 1.0, -2.0, 3.0, 0.0, 0.5])
    return same(jax.jit(lambda: jax.lax.scan(step, square(0.0), steps)[1])(), np.cumsum(steps))


SITUATIONS = [updates_and_traces, interleaves, swaps_between_calls, updates_in_a_loop]


@both
@pytest.mark.parametrize("situation", SITUATIONS)
def test_every_geometry_gets_its_own_hits(situation, implementation):
    assert situation(implementation)


@pytest.fixture
def stale(monkeypatch):
    """A cache that looks at shapes alone, as one keyed by anything but the content would."""
    for cache in warp_structures._caches.values():
        monkeypatch.setattr(cache, "entries", [])
    monkeypatch.setattr(bvh_cache, "_same", _alike)
    monkeypatch.setattr(DeviceArrays, "agree", lambda self, kept, given: map(_alike, kept, given))
    yield
    for cache in warp_structures._caches.values():
        cache.entries.clear()


@pytest.fixture
def device_arrays(monkeypatch):
    """Caches that compare and keep arrays as they do on a GPU, here on Warp's CPU device."""
    monkeypatch.setattr(warp_structures, "_caches", {})
    monkeypatch.setattr(warp_structures, "arrays_on", DeviceArrays)


@pytest.mark.parametrize("situation", SITUATIONS)
def test_the_same_with_arrays_of_a_device(situation, device_arrays):
    assert situation("warp")
    assert all(isinstance(cache.arrays, DeviceArrays) for cache in warp_structures._caches.values())


@pytest.mark.parametrize("situation", SITUATIONS)
def test_stale_geometry_of_a_device_is_noticed(situation, device_arrays, monkeypatch):
    """The test above can fail."""
    monkeypatch.setattr(DeviceArrays, "agree", lambda self, kept, given: map(_alike, kept, given))
    assert not situation("warp")


def _alike(a, b):
    return a.shape == b.shape and a.dtype == b.dtype


def test_structures_of_a_device_are_those_of_the_host(device_arrays, monkeypatch):
    """All three kinds, built and refitted: the same answers bit by bit. On the CPU, where both work."""
    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        _compare_structures(monkeypatch)


def _compare_structures(monkeypatch):
    mesh, key = sphere(3), jax.random.key(3)
    edges, count = mesh.edges, len(mesh.edges.vertices)
    edges = EdgeSet(edges.vertices, edges.faces, edges.opposite, edges.kind == INTERIOR, jnp.ones(count))
    origin = 3.0 * jax.random.normal(key, (4000, 3))
    direction = jax.random.normal(jax.random.fold_in(key, 1), (4000, 3))
    reach, none = jnp.full(4000, 50.0), jnp.zeros(4000, jnp.int32)

    def ask(scale):
        geometry = Geometry(mesh.vertices * scale, mesh.faces)
        unit = direction / jnp.linalg.norm(direction, axis=1, keepdims=True)
        shape = jnp.zeros(len(mesh.faces), jnp.int32)
        along = jnp.cross(unit, origin)  # segments that graze the sphere
        along /= jnp.linalg.norm(along, axis=1, keepdims=True)
        strips = StripQuery(unit - along, unit + along, along, jnp.ones(4000), jnp.full(4000, 0.2))
        middle = geometry.vertices[edges.ends].mean(1)
        points = EdgePoints(middle, jnp.arange(count, dtype=jnp.int32), jnp.full(count, 0.1))
        return (
            queries.closest_hit(geometry, Rays(origin, direction, reach), "warp"),
            queries.projections(geometry, shape, Lines(origin, unit, reach, none), 3, "warp"),
            queries.point_candidates(geometry, edges, points, strips, jnp.int32(5), 40000, implementation="warp"),
        )

    scales = (1.0, 1.1, 1.2, 1.3, 0.9)  # more than are kept of one topology
    found = [ask(s) for s in scales]
    kinds = {kind for kind, _ in warp_structures._caches}
    assert kinds == {"mesh", "faces", "points"}
    assert any(e.refits for cache in warp_structures._caches.values() for e in cache.entries)
    monkeypatch.setattr(warp_structures, "_caches", {})
    monkeypatch.setattr(warp_structures, "arrays_on", lambda device: bvh_cache.HostArrays())
    for ours, s in zip(found, scales, strict=True):
        jax.tree.map(np.testing.assert_array_equal, ours, ask(s))
    assert int(found[0][2].count) > 100 and (found[0][0].face >= 0).sum() > 100


def test_trees_are_of_the_kind_whose_depth_has_a_limit(monkeypatch):
    """Others, such as Warp's default for GPUs, overflow the stack of its queries without a word."""
    asked = []

    def recorded(name, option):
        made = getattr(wp, name)
        monkeypatch.setattr(wp, name, lambda *a, **options: asked.append(options.get(option)) or made(*a, **options))

    recorded("Mesh", "bvh_constructor")
    recorded("Bvh", "constructor")
    vertices, faces = np.asarray(SQUARE, np.float32), np.asarray(FACES, np.int32)
    radius = np.ones(4, np.float32)
    device = wp.get_device("cpu")
    for kind, moving, topology in (
        ("mesh", [vertices], [faces]),
        ("faces", [vertices], [faces]),
        ("points", [vertices, radius], []),
    ):
        warp_structures._STRUCTURES[kind](moving, topology, device)
    assert asked == ["sah"] * 3


@pytest.mark.parametrize("situation", SITUATIONS)
def test_stale_geometry_is_noticed(situation, stale):
    """The tests above can fail."""
    assert not situation("warp")


@both
def test_vmap_over_rays(implementation):
    """A batch of rays is one larger batch, with the same answers."""
    origins = ORIGIN + jnp.arange(3.0)[:, None, None] * jnp.asarray([0.0, 0.1, 1.0])
    together = jax.jit(jax.vmap(lambda o: height(square(1.5), implementation, o)))(origins)
    assert same(together, [1.5, 1.5, 1.5])
    geometry = Geometry(square(1.5), FACES)
    free = jax.vmap(lambda o, t: queries.occluded(geometry, Rays(o, UP, t), implementation))(
        origins, jnp.asarray([[50.0], [150.0], [50.0]]) * jnp.ones(RAYS)
    )
    np.testing.assert_array_equal(free, np.array([[False], [True], [False]]) * np.ones((3, RAYS), bool))


@both
def test_vmap_over_vertices(implementation):
    heights = jnp.asarray([1.0, -2.0, 3.0, 1.0])
    together = jax.jit(jax.vmap(lambda h: height(square(h), implementation)))(heights)
    assert same(together, heights)
    # Over geometries and rays at once, and a vmap in a vmap.
    grid = jax.vmap(
        lambda h: jax.vmap(lambda o: height(square(h), implementation, o))(ORIGIN[None] + jnp.zeros((2, 1, 1)))
    )
    assert same(jax.jit(grid)(heights), heights)


@both
def test_other_queries_follow_their_vertices(implementation):
    @jax.jit
    def ask(h):
        geometry = Geometry(square(h), FACES)
        none, depth = jnp.zeros(RAYS, jnp.int32), jnp.full(RAYS, 101.5)
        found = queries.projections(
            geometry, jnp.zeros(len(FACES), jnp.int32), Lines(ORIGIN, UP, depth, none), 2, implementation
        )
        return queries.occluded(geometry, Rays(ORIGIN, UP, depth), implementation), found.height[:, 0], found.count

    for h in (1.0, 2.0, 0.5, 1.0, 3.0):
        blocked, height, count = ask(h)
        assert np.all(np.asarray(blocked) == (h < 1.5)) and np.all(np.asarray(count) == (h < 1.5))
        assert h > 1.5 or np.allclose(height, 100 + h, atol=1e-4)


def test_more_geometries_than_the_cache_holds():
    """Evicted and refitted structures answer as fresh ones do: many geometries, in turns, some of them alike."""
    trace = jax.jit(height)
    fans = [jnp.concatenate([square(float(k)), jnp.full((k % 4, 3), 50.0)]) for k in range(40)]  # four topologies
    rng = np.random.default_rng(18)
    for k in rng.integers(40, size=200):
        assert same(trace(fans[k]), float(k))
    for cache in warp_structures._caches.values():
        assert len(cache.entries) <= cache.capacity


def test_threads_with_different_scenes():
    """Threads move and trace their own scenes at once; the batches are large enough to be split over threads."""
    mesh = sphere(3)
    directions = np.random.default_rng(19).standard_normal((20000, 3)).astype(np.float32)
    directions = jnp.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    origin, reach = jnp.zeros_like(directions), jnp.full(len(directions), 1e30)

    @jax.jit
    def radius(scale):
        hit = queries.closest_hit(Geometry(mesh.vertices * scale, mesh.faces), Rays(origin, directions, reach))
        return hit.t.min(), hit.t.max(), hit.face.min()

    def work(base):
        for k in range(25):
            scale = base + k % 3
            low, high, face = radius(scale)
            assert face >= 0 and 0.95 * scale < low <= high < 1.0001 * scale, f"{low} … {high} instead of {scale}"
        return True

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, [1.0, 10.0, 100.0, 1000.0]))
