"""Silhouettes that cut planar sectors: `warp` and `jax` against layers counted in float64, and against each other."""

import warnings
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry import queries, shapes
from jaxdr.geometry.edge_tree import build_edge_tree
from jaxdr.geometry.edges import INTERIOR
from jaxdr.geometry.queries import NO_GROUP, UNBOUNDED
from tests.geometry.queries.query_meshes import MESHES, affine, make

COUNT = 400
OPEN = jd.Mesh([[0, 0, 0], [1, 0, 0.2], [0.2, 1, 0], [1, 1, 0.4], [0.4, 0.4, 0.9]], [[0, 1, 2], [1, 3, 2], [1, 2, 4]])


def joined(*meshes):
    """One mesh of several."""
    first = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [np.asarray(m.faces) + f for m, f in zip(meshes, first, strict=False)]
    return jd.Mesh(np.concatenate([np.asarray(m.vertices) for m in meshes]), np.concatenate(faces))


def unwelded(mesh):
    """Every face on its own: each edge is there twice, with one face each."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    return jd.Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


SHAPES = {name: lambda name=name: make(name) for name in MESHES} | {
    "open": lambda: OPEN,
    "nested": lambda: joined(shapes.sphere(2), shapes.displaced_sphere(2, radius=0.5)),
    "interpenetrating": lambda: joined(
        shapes.sphere(2), shapes.transformed(shapes.torus(), affine(0.5, (0.8, 0.0, 0)))
    ),
    "apart": lambda: joined(shapes.sphere(2), shapes.transformed(shapes.torus(), affine(0.3, (0.0, 0.0, 1.6)))),
    "three faces at an edge": lambda: jd.Mesh(
        [[0, 0, -1], [0, 0, 1], [1, 0, 0], [-1, 0.3, 0], [0, 1, 0.1]], [[0, 1, 2], [1, 0, 3], [0, 1, 4]]
    ),
}


def random_chords(mesh, count=COUNT, seed=0):
    """Apexes around a mesh and chords behind it, which nothing pierces, float32: (apex, first, last)."""
    rng = np.random.default_rng(seed)
    vertices = np.asarray(mesh.vertices, float)
    low, high = vertices.min(0), vertices.max(0)
    middle, size = (low + high) / 2, np.linalg.norm(high - low)
    towards = rng.normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    apex = -towards * rng.uniform(0.55, 1.5, (count, 1))
    across = rng.normal(size=(2, count, 3))
    across -= (across * towards).sum(-1, keepdims=True) * towards
    target = towards * rng.uniform(0.55, 1.2, (count, 1)) + 0.4 * across[0]
    return tuple((middle + size * x).astype(np.float32) for x in (apex, target - across[1], target + across[1]))


@partial(jax.jit, static_argnames=("implementation", "capacity", "least"))
def crossings(mesh, rank, apex, first, last, centre, needed, group, face_group, implementation, capacity, least=1):
    """The query with a tree of its own."""
    edges = mesh.edges
    interior = edges.kind == INTERIOR
    tree = build_edge_tree(mesh.vertices, edges.vertices, edges.opposite, interior, rank)
    return queries.sector_crossings(
        queries.Geometry(mesh.vertices, mesh.faces),
        queries.EdgeSet(edges.vertices, edges.faces, edges.opposite, interior, rank, tree),
        face_group,
        queries.SectorQuery(apex, first, last, centre, needed, group),
        jnp.int32(7),
        least,
        capacity,
        implementation,
    )


def ask(mesh, apex, first, last, implementation="warp", group=NO_GROUP, rank=1.0, face_group=None, capacity=None):
    """(pairs found as a set of (chord, edge), the answer); edges of rank 2 are resolved by rays."""
    count = len(apex)
    face_group = jnp.full(len(mesh.faces), -1) if face_group is None else face_group
    centre = np.random.default_rng(5).uniform(0.1, 0.9, count).astype(np.float32)
    ranks = jnp.full(mesh.edges.vertices.shape[0], rank)
    chords = (jnp.asarray(x) for x in (apex, first, last, centre, np.full(count, rank, np.float32)))
    groups = jnp.full(count, group), face_group
    options = {"implementation": implementation, "capacity": capacity or 40 * count}
    found = crossings(mesh, ranks, *chords, *groups, **options)
    chord, edge = np.asarray(found.chord), np.asarray(found.edge)
    used = chord >= 0
    return set(zip(chord[used].tolist(), edge[used].tolist(), strict=True)), found


def layers(corners, origin, directions):
    """[D]: faces between the origin and the end of every direction, float64."""
    a, b, c = (corners[:, k] - origin for k in range(3))
    u = [directions @ np.cross(p, q).T for p, q in ((b, c), (c, a), (a, b))]
    inside = np.all([x > 0 for x in u], 0) | np.all([x < 0 for x in u], 0)
    normal = np.cross(b - a, c - a)
    t = (a * normal).sum(-1) / (directions @ normal.T)
    return (inside & (t > 0) & (t < 1)).sum(1)


def reference(mesh, apex, first, last):
    """(certain pairs, doubtful ones): float64, layers counted on both sides of every edge that cuts the sector.

    Doubtful are crossings so close to another one, or to an end, that rounding may change them.
    """
    vertices, edges = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.edges.vertices)
    faces = np.asarray(mesh.faces)
    corners = vertices[faces]
    certain, doubtful = set(), set()
    for i in range(len(apex)):
        a, u0, u1 = apex[i].astype(float), first[i].astype(float) - apex[i], last[i].astype(float) - apex[i]
        normal = np.cross(u0, u1)
        p0, p1 = vertices[edges[:, 0]] - a, vertices[edges[:, 1]] - a
        h0, h1 = p0 @ normal, p1 @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            x = p0 + (h0 / (h0 - h1))[:, None] * (p1 - p0)
            alpha, beta = np.cross(x, u1) @ normal, np.cross(u0, x) @ normal
            share, place = (alpha + beta) / (normal @ normal), beta / (alpha + beta)
        cuts = (h0 * h1 < 0) & (alpha > 0) & (beta > 0) & (share < 1)
        candidates = np.flatnonzero(cuts)
        candidates = candidates[np.argsort(place[candidates])]
        if not len(candidates):
            continue
        step = 1e-6
        at = np.concatenate([place[candidates] - step, place[candidates] + step])
        above = ((vertices - a) @ normal > 0)[faces]
        in_plane = above.any(1) & ~above.all(1)  # no other face has an inner point in the plane of the sector
        counts = layers(corners[in_plane], a, (1 - at)[:, None] * u0 + at[:, None] * u1)
        before, after = np.split(counts, 2)
        changes = (before == 0) != (after == 0)
        gap = np.diff(place[candidates], prepend=-1, append=2)
        crowded = np.minimum(gap[:-1], gap[1:]) < 3 * step
        doubtful |= {(i, int(e)) for e in candidates[crowded]}
        certain |= {(i, int(e)) for e in candidates[changes & ~crowded]}
    return certain, doubtful


@pytest.mark.parametrize("name", SHAPES)
def test_crossings_are_where_the_layers_change(name):
    mesh = SHAPES[name]()
    chords = random_chords(mesh)
    certain, doubtful = reference(mesh, *chords)
    assert len(certain) > 0.1 * COUNT, "the chords don't test much"
    found, answer = ask(mesh, *chords)
    wrong = (found ^ certain) - doubtful
    assert len(wrong) <= 0.002 * len(certain), f"{len(wrong)} of {len(certain)} are wrong: {sorted(wrong)[:5]}"
    assert np.asarray(answer.counts)[1] <= 0.005 * COUNT, "too many inconsistent counts"


@pytest.mark.parametrize("name", ["sphere", "bumps", "torus", "trefoil", "open", "box", "nested"])
def test_the_plain_implementation(name):
    mesh = SHAPES[name]()
    chords = random_chords(mesh, count=150)
    certain, doubtful = reference(mesh, *chords)
    found, _ = ask(mesh, *chords, implementation="jax")
    wrong = (found ^ certain) - doubtful
    assert len(wrong) <= 0.02 * len(certain), f"{len(wrong)} of {len(certain)} are wrong: {sorted(wrong)[:5]}"


@pytest.mark.parametrize("name", ["bumps", "trefoil", "nested", "bumps, far away", "bumps, tiny"])
def test_rays_find_what_layers_find(name):
    """Where only some edges are looked at, a ray past each decides."""
    mesh = SHAPES[name]()
    chords = random_chords(mesh)
    counted, _ = ask(mesh, *chords)
    seen, _ = ask(mesh, *chords, rank=2.0)
    # A thousand units from the origin the rays pass the edges at a sizeable distance.
    share = 0.05 if name == "bumps, far away" else 0.02
    assert len(seen ^ counted) <= share * len(counted), sorted(seen ^ counted)[:5]


@pytest.mark.parametrize("implementation", ["warp", "jax"])
def test_sectors_without_an_end(implementation):
    """All visible silhouettes in the sector: what a chord far behind everything finds, and those hidden by nothing."""
    mesh = SHAPES["nested"]()
    apex, first, last = random_chords(mesh, count=150)
    first, last = apex + 10 * (first - apex), apex + 10 * (last - apex)
    visible, _ = ask(mesh, apex, first, last, implementation)
    found, _ = ask(mesh, apex, first, last, implementation, group=UNBOUNDED)
    # An edge before another surface bounds what is visible as well.
    assert len(visible - found) <= 0.02 * len(visible)
    corners = np.asarray(mesh.vertices, float)[np.asarray(mesh.faces)]
    for chord, edge in found - visible:
        ends = np.asarray(mesh.vertices, float)[np.asarray(mesh.edges.vertices)[edge]]
        a = apex[chord].astype(float)
        normal = np.cross(first[chord] - a, last[chord] - a)
        h0, h1 = (ends - a) @ normal
        point = ends[0] + h0 / (h0 - h1) * (ends[1] - ends[0])
        assert layers(corners, a, 0.998 * (point - a)[None])[0] == 0, "a hidden edge"


def test_faces_of_the_group_hide_nothing():
    """A chord on a square, before which there is a smaller one."""
    square = shapes.transformed(shapes.rectangle(2.0, 2.0), affine(1.0))
    mesh = joined(square, shapes.transformed(shapes.rectangle(0.5, 0.5), affine(1.0, (0.0, 0.0, 0.5))))
    count = 64
    rng = np.random.default_rng(0)
    apex = np.concatenate([rng.uniform(-0.1, 0.1, (count, 2)), np.full((count, 1), 1.5)], 1).astype(np.float32)
    angle = rng.uniform(0, np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1).astype(np.float32)
    group = jnp.asarray([0, 0, -1, -1])
    found, answer = ask(mesh, apex, -along, along, group=0, face_group=group)
    assert len(found) == 2 * count, "each chord crosses the outline of the small square twice"
    assert np.asarray(answer.counts)[1] == 0


def test_chords_of_many_crossings():
    """More crossings than a chord's list has room for: it is walked several times, and nothing is lost."""
    sticks = [shapes.transformed(shapes.box(), affine((0.01, 1.0, 0.01), (0.05 * k, 0.0, 0.0))) for k in range(40)]
    mesh = joined(*sticks)
    apex = np.array([[0.9, 0.01, 3.0]], np.float32)
    ends = (np.array([[x, 0.013, -1.0]], np.float32) for x in (-1.0, 3.0))
    chords = (apex, *ends)
    certain, doubtful = reference(mesh, *chords)
    found, answer = ask(mesh, *chords, capacity=200)
    assert len(certain) > 64
    assert np.asarray(answer.counts)[2] == 1
    assert not (found ^ certain) - doubtful


