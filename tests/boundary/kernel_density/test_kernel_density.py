"""Kernel density: its radii and options, the projection behind it, and a shadow under a sky."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.boundary.kernel_density.plain_kernel import PLAIN
from jaxdr.boundary.shared.path_segments import SegmentEnds
from jaxdr.boundary.shared.projection import displacement, project_edges
from jaxdr.geometry.shapes import displaced_sphere
from jaxdr.scene.packed import pack
from tests.references.central_differences import central

CAMERA = jd.Perspective(jd.look_at([0, -4, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(4, 4))


def test_radius_schedule():
    """r_{t+1} = r_t sqrt((t + α) / (t + 1)), t = 1, 2, … (Eq. 21)."""
    schedule = jd.KernelDensity(alpha=0.3, iterations=6).radius_schedule()
    assert len(schedule) == 6 and schedule[0] == 1.0
    assert jd.KernelDensity(iterations=1).radius_schedule() == [1.0]
    assert np.all(np.diff(schedule) < 0)
    ratios = np.square(np.divide(schedule[1:], schedule[:-1]))
    t = np.arange(len(ratios))
    np.testing.assert_allclose(ratios, (t + 0.3) / (t + 1))
    # Radii fall like t^((α - 1) / 2).
    long = jd.KernelDensity(alpha=0.3, iterations=2000).radius_schedule()
    np.testing.assert_allclose(long[1999] / long[499], 4.0**-0.35, rtol=1e-2)


def test_the_plain_kernel_is_the_papers():
    """Each switch that `KernelDensity` has for a difference to the paper is off in it."""
    ours, plain = jd.KernelDensity(), jd.KernelDensity(**PLAIN)
    switches = {field.name for field in dataclasses.fields(ours)} - {"radius", "alpha", "points", "capacity"}
    assert set(PLAIN) == switches
    assert all(getattr(plain, name) != getattr(ours, name) for name in switches)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"radius": 0.0}, "radius must be positive"),
        ({"radius": float("nan")}, "radius must be a number, got nan"),
        ({"alpha": 1.0}, "alpha must lie between 0 and 1"),
        ({"alpha": 0.0}, "alpha must lie between 0 and 1"),
        ({"iterations": 0}, "iterations must be at least 1"),
        ({"points": 0}, "points must be at least 1"),
        ({"widest": -0.1}, "widest must not be negative"),
        ({"capacity": 0.0}, "capacity must be positive"),
    ],
)
def test_options(options, message):
    with pytest.raises(ValueError, match=f"KernelDensity: {message}"):
        jd.KernelDensity(**options)


def random_projections(count=200, seed=0):
    """Edges of a mesh near (0, 0, 1), projected from apexes above it onto random planes below."""
    mesh = displaced_sphere(1, center=(0.0, 0.0, 1.0), radius=0.5)
    packed = pack(jd.Scene({"bumps": jd.Shape(mesh)}, CAMERA))
    rng = np.random.default_rng(seed)
    apex = rng.uniform([-1, -1, 3], [1, 1, 4], (count, 3))
    normal = rng.normal([0, 0, 2], 0.5, (count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    target = rng.uniform([-1, -1, -2], [1, 1, -1], (count, 3))
    corners = target[:, None] + np.linalg.svd(normal[:, None])[2][:, [1, 2, 1]] * rng.uniform(1, 2, (count, 3, 1))
    corners[:, 2] = target - corners[:, 0] - corners[:, 1] + 2 * target  # around the target
    apex, target, normal, corners = (jnp.asarray(x, jnp.float32) for x in (apex, target, normal, corners))
    none = jnp.full(count, -1)
    ends = SegmentEnds(apex, none, target, normal, none, corners, jnp.zeros(count, bool))
    edge = jnp.asarray(rng.integers(len(packed.edges.vertices), size=count))
    along = jnp.asarray(rng.uniform(0, 1, count), jnp.float32)
    return packed, edge, ends, along


def test_projection_lies_on_ray_and_plane():
    packed, edge, ends, along = random_projections()
    found = project_edges(packed, edge, ends, along)
    a, b = (np.asarray(packed.vertices)[np.asarray(packed.edges.vertices)[np.asarray(edge), k]] for k in (0, 1))
    share = np.asarray(along)[:, None]
    np.testing.assert_allclose(found.edge_point, (1 - share) * a + share * b, atol=1e-5)
    off_plane = ((np.asarray(found.point) - ends.target) * ends.normal).sum(-1)
    np.testing.assert_allclose(off_plane, 0, atol=2e-5)
    middle = np.asarray(ends.apex) + np.asarray(found.fraction)[:, None] * (np.asarray(found.point) - ends.apex)
    np.testing.assert_allclose(middle, found.edge_point, atol=2e-5)
    np.testing.assert_allclose((np.asarray(found.normal) * ends.normal).sum(-1), 0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=-1), 1, rtol=1e-5)


def test_stretch_is_the_papers_ratio_of_lengths():
    """Eq. 16: length on the plane per length of edge, from distances and angles as the paper writes it.

    dl/de = (distance to the plane / distance to the edge) · sin(edge, ray) / sin(projected edge, ray).
    """
    packed, edge, ends, along = random_projections()
    found = project_edges(packed, edge, ends, along)
    apex, target, normal = (np.asarray(x, float) for x in (ends.apex, ends.target, ends.normal))
    a, b = (np.asarray(packed.vertices, float)[np.asarray(packed.edges.vertices)[np.asarray(edge), k]] for k in (0, 1))

    def on_plane(p):
        height = ((target - apex) * normal).sum(-1) / ((p - apex) * normal).sum(-1)
        return apex + (p - apex) * height[:, None]

    def sine(u, v):
        return np.linalg.norm(np.cross(u, v), axis=-1) / np.linalg.norm(u, axis=-1) / np.linalg.norm(v, axis=-1)

    share = np.asarray(along, float)[:, None]
    on_edge = (1 - share) * a + share * b
    boundary = on_plane(on_edge)
    ray, projected = on_edge - apex, on_plane(b) - on_plane(a)
    distances = np.linalg.norm(boundary - apex, axis=-1) / np.linalg.norm(ray, axis=-1)
    exact = distances * sine(b - a, ray) / sine(projected, ray)
    np.testing.assert_allclose(found.stretch, exact, rtol=2e-3)
    step = 1e-6 * (b - a)
    numeric = np.linalg.norm(on_plane(on_edge + step) - on_plane(on_edge - step), axis=-1) / np.linalg.norm(
        2 * step, axis=-1
    )
    np.testing.assert_allclose(exact, numeric, rtol=1e-5)


def test_displacement_is_the_velocity_of_the_shadow():
    """Its derivative against differences of the projected line, for a moving edge and a moving receiver."""
    packed, edge, ends, along = random_projections(20)
    rng = np.random.default_rng(1)
    velocity = rng.standard_normal(packed.vertices.shape)
    receiver = rng.standard_normal(3)  # translation of the target's face

    with jax.enable_x64(True):
        wide = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.float64) if x.dtype == jnp.float32 else x, (packed, ends, along)
        )
        packed, ends, along = wide
        nowhere = jnp.zeros(())

        base = project_edges(packed, edge, ends, along)

        def moved_by(t, s):
            moved = jax.tree.map(lambda x: x, packed)
            object.__setattr__(moved, "vertices", packed.vertices + t * velocity)
            shift = s * jnp.asarray(receiver)
            target = SegmentEnds(
                ends.apex,
                ends.apex_face,
                ends.target + shift,
                ends.normal,
                ends.face,
                ends.corners + shift,
                ends.infinite,
            )
            return displacement(moved, edge, target, base)

        by_edge = jax.jvp(lambda t: moved_by(t, nowhere), (nowhere,), (jnp.ones(()),))[1]
        by_face = jax.jvp(lambda s: moved_by(nowhere, s), (nowhere,), (jnp.ones(()),))[1]
        point, n = np.asarray(base.point), np.asarray(base.normal)
        apex, target, normal = (np.asarray(x) for x in (ends.apex, ends.target, ends.normal))

    def crossing(p, plane_point):
        height = ((plane_point - apex) * normal).sum(-1) / ((p - apex) * normal).sum(-1)
        return apex + (p - apex) * height[:, None]

    ids = np.asarray(packed.edges.vertices)[np.asarray(edge)]
    share = np.asarray(along)[:, None]
    speed = (1 - share) * velocity[ids[:, 0]] + share * velocity[ids[:, 1]]
    start, h = np.asarray(base.edge_point), 1e-6
    moving_edge = (crossing(start + h * speed, target) - crossing(start - h * speed, target)) / (2 * h)
    np.testing.assert_allclose(by_edge, (moving_edge * n).sum(-1), rtol=1e-4, atol=1e-5)
    moving_plane = (crossing(start, target + h * receiver) - crossing(start, target - h * receiver)) / (2 * h)
    np.testing.assert_allclose(by_face, ((moving_plane - receiver) * n).sum(-1), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(point, crossing(start, target), atol=1e-6)


# A plate over a floor under a constant sky: light that arrives from infinity.

PLATE = np.array([[-0.6, -0.5, 0.5], [0.5, -0.5, 0.5], [0.5, 0.4, 0.5], [-0.6, 0.4, 0.5]])
FLOOR = jd.Mesh([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.0, 0.5, 0.0]], [[0, 1, 2]])
UNDER_THE_SKY = jd.Scene(
    {
        "floor": jd.Shape(FLOOR, jd.Diffuse(0.6)),
        "plate": jd.Shape(jd.Mesh(PLATE, [[0, 1, 2], [0, 2, 3]]), jd.TwoSided(jd.Diffuse(0.0))),
    },
    jd.Perspective(jd.look_at([1.0, -6.0, 0.4], [0, 0, 0], [0, 0, 1]), 0.01, jd.Film(16, 16, jd.Box())),
    jd.ConstantEnvironment(2.0),
)


def sky_radiance(corners):
    """Radiance of the origin of the floor: what the plate leaves of the sky, by Lambert's contour formula."""
    unit = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    following = np.roll(unit, -1, axis=0)
    cross = np.cross(unit, following)
    angle = np.arctan2(np.linalg.norm(cross, axis=1), (unit * following).sum(1))
    hidden = 0.5 * np.sum(angle * cross[:, 2] / np.linalg.norm(cross, axis=1))
    return 0.6 / np.pi * 2.0 * (np.pi - abs(hidden))


