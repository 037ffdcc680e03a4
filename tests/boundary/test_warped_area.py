"""The continuous velocity of a warped area: its divergence, and what it is at the boundary."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.boundary_test import connect_faces, find_occluders
from jaxdr.boundary.continuous_velocity import (
    Auxiliary,
    Kernel,
    draw_auxiliary,
    log_weights,
    shares_of,
    velocity_field,
)
from jaxdr.boundary.silhouettes import SegmentEnds
from jaxdr.boundary.warped_area import Hidden, displacement
from jaxdr.geometry.shapes import box
from jaxdr.geometry.vector import orthonormal_basis
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import SurfacePoint, material_point
from tests.gradients.floor_point import BOX, HALF_PLANE, scene, sheet

BLOCKER, FLOOR, LAMP = range(3)  # shapes are in the order of their names
KERNELS = {
    "path space": Kernel("path_space", 0.05, 3.0, 3.0, 1.0),
    "as in the paper": Kernel("path_space", 0.05, 3.0, 1.0, 0.5),
    "exponential": Kernel("exponential", 0.05, 1.0, 1.0, 0.3),
}


def random_ends(count: int, infinite: bool) -> SegmentEnds:
    """Apexes and targets some distance away, on planes at a slant or at infinity."""
    rng = np.random.default_rng(5)
    apex, target = rng.standard_normal((2, count, 3))
    target[:, 2] += 4.0
    away = target - apex
    normal = away + 0.0 if infinite else away + 2.0 * rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    none = jnp.zeros(count, jnp.int32)
    corners = jnp.zeros((count, 3, 3))
    far = jnp.full(count, infinite)
    return SegmentEnds(jnp.asarray(apex), none, jnp.asarray(target), jnp.asarray(normal), none, corners, far)


def around(kernel: Kernel, ends: SegmentEnds, samples: int, key) -> Auxiliary:
    """Auxiliary points of targets on planes without an end, or at infinity."""
    with jax.enable_x64(False):
        packed, _, faces = under_a_blocker("box")
    infinite = bool(ends.infinite.all())
    active = jnp.ones(ends.infinite.shape, bool)
    return draw_auxiliary(packed, faces.normal, ends, active, kernel, samples, 1, key, "jax", False, infinite)


@pytest.mark.parametrize("infinite", [False, True], ids=["plane", "infinity"])
@pytest.mark.parametrize("name", KERNELS)
def test_divergence_against_finite_differences(name, infinite):
    """Of the velocity as a function of the target, with the auxiliary points held fixed, in float64."""
    with jax.enable_x64(True):
        kernel, ends = KERNELS[name], random_ends(40, infinite)
        points = around(kernel, ends, 8, jax.random.key(0))
        rng = np.random.default_rng(1)
        boundary = jnp.asarray(10.0 ** rng.uniform(-4, 0, points.there.shape))
        velocity = jnp.asarray(rng.standard_normal(points.position.shape))
        field = velocity_field(kernel, ends, points, boundary, False, infinite)
        found = (field.divergence * velocity).sum((1, 2, 3))

        def mean(target):
            moved = shares_of(log_weights(kernel, ends, points, boundary, target, infinite))
            mean = (moved[..., None] * velocity).sum((1, 2))
            if infinite:
                out = (target - ends.apex) / jnp.linalg.norm(target - ends.apex, axis=1, keepdims=True)
                mean = mean - (mean * out).sum(1, keepdims=True) * out
            return mean

        def at(offset):
            target = ends.target + offset
            if infinite:
                length = [jnp.linalg.norm(p - ends.apex, axis=1, keepdims=True) for p in (ends.target, target)]
                target = ends.apex + length[0] / length[1] * (target - ends.apex)
            return mean(target)

        expected, step = 0.0, 1e-7
        for tangent in orthonormal_basis(ends.normal):
            expected += (tangent * (at(step * tangent) - at(-step * tangent))).sum(1) / (2 * step)
        assert np.abs(expected).max() > 1
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def smooth_velocity(position):
    return jnp.stack([jnp.sin(7 * position[..., 1]), jnp.cos(9 * position[..., 0]), position[..., 0]], -1)


@pytest.mark.parametrize("infinite", [False, True], ids=["plane", "infinity"])
def test_divergence_of_the_mean_velocity(infinite):
    """With few auxiliary points: exact once the change of their density counts, and wrong without."""
    with jax.enable_x64(True):
        kernel, count, keys = KERNELS["path space"], 4, 40_000
        ends = random_ends(count, infinite)
        ends = jax.tree.map(lambda a: jnp.repeat(a, keys, axis=0), ends)
        key = jax.random.key(2)

        def test_function(position):
            return 0.02 + 0.5 * (1 + jnp.sin(8 * position.sum(-1)))

        def mean(target):
            """The points move along with the target: their distribution around it stays."""
            moved = SegmentEnds(ends.apex, ends.face, target, ends.normal, ends.face, ends.corners, ends.infinite)
            if infinite:
                away = target - ends.apex
                out = away / jnp.linalg.norm(away, axis=1, keepdims=True)
                moved = SegmentEnds(ends.apex, ends.face, target, out, ends.face, ends.corners, ends.infinite)
            points = around(kernel, moved, 2, key)
            boundary = test_function(points.position)
            shares = shares_of(log_weights(kernel, moved, points, boundary, target, infinite))
            mean = (shares[..., None] * smooth_velocity(points.position)).sum((1, 2))
            return mean - (mean * moved.normal).sum(1, keepdims=True) * moved.normal if infinite else mean

        expected, step = 0.0, 1e-5
        for tangent in orthonormal_basis(ends.normal):
            expected += (tangent * (mean(ends.target + step * tangent) - mean(ends.target - step * tangent))).sum(1)
        expected = expected / (2 * step)
        points = around(kernel, ends, 2, key)
        velocity, boundary = smooth_velocity(points.position), test_function(points.position)
        rows = {}
        for debias in (True, False):
            field = velocity_field(kernel, ends, points, boundary, debias, infinite)
            difference = ((field.divergence * velocity).sum((1, 2, 3)) - expected).reshape(count, keys)
            rows[debias] = np.abs(difference.mean(1)) / (difference.std(1) / keys**0.5)
        assert np.all(rows[True] < 4.5), rows
        assert rows[False].max() > 8, "the test can tell nothing"


@cache
def under_a_blocker(name):
    """(packed scene, apex, neighbours of the faces): the floor's point under the light."""
    blocker = {"half plane": sheet(HALF_PLANE, 0.1), "box": BOX}[name]
    packed = pack(scene(blocker))
    one = jnp.asarray([packed.first_face[FLOOR]]), jnp.asarray([[0.25, 0.25, 0.5]]), jnp.asarray([True])
    return packed, material_point(packed, *one), connect_faces(packed)


