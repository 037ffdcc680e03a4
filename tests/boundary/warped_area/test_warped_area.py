"""The continuous velocity of a warped area: its divergence, and what it is at the boundary."""

import dataclasses
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.shared.face_neighbours import connect_faces
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.warped_area.continuous_velocity import (
    Auxiliary,
    Convolution,
    Kernel,
    draw_auxiliary,
    log_weights,
    shares_of,
    velocity_field,
)
from jaxdr.boundary.warped_area.divergence import displacement, hidden_velocities
from jaxdr.boundary.warped_area.outlines import keep_inside
from jaxdr.geometry.shapes import box
from jaxdr.geometry.vector import dot, norm, normalize, orthonormal_basis
from jaxdr.scene.packed import pack
from jaxdr.transport.interaction import material_point
from tests.gradients.floor_point import BOX, HALF_PLANE, scene, sheet

BLOCKER, FLOOR, LAMP = range(3)  # shapes are in the order of their names
KERNELS = {
    "path space": Kernel("path_space", 0.05, 3.0, 3.0, 1.0),
    "as in the paper": Kernel("path_space", 0.05, 3.0, 1.0, 0.5),
    "exponential": Kernel("exponential", 0.05, 1.0, 1.0, 0.3),
}


def random_ends(count: int, infinite: bool) -> dict:
    """Apexes and targets some distance away, on planes at a slant or at infinity."""
    rng = np.random.default_rng(5)
    apex, target = rng.standard_normal((2, count, 3))
    target[:, 2] += 4.0
    away = target - apex
    normal = away + 0.0 if infinite else away + 2.0 * rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    none, far = np.zeros(count, np.int32), np.full(count, infinite)
    return {
        "apex": apex,
        "apex_face": none,
        "target": target,
        "normal": normal,
        "face": none,
        "corners": np.zeros((count, 3, 3)),
        "infinite": far,
    }


def around(packed, faces, kernel: Kernel, ends: SegmentEnds, samples: int, key, infinite: bool) -> Auxiliary:
    """Auxiliary points of targets on planes without an end, or at infinity."""
    active = jnp.ones(ends.infinite.shape, bool)
    around = Convolution(kernel, samples, 1, True, False, infinite, rays="jax")
    return draw_auxiliary(packed, faces.normal, ends, active, around, key)


def in_float64(ends: dict) -> SegmentEnds:
    return SegmentEnds(**{k: jnp.asarray(a, float) if a.dtype.kind == "f" else jnp.asarray(a) for k, a in ends.items()})


@pytest.mark.parametrize("infinite", [False, True], ids=["plane", "infinity"])
@pytest.mark.parametrize("name", KERNELS)
def test_divergence_against_finite_differences(name, infinite):
    """Of the velocity as a function of the target, with the auxiliary points held fixed, in float64."""
    kernel, ends, key = KERNELS[name], random_ends(40, infinite), jax.random.key(0)
    packed, _, faces = under_a_blocker("box")

    def both(ends):
        points = around(packed, faces, kernel, ends, 8, key, infinite)
        boundary = 10.0 ** jax.random.uniform(key, points.there.shape, float, -4.0, 0.0)
        velocity = jax.random.normal(key, points.position.shape, float)
        field = velocity_field(kernel, ends, points, boundary, False, infinite)

        def at(offset):
            target = ends.target + offset
            away = target - ends.apex
            if infinite:
                away = away * (norm(ends.target - ends.apex) / norm(away))[:, None]
                target = ends.apex + away
            shares = shares_of(log_weights(kernel, ends, points, boundary, target, infinite))
            mean = (shares[..., None] * velocity).sum((1, 2))
            return mean - dot(mean, normalize(away))[:, None] * normalize(away) if infinite else mean

        expected, step = 0.0, 1e-7
        for tangent in orthonormal_basis(ends.normal):
            expected += dot(tangent, at(step * tangent) - at(-step * tangent)) / (2 * step)
        return (field.divergence * velocity).sum((1, 2, 3)), expected

    with jax.enable_x64(True):
        found, expected = jax.device_get(jax.jit(both)(in_float64(ends)))
    assert found.dtype == np.float64 and np.abs(expected).max() > 1
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def smooth_velocity(position):
    return jnp.stack([jnp.sin(7 * position[..., 1]), jnp.cos(9 * position[..., 0]), position[..., 0]], -1)


