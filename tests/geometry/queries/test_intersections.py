"""Where faces pass through each other: `warp` and `jax` against plane sections by trimesh, and against each other."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxdr.geometry import queries, shapes
from jaxdr.geometry.queries import IMPLEMENTATIONS

ROOM = 4096


def joined(*meshes):
    """(vertices, faces, the number of each face's mesh) of several meshes."""
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [np.asarray(mesh.faces) + start for mesh, start in zip(meshes, first, strict=False)]
    number = np.repeat(np.arange(len(meshes)), [len(f) for f in faces])
    return np.concatenate([np.asarray(m.vertices, np.float32) for m in meshes]), np.concatenate(faces), number


compiled = jax.jit(queries.face_intersections, static_argnames=("capacity", "implementation"))


def ask(implementation, vertices, faces, moving, capacity=ROOM, seed=1):
    geometry = queries.Geometry(jnp.asarray(vertices), jnp.asarray(faces, jnp.int32))
    moves = jnp.asarray(moving)
    found = compiled(geometry, moves, jnp.int32(seed), capacity=capacity, implementation=implementation)
    kept = np.asarray(found.first) >= 0
    pairs = np.stack([found.first, found.second], -1)[kept]
    return pairs, np.asarray(found.ends)[kept], int(found.count), float(found.weight)


def on_triangles(points, triangles):
    """Distances of points from the closest points of triangles, row by row."""
    return np.linalg.norm(points - trimesh.triangles.closest_point(triangles, points), axis=-1)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_a_plane_cuts_a_sphere(implementation, scale):
    """The curve is as long as trimesh's section, and all of it lies on both surfaces."""
    ball, floor = shapes.sphere(3, radius=0.5 * scale, center=(0, 0, 0.2 * scale)), shapes.plane(4.0 * scale)
    vertices, faces, number = joined(ball, floor)
    pairs, ends, count, weight = ask(implementation, vertices, faces, number == 0)
    assert count == len(pairs) and weight == 1
    assert (number[pairs] == [0, 1]).all()
    whole = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    lines = trimesh.intersections.mesh_plane(whole, [0, 0, 1], [0, 0, 0])
    length = np.linalg.norm(np.diff(lines, axis=1), axis=-1).sum()
    np.testing.assert_allclose(np.linalg.norm(np.diff(ends, axis=1), axis=-1).sum(), length, rtol=1e-5)
    for side in (0, 1):
        for end in (0, 1):
            triangles = vertices[faces[pairs[:, side]]].astype(float) / scale
            assert on_triangles(ends[:, end].astype(float) / scale, triangles).max() < 1e-6


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_pairs_of_what_moves_once_each_and_within_one_mesh(implementation):
    vertices, faces, number = joined(
        shapes.sphere(2, radius=0.5), shapes.torus(0.5, 0.2, 24, 12), shapes.box((0.4, 0.5, 3.0))
    )
    kinds = {}
    for moving in ((True, True, True), (True, False, False), (False, False, True), (False, False, False)):
        pairs, *_ = ask(implementation, vertices, faces, np.asarray(moving)[number])
        assert len({frozenset(pair) for pair in pairs.tolist()}) == len(pairs)
        kinds[moving] = {frozenset(pair) for pair in pairs.tolist()}
    every = kinds[True, True, True]
    touched = [{tuple(sorted(number[list(pair)])) for pair in found} for found in kinds.values()]
    assert touched == [{(0, 1), (0, 2), (1, 2)}, {(0, 1), (0, 2)}, {(0, 2), (1, 2)}, set()]
    assert kinds[True, False, False] == {pair for pair in every if (number[list(pair)] == 0).any()}
    assert len(every) > 100


@pytest.mark.parametrize("name", ["sphere", "bumps"])
def test_both_implementations_find_the_same(name):
    body = shapes.sphere(2) if name == "sphere" else shapes.displaced_sphere(3)
    vertices, faces, number = joined(body, shapes.trefoil_tube(segments=48, sides=6))
    found = {}
    for implementation in ("warp", "jax"):
        pairs, ends, *_ = ask(implementation, vertices, faces, number == 0)
        order = np.lexsort(pairs.T)
        found[implementation] = pairs[order], ends[order]
    np.testing.assert_array_equal(found["warp"][0], found["jax"][0])
    np.testing.assert_allclose(found["warp"][1], found["jax"][1], atol=1e-5)
    assert len(found["warp"][0]) > 50


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_what_only_touches_does_not_cross(implementation):
    """A box on the floor, a box against another one, and seams whose vertices are there twice."""
    floor, standing = shapes.plane(4.0), shapes.box((1.0, 1.0, 1.0), (0.0, 0.0, 0.5))
    beside = shapes.box((1.0, 1.0, 1.0), (1.0, 0.3, 0.5))
    ball = shapes.displaced_sphere(2, center=(0.0, 0.0, 3.0))
    corners = np.asarray(ball.vertices)[np.asarray(ball.faces)].reshape(-1, 3)
    vertices, faces, _ = joined(floor, standing, beside)
    soup = np.arange(len(corners)).reshape(-1, 3)
    vertices, faces = np.concatenate([vertices, corners]), np.concatenate([faces, soup + len(vertices)])
    pairs, *_ = ask(implementation, vertices.astype(np.float32), faces, np.ones(len(faces), bool))
    assert len(pairs) == 0


@pytest.mark.parametrize("implementation", ["warp", "jax"])
def test_thinning_is_unbiased(implementation):
    fine = implementation == "warp"  # the other one looks at all pairs
    torus = shapes.torus(0.5, 0.2, 48, 24) if fine else shapes.torus(0.5, 0.2, 24, 12)
    vertices, faces, number = joined(shapes.sphere(3 if fine else 2, radius=0.5), torus)
    _, ends, count, _ = ask(implementation, vertices, faces, number == 0)
    length = np.linalg.norm(np.diff(ends, axis=1), axis=-1).sum()
    few, sums = count // 2, []
    warned = pytest.warns(UserWarning, match="pass through each other") if fine else None
    with warned or contextlib.nullcontext():
        for seed in range(60):
            some, kept, found, weight = ask(implementation, vertices, faces, number == 0, few, seed)
            assert found == count and 0 < len(some) <= few and weight > 2
            sums.append(weight * np.linalg.norm(np.diff(kept, axis=1), axis=-1).sum())
    error = np.std(sums, ddof=1) / np.sqrt(len(sums))
    assert error < 0.03 * length and abs(np.mean(sums) - length) < 4.5 * error
    assert len(set(sums)) > 50


def test_indirect_light_is_told_where_surfaces_cross(recwarn):
    moving = np.ones(2000, bool)
    for height, warns in ((0.2, True), (2.0, False)):
        vertices, faces, number = joined(shapes.sphere(2, radius=0.5, center=(0, 0, height)), shapes.plane(4.0))
        geometry = queries.Geometry(jnp.asarray(vertices), jnp.asarray(faces, jnp.int32))
        told = pytest.warns(UserWarning, match="With indirect light") if warns else contextlib.nullcontext()
        with told:
            queries.face_intersections(geometry, jnp.asarray(moving[: len(number)]), jnp.int32(0), 200, True)
    assert not [w for w in recwarn if "indirect" in str(w.message)]


def test_answers_that_are_kept_are_those_of_the_same_faces():
    """Faces that stay where they are are not searched again; moved ones are, and other flags and capacities, too."""
    floor, answers = shapes.plane(4.0), {}
    for height, moves, room in 2 * [(0.2, 0, 300), (0.3, 0, 300), (0.2, 1, 300), (0.2, 0, 200), (2.0, 0, 300)]:
        vertices, faces, number = joined(shapes.sphere(3, radius=0.5, center=(0, 0, height)), floor)
        pairs, ends, count, _ = ask("warp", vertices, faces, number == moves, room)
        slow = ask("jax", vertices, faces, number == moves, room)
        assert count == slow[2] == len(pairs)
        order, other = np.lexsort(pairs.T), np.lexsort(slow[0].T)
        np.testing.assert_array_equal(pairs[order], slow[0][other])
        np.testing.assert_allclose(ends[order], slow[1][other], atol=1e-6)
        answers.setdefault((height, moves, room), []).append((pairs, ends))
    for one, other in answers.values():
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