def mean_velocity(name, kernel, place, tangent, keys=400, samples=8):
    """v at a point of the light for a motion of all vertices [V, 3]: mean and standard error over draws."""
    packed, apex, faces = under_a_blocker(name)
    first = packed.first_face[LAMP]
    light = np.asarray(packed.vertices)[np.asarray(packed.faces)[first : first + 2]]
    half = int(np.argmax([_inside(corners, place) for corners in light]))
    rows = jnp.zeros(keys, jnp.int32)

    def rep(a):
        return jnp.broadcast_to(jnp.asarray(a, packed.vertices.dtype), (keys, *np.shape(a)))

    ends = SegmentEnds(
        rep(apex.position[0]), rows, rep(place), rep([0.0, 0.0, -1.0]), rows + first + half, rep(light[half]), rows < 0
    )
    active = rows == 0
    points = draw_auxiliary(
        packed, faces.normal, ends, active, kernel, samples, 2, jax.random.key(7), "warp", True, False
    )
    apexes = SurfacePoint(*(None if a is None else jnp.repeat(a, keys, axis=0) for a in apex))
    occluders = find_occluders(packed, faces, apexes, ends, points, kernel, "warp")
    field = velocity_field(kernel, ends, points, occluders.boundary, True, False)
    flat = [points.position, points.face, points.barycentric, occluders.face, occluders.barycentric]
    seen = Hidden(*(a.reshape(-1, *a.shape[3:]) for a in flat))
    count = keys * samples * 2

    def moved(vertices):
        of = dataclasses.replace(packed, vertices=vertices)
        corners = vertices[packed.faces[apex.face[0]]]
        at = jnp.broadcast_to((corners * apex.barycentric[0][:, None]).sum(0), (count, 3))
        return displacement(of, at, jnp.zeros(count, bool), seen)

    v = jax.jvp(moved, (packed.vertices,), (jnp.asarray(tangent, packed.vertices.dtype),))[1]
    hidden = (occluders.hidden & points.there)[..., None]
    v = jnp.where(hidden, v.reshape(points.position.shape), 0.0)
    v = np.asarray((field.share[..., None] * v).sum((1, 2)), float)
    return v.mean(0), v.std(0) / keys**0.5


