"""Shadows seen by other cameras than a pinhole, against exact numbers: the floor point of `floor_point`.

A parallel camera sees it along the same ray; all rays through a lens that is focused on it end there.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import displaced_sphere, rectangle
from tests.boundary.film.test_film_edges_cameras import lens_points
from tests.gradients import floor_point
from tests.gradients.floor_point import CAMERA, FILM, POINT, QUADRANGLE, UP, estimates, exact, mean_and_error, sheet

POSE = jd.look_at(CAMERA, POINT, UP)
DISTANCE = float(np.linalg.norm(CAMERA - POINT))
TINY = jd.Film(FILM, FILM, jd.Box())
RADIUS = 1.5
CAMERAS = {
    "parallel": jd.Orthographic(POSE @ np.diag([5e-4, 5e-4, 1.0, 1.0]), TINY),
    "lens": jd.ThinLens(POSE, 0.01, TINY, RADIUS, DISTANCE),
}


def slide(kind):
    """How the point moves as the floor rises: along the ray, the mean over the lens."""
    points, weights = lens_points(8, 32) if kind == "lens" else (np.zeros((1, 2)), np.ones(1))
    origin = CAMERA + RADIUS * points @ POSE[:3, :2].T
    return weights @ (origin / origin[:, 2:])


@pytest.mark.parametrize(
    ("kind", "boundary"),
    [
        pytest.param("parallel", floor_point.SHEET, marks=pytest.mark.slow),
        ("lens", floor_point.SHEET),
        pytest.param("parallel", jd.LineSampling(), marks=pytest.mark.slow),
        pytest.param("lens", jd.LineSampling(), marks=pytest.mark.slow),
    ],
    ids=lambda x: type(x).__name__ if not isinstance(x, str) else x,
)
def test_shadow_derivatives_are_the_closed_form(kind, boundary):
    blocker = sheet(QUADRANGLE, 0.1)
    value, truth = exact(blocker)
    central = CAMERA / CAMERA[2]
    d_point = floor_point.REFLECTANCE / np.pi * floor_point.RADIANCE * _d_point(blocker)
    assert np.isclose(truth["floor.height"], d_point @ central)
    truth["floor.height"] = d_point @ slide(kind)
    of = floor_point.scene(blocker)
    of = jd.Scene(of.shapes, CAMERAS[kind])
    radiance, rows = estimates(of, boundary, sampling="mis")
    mean, deviation = mean_and_error(radiance)
    assert abs(mean - value) < 0.002 * value + 4 * deviation
    for name, true in truth.items():
        scale = max(np.max(np.abs(true)), np.max(np.abs(truth["blocker.vertices"])))
        mean, deviation = (x / scale for x in mean_and_error(rows[name]))
        assert np.max(deviation) < 0.03, f"{name}: too few samples, ± {np.max(deviation):.3f}"
        wrong = np.abs(mean - true / scale) > 0.005 + 4 * deviation
        assert not np.any(wrong), f"{name} is off:\n{mean}\n± {deviation}, exactly\n{true / scale}"


def _d_point(blocker):
    """Derivative of the irradiance by the point's position."""
    vertices = np.asarray(blocker.vertices, float)
    pieces = [vertices[face] for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    return floor_point.irradiance_derivatives(POINT, UP, floor_point.LIGHT, pieces)[2]


# All terms together: a bumpy ball over a floor, a light and a sky, against finite differences.

SIZE = 24
VIEW = jd.look_at([0.5, -5, 1.2], [0, 0, -0.3], [0, 0, 1])
SMOOTH = jd.Film(SIZE, SIZE)
WHOLE = {
    "parallel": jd.Orthographic(VIEW @ np.diag([2.0, 2.0, 1, 1]), SMOOTH),
    "lens": jd.ThinLens(VIEW, 40.0, SMOOTH, 0.25, 3.8),
}
SIDEWAYS, ASKEW = jnp.asarray([1.0, 0, 0]), jnp.asarray([0.7, 0.2, 0.6])
# Parameter, and how it goes with time.
MOTIONS = {
    "ball": ("ball.vertices", lambda v, t: v + t * SIDEWAYS),
    "pose": ("camera.to_world", lambda m, t: m.at[:3, 3].add(t * ASKEW)),
    "scale": ("camera.to_world", lambda m, t: m @ jnp.diag(jnp.asarray([1.0 + t, 1.0 + t, 1.0, 1.0]))),
    "radius": ("camera.aperture_radius", lambda r, t: r + 5 * t),
    "focus": ("camera.focus_distance", lambda f, t: f + 25 * t),
}


def bumpy_scene(kind) -> jd.Scene:
    ball = displaced_sphere(2, 0.1)
    light = jd.Mesh([[-1, -1, 3], [-1, 1, 3], [1, 1, 3], [1, -1, 3]], [[0, 1, 2], [0, 2, 3]])
    shapes = {
        "ball": jd.Shape(ball, jd.Diffuse((0.7, 0.5, 0.3))),
        "floor": jd.Shape(rectangle(8.0, 8.0, (0.0, 0.0, -1.3)), jd.Diffuse(0.5)),
        "light": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
    }
    return jd.Scene(shapes, WHOLE[kind], jd.ConstantEnvironment(0.4))


@pytest.mark.slow
@pytest.mark.parametrize("primary", ["fixed_ray", "material"])
@pytest.mark.parametrize(
    ("kind", "motion"),
    [(kind, motion) for kind in WHOLE for motion in ("ball", "pose")]
    + [("parallel", "scale"), ("lens", "radius"), ("lens", "focus")],
)
def test_whole_gradient_is_the_finite_difference(kind, motion, primary):
    """Common random numbers; the projection on them is one, up to both noises."""
    of, (name, move) = bumpy_scene(kind), MOTIONS[motion]
    start, step = of.parameters()[name], 0.02

    @jax.jit
    def image(t, key):
        integrator = jd.PathTracer(max_depth=3, boundary=None)
        return jd.render(of.replace({name: move(start, t)}), key, spp=512, integrator=integrator)

    @jax.jit
    def gradient(key):
        integrator = jd.PathTracer(max_depth=3, boundary=jd.LineSampling(), primary=primary)

        def at(t):
            return jd.render(of.replace({name: move(start, t)}), key, spp=64, integrator=integrator)

        return jax.jvp(at, (jnp.asarray(0.0),), (jnp.asarray(1.0),))[1]

    keys = jax.random.split(jax.random.key(9), 8)
    differences = np.stack([(image(step, key) - image(-step, key)) / (2 * step) for key in keys]).astype(float)
    found = np.stack([gradient(key) for key in jax.random.split(jax.random.key(1), 8)]).astype(float)
    # Halves of the differences for the norm, so that their noise does not make it larger.
    norm = 2 * (differences[::2].mean(0) * differences[1::2].mean(0)).sum()
    product = (found.mean(0) * differences.mean(0)).sum()
    errors = [
        (found.mean(0) * differences).sum((1, 2, 3)).std(ddof=1) / np.sqrt(8),
        (found * differences.mean(0)).sum((1, 2, 3)).std(ddof=1) / np.sqrt(8),
    ]
    ratio, error = 2 * product / norm, 2 * np.hypot(*errors) / norm
    assert error < 0.1, error
    assert abs(ratio - 1) < 0.03 + 3 * error, f"{ratio} ± {error}"