@partial(jax.jit, static_argnames="boundary")
def sky_estimate(key, boundary):
    start = UNDER_THE_SKY.parameters()["plate.vertices"]

    def radiance(vertices):
        integrator = jd.PathTracer(max_depth=2, boundary=boundary)
        moved = UNDER_THE_SKY.replace({"plate.vertices": vertices})
        return jd.render(moved, key, spp=64, integrator=integrator).mean()

    return jax.value_and_grad(radiance)(start)


@pytest.mark.parametrize("boundary", [jd.KernelDensity(0.03), jd.LineSampling()], ids=["kernel density", "lines"])
def test_shadow_under_a_sky(boundary):
    """Derivative with respect to every corner of the plate, against the closed form."""
    exact = central(sky_radiance, PLATE)
    rows = [jax.device_get(sky_estimate(key, boundary)) for key in jax.random.split(jax.random.key(2), 16)]
    values, gradients = (np.stack([row[k] for row in rows]) for k in (0, 1))
    assert abs(values.mean() - sky_radiance(PLATE)) < 4 * values.std(ddof=1) / 4
    mean, error = gradients.mean(0), gradients.std(0, ddof=1) / 4
    scale = np.abs(exact).max()
    assert np.all(error < 0.05 * scale), error / scale
    assert np.all(np.abs(mean - exact) < 0.015 * scale + 4 * error), f"{mean} ± {error}, exactly\n{exact}"