def _inside(corners, place):
    a, b, c = corners[:, :2]
    p = np.asarray(place)[:2]
    cross = [(q[0] - o[0]) * (p[1] - o[1]) - (q[1] - o[1]) * (p[0] - o[0]) for o, q in ((a, b), (b, c), (c, a))]
    return min(cross) >= 0 or max(cross) <= 0


def translation(name, shape, axis):
    """All vertices of one shape by one along an axis."""
    packed = under_a_blocker(name)[0]
    tangent = np.zeros(packed.vertices.shape)
    first = [*packed.first_vertex, len(tangent)]
    tangent[first[shape] : first[shape + 1], axis] = 1.0
    return tangent


# Where the boundary is at x > 0 on the light, and its velocity along x for translations along x of what moves.
AT = {"half plane": (0.3, {BLOCKER: 2.0, LAMP: -1.0, FLOOR: -1.0}), "box": (0.4, {BLOCKER: 1.2 / 0.45})}


@pytest.mark.parametrize(("name", "shape"), [(name, shape) for name in AT for shape in AT[name][1]])
def test_velocity_is_that_of_the_boundary_where_it_is_approached(name, shape):
    kernel = jd.WarpedArea(sigma0=0.02).kernel
    place, exact = AT[name][0], AT[name][1][shape]
    errors = []
    for gap in (0.02, 0.005, 0.001, 0.0001):
        mean, deviation = mean_velocity(name, kernel, [place + gap, 0.1, 1.2], translation(name, shape, 0))
        errors.append(abs(mean[0] - exact) / abs(exact))
        assert np.all(deviation < 0.05 * abs(exact))
        assert abs(mean[1]) < 0.05 * abs(exact) and mean[2] == 0
    assert errors[-1] < 0.02, errors
    assert errors[0] > errors[1] > errors[2] > errors[3] - 0.01 and errors[0] > 0.1, errors


def test_velocity_vanishes_far_from_boundaries_and_at_the_edge_of_the_light():
    kernel = jd.WarpedArea(sigma0=0.02).kernel
    moves = translation("half plane", BLOCKER, 0)
    far = mean_velocity("half plane", kernel, [1.0, 0.1, 1.2], moves)[0]
    assert np.abs(far).max() < 0.01
    along = translation("half plane", BLOCKER, 1)
    inside = mean_velocity("half plane", kernel, [0.31, 1.0, 1.2], along)[0][1]
    at_edge = mean_velocity("half plane", kernel, [0.31, 1.4999, 1.2], along)[0][1]
    assert abs(at_edge) < 0.5 * abs(inside), (at_edge, inside)


def test_neighbours_of_faces():
    """Across every side of a box lies one other face, and beyond the sides of an open face nothing."""
    packed = pack(scene(box()))
    behind, faces = np.asarray(connect_faces(packed).behind), np.asarray(packed.faces)
    floor, lamp = packed.first_face[FLOOR], packed.first_face[LAMP]
    assert np.all(behind[floor] == -1)
    assert sorted(behind[lamp : lamp + 2].ravel()) == [-1, -1, -1, -1, lamp, lamp + 1]
    for face in range(floor):
        for side in range(3):
            ends = set(np.delete(faces[face], side))
            assert ends < set(faces[behind[face, side]]) and behind[face, side] != face