@pytest.mark.parametrize("implementation", ["warp", "jax"])
def test_thinning_is_unbiased(implementation):
    mesh = SHAPES["bumps"]()
    chords = random_chords(mesh)
    every = len(ask(mesh, *chords, implementation)[0])
    capacity = round(0.7 * every)
    with_warning = pytest.warns(UserWarning, match="exceed the capacity") if implementation == "warp" else None
    if with_warning:
        with with_warning:
            found, answer = ask(mesh, *chords, implementation, capacity=capacity)
    else:
        found, answer = ask(mesh, *chords, implementation, capacity=capacity)
    assert len(found) <= capacity
    kept = len(found) * float(answer.weight)
    deviation = np.sqrt(every * (float(answer.weight) - 1.0))
    assert abs(kept - every) < 4 * deviation
    assert np.asarray(answer.counts)[0] == every


def test_thinning_is_said_once():
    """However often it happens and however many crossings there are: steps of an optimisation differ in that."""
    mesh = SHAPES["bumps"]()
    chords = random_chords(mesh)
    room = round(0.7 * len(ask(mesh, *chords)[0]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for size in (1.0, 1.02):
            ask(mesh.with_vertices(size * mesh.vertices), *chords, capacity=room)
    assert len(caught) == 1


def test_duplicated_edges_cancel_or_count_once():
    """An unwelded mesh has every edge twice, one face each: where one opens and the other closes nothing changes."""
    mesh = SHAPES["sphere"]()
    chords = random_chords(mesh)
    found, _ = ask(mesh, *chords)
    apart = unwelded(mesh)
    twice, _ = ask(apart, *chords)

    def places(of, pairs):
        middle = np.asarray(of.vertices)[np.asarray(of.edges.vertices)].mean(1)
        rows = [(i, *np.round(middle[e], 4)) for i, e in pairs]
        return {row for row in rows if rows.count(row) % 2 == 1}

    assert len(places(mesh, found) ^ places(apart, twice)) <= 0.01 * len(found)


def test_few_nodes_are_visited():
    """The cost of a query grows slowly: 64 times as many triangles, less than twice the nodes."""
    visited = []
    for level in (3, 6):
        mesh = shapes.displaced_sphere(level)
        chords = random_chords(mesh, count=2000)
        _, answer = ask(mesh, *chords)
        visited.append(np.asarray(answer.counts)[3] / 2000)
    assert visited[1] < 2 * visited[0] + 100, visited
