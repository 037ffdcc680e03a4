"""Silhouettes in cones, the nearest and all: `warp` against `jax`, and against all edges in float64 without trees."""

from contextlib import nullcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import queries
from jaxdr.geometry.queries import ConeQuery, EdgeSet
from jaxdr.geometry.shapes import rectangle
from jaxdr.scene.packed import pack
from tests.geometry.queries.query_meshes import make

COUNT = 800
NAMES = ["sphere, flattened", "bumps", "box, rotated", "plane", "bumps, far away"]
CAMERA = jd.Perspective(jd.look_at([3, -3, 3], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(8, 8))


def random_cones(mesh, seed=0):
    """Apexes in and around a mesh, directions everywhere; half have a horizon, a quarter a reach, some none at all."""
    rng = np.random.default_rng(seed)
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    apex = 0.5 * (low + high) + np.linalg.norm(high - low) * rng.uniform(-1, 1, (COUNT, 3))
    direction, normal = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.standard_normal((2, COUNT, 3)))
    normal[::2] = 0
    reach = np.full(COUNT, 4.0)
    reach[::4], reach[::50] = 0.3, 0.0
    return ConeQuery(*(jnp.asarray(a, jnp.float32) for a in (apex, direction, normal, reach)))


def edges_of(mesh, implementation):
    """Geometry and edges beside a rectangle, whose edges all have rank zero."""
    packed = pack(jd.Scene({"mesh": jd.Shape(mesh), "none": jd.Shape(rectangle(9.0, 9.0))}, CAMERA))
    rank = jnp.where(packed.edges.shape == 0, 1.0, 0.0).astype(jnp.float32)
    edges = EdgeSet.of(packed.edges, rank)
    tree = queries.edge_tree(packed.geometry, edges, packed.edge_counts, implementation)
    return packed.geometry, edges._replace(tree=tree)


def closest(geometry, edges, cones, implementation):
    found = jax.jit(queries.closest_silhouettes, static_argnums=3)(geometry, edges, cones, implementation)
    return jax.tree.map(np.asarray, found)


def angles(geometry, edges, cones, found):
    """Float64 angles of the points that were found, infinite where nothing was."""
    edge = np.maximum(found.edge, 0)
    ends = np.asarray(geometry.vertices, float)[np.asarray(edges.ends)[edge]]
    point = ends[:, 0] + found.along[:, None] * (ends[:, 1] - ends[:, 0]) - np.asarray(cones.apex, float)
    return np.where(found.edge >= 0, _angle(point, np.asarray(cones.direction, float)), np.inf)


def _angle(offset, direction):
    cosine = (offset * direction).sum(-1) / np.linalg.norm(offset, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1))


def least(geometry, edges, cones, number):
    """The smallest angle to a silhouette, by dense points on all edges, and how much finer points could lower it."""
    vertices, apex, direction = (np.asarray(a, float) for a in (geometry.vertices, cones.apex, cones.direction))
    ends, opposite = vertices[np.asarray(edges.ends)], np.asarray(edges.opposite)
    x, w, n = apex[number], direction[number], np.asarray(cones.normal, float)[number]
    first, last = ends[:, 0] - x, ends[:, 1] - x
    plane = np.cross(first, last)
    height = np.where(opposite >= 0, np.einsum("ej,ekj->ek", plane, vertices[opposite] - x), np.nan)
    counts = (np.nanmin(height, 1) > 0) | (np.nanmax(height, 1) < 0)
    counts &= (np.asarray(edges.rank) > 0) & ((np.maximum(first @ n, last @ n) > 0) | (n @ n == 0))
    t = np.linspace(0, 1, 201)[:, None]
    points = first[counts, None] + t * (last - first)[counts, None]
    angle = _angle(points, w)
    step = np.abs(np.diff(angle, axis=1)).max(initial=0.0)
    best = angle.min(initial=np.inf)
    return (best if best < float(cones.reach[number]) else np.inf), step


@pytest.mark.parametrize("name", NAMES)
def test_the_nearest_silhouette_is_found(name):
    """Both implementations find points at the same angles, with and without horizon and reach."""
    mesh = make(name)
    cones = random_cones(mesh)
    geometry, edges = edges_of(mesh, "warp")
    found, plain = (closest(geometry, edges, cones, implementation) for implementation in ("warp", "jax"))
    ours, others = angles(geometry, edges, cones, found), angles(geometry, edges, cones, plain)
    assert np.all(found.edge[np.asarray(cones.reach) == 0] == -1) and np.all((found.along >= 0) & (found.along <= 1))
    assert 0.2 < np.mean(found.edge >= 0) < 0.99
    same = (found.edge == plain.edge) | np.isclose(ours, others, rtol=0, atol=1e-5)
    # Where all planes of faces pass the apex by rounding, an edge may be a silhouette to one of both only.
    assert same.mean() > 0.998, np.flatnonzero(~same)
    for number in range(3, 100, 7):
        exact, step = least(geometry, edges, cones, number)
        near = np.isclose(ours[number], exact) or -1e-5 - step < ours[number] - exact < 1e-5
        assert near, (number, ours[number], exact)


