"""Closest hit and occlusion: `warp` and `jax` against each other, Embree and float64 arithmetic."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.geometry import queries, shapes
from jaxdr.geometry.queries import IMPLEMENTATIONS, api
from jaxdr.geometry.queries.embree import scene as embree_scene
from jaxdr.transport.interaction import SurfacePoint, leave
from tests.geometry.queries.query_meshes import (
    EPS,
    FAR,
    FAR_AWAY,
    MESHES,
    Crossing,
    affine,
    arrays,
    ask,
    make,
    random_rays,
)

SCALES = {"unit": affine(), "tiny": affine(1e-3), "far away": affine(1.0, FAR_AWAY)}


def ask_rays(query, vertices, faces, *rays, implementation):
    """One of the two queries of rays, on host arrays."""
    return ask(query, queries.Geometry(vertices, faces), queries.Rays(*rays), implementation=implementation)


def closest(vertices, faces, origin, direction, implementation, t_max=FAR):
    reach = np.broadcast_to(np.float32(t_max), len(origin))
    return ask_rays(queries.closest_hit, vertices, faces, origin, direction, reach, implementation=implementation)


def embree(vertices, faces, origin, direction):
    """The nearest face by Embree, -1 for a miss."""
    pytest.importorskip("embreex", reason="Embree is an independent reference; pip install embreex")
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return RayMeshIntersector(mesh, scale_to_box=False).intersects_first(origin, direction)


def assert_same_faces(vertices, faces, origin, direction, first, second):
    """Equal, except where a ray passes an edge (of either face) more closely than coordinates are rounded."""
    differs = np.flatnonzero(first != second)
    assert len(differs) <= 0.02 * len(first), f"{len(differs)} of {len(first)} rays differ"
    for i in differs:
        tie = False
        for face in (first[i], second[i]):
            if face >= 0:
                tie |= abs(Crossing(vertices, faces[face], origin[i], direction[i]).inside) < 4
        assert tie, f"ray {i}: face {first[i]} or {second[i]}, and no edge is near"


@pytest.mark.parametrize("implementation", ["embree", "warp"])
@pytest.mark.parametrize("name", MESHES)
def test_closest_hit(name, implementation):
    """All implementations and trimesh's Embree find the same faces, at the distances that float64 gives."""
    vertices, faces = arrays(make(name))
    origin, direction = random_rays(vertices, 4000, seed=11)
    face, t, barycentric = closest(vertices, faces, origin, direction, implementation)
    assert 0.02 < np.mean(face >= 0) < 1.0, "the rays don't test much"
    assert_same_faces(vertices, faces, origin, direction, face, embree(vertices, faces, origin, direction))

    few = slice(0, 128)
    jax_face, jax_t, jax_barycentric = closest(vertices, faces, origin[few], direction[few], "jax")
    assert_same_faces(vertices, faces, origin[few], direction[few], face[few], jax_face)

    ours, plain = (face, t, barycentric, slice(None)), (jax_face, jax_t, jax_barycentric, few)
    for found, distance, where, rays in (ours, plain):
        hit = found >= 0
        o, d = origin[rays][hit], direction[rays][hit]
        exact = Crossing(vertices, faces[found[hit]], o, d)
        assert np.all(np.abs(distance[hit] - exact.t) <= exact.t_error + 8 * EPS * np.abs(exact.t))
        assert np.all(exact.inside > -4), "a hit outside of its face"
        assert np.all(where >= 0)
        assert np.allclose(where.sum(-1), 1.0, atol=1e-6)
        corners = vertices[faces[found[hit]]].astype(float)
        apart = np.linalg.norm(np.einsum("nk,nkd->nd", where[hit], corners) - (o + exact.t[:, None] * d), axis=-1)
        length = np.linalg.norm(d.astype(float), axis=-1)
        rounding = 16 * EPS * (np.abs(corners).max((1, 2)) + np.abs(o).max(-1))
        assert np.all(apart <= 4 * exact.t_error * length + rounding), "barycentric coordinates of another point"


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
@pytest.mark.parametrize("name", ["sphere, tiny", "bumps, far away", "trefoil", "box"])
def test_occluded_agrees_with_the_closest_hit(name, implementation):
    vertices, faces = arrays(make(name))
    count = 4000 if implementation != "jax" else 200
    origin, direction = random_rays(vertices, count, seed=12)
    face, t, _ = closest(vertices, faces, origin, direction, "warp")
    rng = np.random.default_rng(13)
    # Rays that end well before or well after what they meet first; some have no length at all.
    reach = np.where(face >= 0, t * rng.choice([0.0, 0.5, 0.9, 1.1, 2.0], count), 1e30).astype(np.float32)
    expected = (face >= 0) & (t < reach)
    blocked = ask_rays(queries.occluded, vertices, faces, origin, direction, reach, implementation=implementation)
    assert 0.05 < expected.mean() < 0.95
    differs = blocked != expected
    exact = Crossing(vertices, faces[face[differs]], origin[differs], direction[differs])
    assert differs.mean() <= 0.02 and np.all(np.abs(exact.inside) < 4)


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_rays_of_no_length_meet_nothing(implementation):
    vertices, faces = arrays(make("sphere"))
    origin, direction = random_rays(vertices, 64, seed=14)
    for reach in (0.0, -1.0):
        assert np.all(closest(vertices, faces, origin, direction, implementation, reach)[0] == -1)
        rays = vertices, faces, origin, direction, np.full(64, reach, np.float32)
        assert not np.any(ask_rays(queries.occluded, *rays, implementation=implementation))