@pytest.mark.parametrize("infinite", [False, True], ids=["plane", "infinity"])
def test_divergence_of_the_mean_velocity(infinite):
    """With few auxiliary points: exact once the change of their density counts, and wrong without.

    The velocities are smooth here, so the points may move along with the target, and their density does not change.
    """
    kernel, count, draws, key = KERNELS["path space"], 4, 20_000, jax.random.key(2)
    packed, _, faces = under_a_blocker("box")
    repeated = jax.tree.map(lambda a: np.repeat(a, draws, axis=0), random_ends(count, infinite))

    def both(ends):
        def drawn(target):
            away = normalize(target - ends.apex)
            moved = dataclasses.replace(ends, target=target, normal=away if infinite else ends.normal)
            points = around(packed, faces, kernel, moved, 2, key, infinite)
            boundary = 0.02 + 0.5 * (1 + jnp.sin(8 * points.position.sum(-1)))
            return moved, points, boundary, smooth_velocity(points.position)

        def mean(target):
            moved, points, boundary, velocity = drawn(target)
            shares = shares_of(log_weights(kernel, moved, points, boundary, target, infinite))
            mean = (shares[..., None] * velocity).sum((1, 2))
            return mean - dot(mean, moved.normal)[:, None] * moved.normal if infinite else mean

        expected, step = 0.0, 1e-5
        for tangent in orthonormal_basis(ends.normal):
            expected += dot(tangent, mean(ends.target + step * tangent) - mean(ends.target - step * tangent))
        _, points, boundary, velocity = drawn(ends.target)
        errors = {}
        for debias in (True, False):
            field = velocity_field(kernel, ends, points, boundary, debias, infinite)
            found = (field.divergence * velocity).sum((1, 2, 3))
            errors[debias] = (found - expected / (2 * step)).reshape(count, draws)
        return errors

    with jax.enable_x64(True):
        errors = jax.device_get(jax.jit(both)(in_float64(repeated)))
    deviations = {k: np.abs(e.mean(1)) / (e.std(1) / draws**0.5) for k, e in errors.items()}
    assert np.all(deviations[True] < 4.5), deviations
    assert deviations[False].max() > 6, "the test can tell nothing"


@cache
def under_a_blocker(name):
    """(packed scene, apex, neighbours of the faces): the floor's point under the light."""
    blocker = {"half plane": sheet(HALF_PLANE, 0.1), "box": BOX}[name]
    packed = pack(scene(blocker))
    one = jnp.asarray([packed.first_face[FLOOR]]), jnp.asarray([[0.25, 0.25, 0.5]]), jnp.asarray([True])
    return packed, material_point(packed, *one), connect_faces(packed)


def mean_velocity(name, place, tangent, keys=400):
    """v at a point of the light for a motion of all vertices [V, 3]: mean and standard error over draws."""
    packed, _, _ = under_a_blocker(name)
    first = packed.first_face[LAMP]
    light = np.asarray(packed.vertices)[np.asarray(packed.faces)[first : first + 2]]
    half = int(np.argmax([_inside(corners, place) for corners in light]))
    place, tangent = np.asarray(place, np.float32), np.asarray(tangent, np.float32)
    v = np.asarray(_velocities(*under_a_blocker(name), place, first + half, light[half], tangent, keys), float)
    return v.mean(0), v.std(0) / keys**0.5


@partial(jax.jit, static_argnames="keys")
def _velocities(packed, apex, faces, place, face, corners, tangent, keys):
    apex = jax.tree.map(lambda a: jnp.repeat(a, keys, axis=0), apex)
    down = jnp.asarray([0.0, 0.0, -1.0])
    target, normal, corners, face = (jnp.broadcast_to(a, (keys, *jnp.shape(a))) for a in (place, down, corners, face))
    ends = SegmentEnds(apex.position, apex.face, target, normal, face, corners, jnp.zeros(keys, bool))
    options = jnp.ones(keys, bool), WARPED.around(packed, True, False), jax.random.key(7)
    velocities = hidden_velocities(packed, faces, apex, ends, *options)
    slots, row = velocities.slots, velocities.row(velocities.slots)

    def moved(vertices):
        of = packed.with_vertices(vertices)
        at = material_point(of, apex.face, apex.barycentric, apex.valid).position
        return displacement(of, at[row], jnp.zeros(row.shape[0], bool), velocities.seen(slots))

    v = velocities.inside(slots, jax.jvp(moved, (packed.vertices,), (tangent,))[1]) * velocities.share[slots][:, None]
    v = jnp.where((jnp.arange(len(slots)) < velocities.used)[:, None], v, 0.0)
    return jnp.zeros_like(ends.target).at[row].add(v)


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