def test_batches_and_shared_trees():
    """`vmap` over cones gives what one list of them gives, and both builders of the tree agree."""
    mesh = make("bumps")
    cones = random_cones(mesh)
    geometry, edges = edges_of(mesh, "jax")
    one = closest(geometry, edges, cones, "warp")
    split = jax.tree.map(lambda a: a.reshape(2, -1, *a.shape[1:]), cones)
    both = jax.vmap(lambda c: queries.closest_silhouettes(geometry, edges, c, "warp"))(split)
    assert np.array_equal(np.asarray(both.edge).reshape(-1), one.edge)
    of_warp = closest(*edges_of(mesh, "warp"), cones, "warp")
    assert np.mean(of_warp.edge == one.edge) > 0.99


def listed(geometry, edges, cones, implementation, capacity=1 << 19):
    call = jax.jit(queries.silhouettes, static_argnums=(4, 5))
    return jax.tree.map(np.asarray, call(geometry, edges, cones, jnp.int32(0), capacity, implementation))


def pairs(found):
    there = found.segment >= 0
    return set(zip(found.segment[there].tolist(), found.element[there].tolist(), strict=True))


def pairs_in_float64(geometry, edges, cones, number):
    """(silhouettes of a cone, edges for which rounding may decide)."""
    vertices, apex = np.asarray(geometry.vertices, float), np.asarray(cones.apex, float)[number]
    ends, opposite = vertices[np.asarray(edges.ends)], np.asarray(edges.opposite)
    w, n = (np.asarray(a, float)[number] for a in (cones.direction, cones.normal))
    first, last = ends[:, 0] - apex, ends[:, 1] - apex
    plane = np.cross(first, last)
    plane /= np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-30)
    height = np.where(opposite >= 0, np.einsum("ej,ekj->ek", plane, vertices[opposite] - apex), np.nan)
    low, high, above = np.nanmin(height, 1), np.nanmax(height, 1), np.maximum(first @ n, last @ n)
    t = np.linspace(0, 1, 201)[:, None]
    angle = _angle(first[:, None] + t * (last - first)[:, None], w).min(1)
    reach = float(cones.reach[number])
    counts = ((low > 0) | (high < 0)) & (np.asarray(edges.rank) > 0) & (angle < reach)
    unsure = (np.minimum(np.abs(low), np.abs(high)) < 1e-5) | (np.abs(angle - reach) < 1e-2)
    if n.any():
        counts &= above > 0
        unsure |= np.abs(above) < 1e-5
    return set(np.flatnonzero(counts).tolist()), set(np.flatnonzero(unsure).tolist())


@pytest.mark.parametrize("name", NAMES)
def test_all_silhouettes_are_found(name):
    """Those of every cone, once; both implementations agree."""
    mesh = make(name)
    cones = random_cones(mesh)
    geometry, edges = edges_of(mesh, "warp")
    found, plain = (listed(geometry, edges, cones, implementation) for implementation in ("warp", "jax"))
    ours, others = pairs(found), pairs(plain)
    assert found.weight == plain.weight == 1.0 and len(ours) == found.count == (found.segment >= 0).sum()
    assert len(ours ^ others) < 2e-3 * len(ours), len(ours ^ others)
    assert not {cone for cone, _ in ours} & set(np.flatnonzero(np.asarray(cones.reach) == 0).tolist())
    for number in range(3, 200, 7):
        exact, unsure = pairs_in_float64(geometry, edges, cones, number)
        mine = {edge for cone, edge in ours if cone == number}
        assert (mine ^ exact) <= unsure, (number, (mine ^ exact) - unsure)


@pytest.mark.parametrize("implementation", ["warp", "jax"])
def test_long_lists_are_thinned_without_bias(implementation):
    """A quarter of the room is needed four times: every pair survives as often as the weight says."""
    mesh = make("bumps")
    cones = jax.tree.map(lambda a: a[:40], random_cones(mesh))
    geometry, edges = edges_of(mesh, "warp")
    every = listed(geometry, edges, cones, "warp")
    capacity = int(every.count) // 4
    call = jax.jit(queries.silhouettes, static_argnums=(4, 5))
    total, squares = np.zeros(40), np.zeros(40)
    with pytest.warns(UserWarning, match="thinned without bias") if implementation == "warp" else nullcontext():
        for seed in range(50):
            found = call(geometry, edges, cones, jnp.int32(seed), capacity, implementation)
            cone = np.asarray(found.segment)
            number = float(found.weight) * np.bincount(cone[cone >= 0], minlength=40)
            total, squares = total + number / 50, squares + number**2 / 50
    expected = np.bincount(every.segment[every.segment >= 0], minlength=40)
    error = np.sqrt((squares - total**2) / 50)
    assert np.all(np.abs(total - expected) <= 4.5 * error), (total, expected, error)