@pytest.mark.parametrize("matrix", SCALES.values(), ids=SCALES)
@pytest.mark.parametrize("shape", ["sphere", "box", "torus"])
def test_watertight(shape, matrix):
    """Nothing leaks: rays from inside a closed mesh, aimed at its vertices and at points of its edges, all hit it.

    With Embree next to nothing.
    """
    mesh = {
        "sphere": lambda: shapes.sphere(2),
        "box": lambda: shapes.box((1.0, 2.0, 1.5)),
        "torus": lambda: shapes.torus(1.0, 0.5, 24, 12),
    }[shape]()
    mesh = shapes.transformed(mesh, matrix)
    assert mesh.closed
    vertices, faces = arrays(mesh)
    ends = vertices[np.asarray(mesh.edges.vertices)].astype(float)
    middle = np.array([0.0 if shape != "torus" else 1.0, 0.0, 0.0])  # inside the tube of the torus
    rng = np.random.default_rng(16)
    aims = [vertices.astype(float)]
    aims += [ends[:, 0] + f * (ends[:, 1] - ends[:, 0]) for f in (0.5, 0.25, rng.uniform(size=(len(ends), 1)))]
    aims = np.concatenate(aims)
    inside = [matrix @ [*(middle + shift), 1.0] for shift in (np.zeros(3), *rng.uniform(-0.05, 0.05, (4, 3)))]
    origin = np.repeat(np.float32(inside)[:, :3], len(aims), axis=0)
    direction = np.float32(np.tile(aims, (len(inside), 1)) - origin)
    for implementation in IMPLEMENTATIONS:
        some = slice(None, None, 1 if implementation != "jax" else 7)
        n = len(origin[some])
        rays = vertices, faces, origin[some], direction[some], np.full(n, FAR)
        face, *_ = ask_rays(queries.closest_hit, *rays, implementation=implementation)
        most = 1e-3 * n if implementation == "embree" else 0  # see `embree.scene.ROBUST`
        assert np.sum(face < 0) <= most, f"{implementation}: {np.sum(face < 0)} of {n} rays leak"
        blocked = ask_rays(queries.occluded, *rays, implementation=implementation)
        assert np.sum(~blocked) <= most, f"{implementation}: occluded leaks {np.sum(~blocked)} of {n}"


@pytest.mark.parametrize("matrix", [*SCALES.values(), affine(1e-3, (5.0, 0.0, 0.0))], ids=[*SCALES, "tiny and away"])
@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_no_self_intersection(matrix, implementation):
    """Points on a convex closed surface see everything in front of their tangent plane: rays start off the surface."""
    vertices, faces = arrays(shapes.transformed(shapes.sphere(2), matrix))
    rng = np.random.default_rng(17)
    n = 20000 if implementation != "jax" else 400
    face = rng.integers(len(faces), size=n)
    barycentric = rng.dirichlet([0.3, 0.3, 0.3], n).astype(np.float32)  # many close to the sides of their faces
    corners = vertices[faces[face]]
    position = (corners * barycentric[..., None]).sum(1, dtype=np.float32)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    towards = rng.standard_normal((n, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    towards = np.where((towards * normal).sum(1, keepdims=True) < 0, -towards, towards).astype(np.float32)
    scale = np.abs(corners).max((1, 2))
    fields = (np.ones(n, bool), face, barycentric, position, normal, normal, np.ones(n, np.float32), scale)
    start = np.asarray(leave(SurfacePoint(*map(jnp.asarray, fields)), jnp.asarray(towards)))
    rays = towards, np.full(n, FAR)
    blocked = ask_rays(queries.occluded, vertices, faces, start, *rays, implementation=implementation)
    assert not np.any(blocked), f"{np.sum(blocked)} of {n} points hide themselves"
    # Without the offset they do: the test can fail.
    assert np.any(ask_rays(queries.occluded, vertices, faces, position, *rays, implementation=implementation))


def test_unknown_implementation():
    vertices, faces = arrays(make("box"))
    rays = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
    with pytest.raises(
        ValueError, match="unknown query implementation 'optix'; expected one of auto, embree, warp, jax"
    ):
        closest(vertices, faces, *rays, "optix")


@pytest.mark.parametrize("implementation", IMPLEMENTATIONS)
def test_an_empty_batch_of_rays(implementation):
    nothing = np.zeros((0, 3), np.float32)
    face, t, barycentric = closest(*arrays(make("box")), nothing, nothing, implementation)
    assert face.shape == t.shape == (0,)
    assert barycentric.shape == (0, 3)


def test_without_embree(monkeypatch):
    """Warp takes its place, and who asks for it is told what to install."""
    for name in ("embreex", "embreex.rtcore"):
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr(embree_scene, "library", embree_scene.library.__wrapped__)
    assert api._module("auto").__name__.endswith("warp.queries")
    with pytest.raises(ImportError, match="pip install"):
        api._module("embree")