WARPED = jd.WarpedArea(sigma0=0.02)
# Where the boundary is at x > 0 on the light, and its velocity along x for translations along x of what moves.
AT = {"half plane": (0.3, {BLOCKER: 2.0, LAMP: -1.0, FLOOR: -1.0}), "box": (0.4, {BLOCKER: 1.2 / 0.45})}


@pytest.mark.parametrize(("name", "shape"), [(name, shape) for name in AT for shape in AT[name][1]])
def test_velocity_is_that_of_the_boundary_where_it_is_approached(name, shape):
    place, exact = AT[name][0], AT[name][1][shape]
    errors = []
    for gap in (0.02, 0.005, 0.001, 0.0001):
        mean, deviation = mean_velocity(name, [place + gap, 0.1, 1.2], translation(name, shape, 0))
        errors.append(abs(mean[0] - exact) / abs(exact))
        assert np.all(deviation < 0.05 * abs(exact))
        assert abs(mean[1]) < 0.05 * abs(exact) and mean[2] == 0
    assert errors[-1] < 0.02, errors
    assert errors[0] > errors[1] > errors[2] > errors[3] - 0.01 and errors[0] > 0.1, errors


def test_velocity_vanishes_far_from_boundaries_and_at_the_edge_of_the_light():
    moves = translation("half plane", BLOCKER, 0)
    far = mean_velocity("half plane", [1.0, 0.1, 1.2], moves)[0]
    assert np.abs(far).max() < 0.01
    along = translation("half plane", BLOCKER, 1)
    inside = mean_velocity("half plane", [0.31, 1.0, 1.2], along)[0][1]
    at_edge = mean_velocity("half plane", [0.31, 1.4999, 1.2], along)[0][1]
    assert abs(at_edge) < 0.05 * abs(inside), (at_edge, inside)


def test_divergence_beside_an_outline():
    """That of what keeps velocities from crossing outlines: finite differences over the light, corners and all."""

    def double(x):
        return jnp.asarray(x, float) if jnp.issubdtype(jnp.result_type(x), jnp.floating) else jnp.asarray(x)

    packed, apex, faces = under_a_blocker("half plane")
    first, count = packed.first_face[LAMP], 200
    rng = np.random.default_rng(3)
    with jax.enable_x64(True):
        wide, faces = jax.tree.map(double, (packed, faces))
        face = first + rng.integers(0, 2, count)
        corners = np.asarray(wide.vertices)[np.asarray(wide.faces)[face]]
        target = np.einsum("nk,nkj->nj", rng.dirichlet(np.full(3, 0.3), count), corners)
        down = np.broadcast_to([0.0, 0.0, -1.0], target.shape)
        start = np.broadcast_to(np.asarray(apex.position, float), target.shape)
        none, far = np.zeros(count, int), np.zeros(count, bool)
        names = "apex", "apex_face", "target", "normal", "face", "corners", "infinite"
        ends = in_float64(dict(zip(names, (start, none, target, down, face, corners, far), strict=True)))
        width = jnp.full(count, 2.0)
        found = keep_inside(wide, faces, ends, width)
        step, divergence = 1e-6, np.zeros((count, 3))
        for axis in (0, 1):
            moves = step * np.eye(3)[axis]
            plus, minus = (
                keep_inside(wide, faces, dataclasses.replace(ends, target=ends.target + d), width).along
                for d in (moves, -moves)
            )
            divergence += np.asarray(plus - minus)[:, axis] / (2 * step)
    error = np.abs(np.asarray(found.spread) - divergence).max(1)
    assert (np.abs(divergence).max(1) > 1.0).sum() > 30  # in strips
    assert np.quantile(error, 0.95) < 1e-5, np.sort(error)[-10:]  # all but those on a border of a strip


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
