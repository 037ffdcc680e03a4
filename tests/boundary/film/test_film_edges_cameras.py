"""Edges seen directly by every kind of camera: derivatives against areas swept over the film, in closed form.

A black quadrangle before a white sky takes its projected area off the sum of the image. With a lens that is the mean
over the lens of what its points see. A lit box adds creases; sums over its visible faces by quadrature.
"""

from functools import cache
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import sphere
from tests.boundary.film.test_film_edges import BOX, LIGHT, QUAD, SIZE, clip, signed_area, turned
from tests.references.polygon_shadow import irradiance

POSE = jd.look_at([0.3, -0.2, -0.1], [0.1, 0.1, 2.0], [0.1, 1, 0])
CORNERS = np.array([[-0.5, -0.3, 1.1], [0.7, -0.3, 2.1], [0.9, 0.8, 3.4], [-0.3, 0.4, 1.9]])
NUMBERS = {
    "perspective": {"to_world": POSE, "fov": 60.0, "principal_point": np.array([0.07, -0.04])},
    "parallel": {"to_world": POSE @ np.diag([1.3, 0.9, 1.1, 1.0])},
    "lens": {
        "to_world": POSE,
        "fov": 60.0,
        "principal_point": np.array([0.07, -0.04]),
        "aperture_radius": 0.15,
        "focus_distance": 1.2,
    },
}
KINDS = {"perspective": jd.Perspective, "parallel": jd.Orthographic, "lens": jd.ThinLens}


def scene(kind, corners, crop=None, **settings) -> jd.Scene:
    film = jd.Film(SIZE, SIZE, jd.Box(), crop)
    camera = KINDS[kind](film=film, **NUMBERS[kind], **settings)
    shapes = {"quad": jd.Shape(jd.Mesh(corners, QUAD), jd.Diffuse(0.0))}
    return jd.Scene(shapes, camera, jd.ConstantEnvironment(1.0))


def lens_points(radii, angles):
    """Points of the unit disk and their weights: Gauss in the squared radius, even in the angle."""
    x, w = np.polynomial.legendre.leggauss(radii)
    radius, weight = np.sqrt((x + 1) / 2), w / 2
    angle = 2 * np.pi * (np.arange(angles) + 0.5) / angles
    points = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return points.reshape(-1, 2), np.repeat(weight / angles, angles)


def outline(corners, numbers, lens, planes):
    """Film points of what is between the clipping planes, from a lens point of the unit disk."""
    local = np.linalg.solve(numbers["to_world"], np.c_[corners, np.ones(len(corners))].T)[:3].T
    for sign, depth in zip((1.0, -1.0), planes, strict=True):
        local = clip(local, np.array([0.0, 0.0, sign]), sign * depth)
    if "fov" not in numbers:
        return SIZE / 2 - SIZE / 2 * local[:, :2]
    focal = 0.5 * SIZE / np.tan(np.deg2rad(numbers["fov"]) / 2)
    point = np.array([*(numbers.get("aperture_radius", 0.0) * lens), 0.0])
    focus = numbers.get("focus_distance", 1.0)
    on_focus = point + (local - point) * (focus / local[:, 2:])
    return SIZE * (0.5 - numbers["principal_point"]) - focal * on_focus[:, :2] / focus


def area(corners, numbers, window, planes=(0.0, 1e4)):
    """Area that the quadrangle covers in a window of the film, the mean over the lens."""
    points, weights = lens_points(6, 24) if "aperture_radius" in numbers else (np.zeros((1, 2)), np.ones(1))
    x0, y0, width, height = window
    total = 0.0
    for face, (lens, weight) in product(QUAD, zip(points, weights, strict=True)):
        polygon = outline(corners[face], numbers, lens, planes)
        for normal, offset in (([1, 0], x0), ([-1, 0], -x0 - width), ([0, 1], y0), ([0, -1], -y0 - height)):
            polygon = clip(polygon, np.array(normal, float), offset)
        total += weight * abs(signed_area(polygon))
    return total


def exact(kind, corners, window, planes=(0.0, 1e4)):
    """Derivatives of the area by name, central differences."""
    numbers = {"vertices": corners} | {k: np.asarray(v, float) for k, v in NUMBERS[kind].items()}
    found = {}
    for name, value in numbers.items():
        found[name] = np.zeros(value.shape)
        for index in np.ndindex(value.shape):
            if name == "to_world" and index[0] == 3:
                continue
            ends = []
            for step in (1e-5, -1e-5):
                moved = {k: v.copy() for k, v in numbers.items()}
                moved[name][index] += step
                ends.append(area(moved.pop("vertices"), moved, window, planes))
            found[name][index] = (ends[0] - ends[1]) / 2e-5
    return found


INTEGRATOR = jd.PathTracer(max_depth=1, edge_samples=8.0)


@jax.jit
def sum_and_gradient(of: jd.Scene, key):
    """Sum of the image over pixels, channels averaged, and its derivative by every parameter of geometry and camera."""
    values = {name: v for name, v in of.parameters().items() if name.startswith(("quad.vertices", "camera"))}

    def total(values):
        return jd.render(of.replace(values), key, spp=8, integrator=INTEGRATOR).mean(-1).sum()

    return jax.value_and_grad(total)(values)


def estimate(of: jd.Scene, keys=16):
    """(sum, derivatives by name): means over keys and standard errors."""
    rows = [jax.device_get(sum_and_gradient(of, key)) for key in jax.random.split(jax.random.key(0), keys)]
    stacked = {name.split(".")[1]: np.stack([row[1][name] for row in rows]) for name in rows[0][1]}
    stacked["sum"] = np.array([row[0] for row in rows])
    return {n: (a.mean(0), a.std(0, ddof=1) / np.sqrt(keys)) for n, a in stacked.items()}


WINDOWS = {"whole": None, "crop": (2, 5, 5, 6)}


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("kind", KINDS)
def test_black_quadrangle_before_a_white_sky(kind, window):
    """Vertices, all numbers of the pose, field of view, principal point, aperture and focus."""
    crop = WINDOWS[window]
    whole = crop or (0, 0, SIZE, SIZE)
    compare(kind, crop, whole)


SLOW = pytest.mark.slow
PLANES = {"near": {"near_clip": 1.6}, "far": {"far_clip": 2.2}, "both": {"near_clip": 1.5, "far_clip": 2.5}}


@pytest.mark.parametrize("planes", [pytest.param("near", marks=SLOW), pytest.param("far", marks=SLOW), "both"])
@pytest.mark.parametrize("kind", KINDS)
def test_clipping_planes_cut_the_quadrangle(kind, planes):
    """The line of the cut moves with the vertices and with the camera."""
    compare(kind, None, (0, 0, SIZE, SIZE), PLANES[planes])


BOARD = np.array([[-0.5, -0.3, 1.1], [0.7, -0.3, 2.1], [0.7, 0.6, 2.5], [-0.5, 0.6, 1.5]])
FORMS = {
    "fixed ray": jd.PathTracer(2),
    "near": jd.PathTracer(3),
    "material": jd.PathTracer(2, primary="material"),
    "bidirectional": jd.BidirectionalPathTracer(2, boundary=jd.KernelDensity()),
}


@pytest.mark.parametrize("form", [pytest.param(name, marks=() if name == "material" else SLOW) for name in FORMS])
def test_a_lit_board_is_cut(form):
    """In every form of first hits. Under an even sky its radiance is half that of the sky, wherever it is."""
    numbers, clipping = NUMBERS["perspective"], PLANES["far"]
    camera = jd.Perspective(film=jd.Film(SIZE, SIZE), **numbers, **clipping)
    board = jd.Shape(jd.Mesh(BOARD, QUAD), jd.TwoSided(jd.Diffuse(0.5)))
    of = jd.Scene({"board": board}, camera, jd.ConstantEnvironment(1.0))

    @jax.jit
    @jax.grad
    def slope(shift, key):
        moved = of.replace({"board.vertices": BOARD + shift})
        return jd.render(moved, key, 64, FORMS[form]).mean(-1).sum()

    slopes = np.stack([slope(jnp.zeros(3), key) for key in jax.random.split(jax.random.key(1), 32)])

    def seen(shift):
        return area(BOARD + shift, numbers, (0, 0, SIZE, SIZE), (0.0, clipping["far_clip"]))

    truth = -0.5 * np.array([seen(1e-5 * axis) - seen(-1e-5 * axis) for axis in np.eye(3)]) / 2e-5
    error, scale = slopes.std(0, ddof=1) / np.sqrt(len(slopes)), np.abs(truth).max()
    assert np.all(error < 0.03 * scale)
    assert np.all(np.abs(slopes.mean(0) - truth) < 4.5 * error + 3e-3 * scale), (slopes.mean(0), error, truth)


def test_warped_camera_rays_know_no_cuts():
    camera = jd.Perspective(film=jd.Film(SIZE, SIZE), **NUMBERS["perspective"], near_clip=1.6)
    of = jd.Scene({"quad": jd.Shape(jd.Mesh(CORNERS, QUAD))}, camera, jd.ConstantEnvironment(1.0))
    warped = jd.PathTracer(2, jd.WarpedArea(), primary="warp")

    def total(vertices):
        return jd.render(of.replace({"quad.vertices": vertices}), jax.random.key(0), 4, warped).sum()

    with pytest.warns(jd.EstimatorWarning, match="near_clip or far_clip"):
        jax.eval_shape(jax.grad(total), jnp.asarray(CORNERS))


def compare(kind, crop, whole, clipping=None):
    """Derivatives by all vertices and all numbers of the camera, against differences of areas."""
    clipping = clipping or {}
    planes = clipping.get("near_clip", 0.0), clipping.get("far_clip", 1e4)
    found, truth = estimate(scene(kind, CORNERS, crop, **clipping)), exact(kind, CORNERS, whole, planes)
    covered = area(CORNERS, NUMBERS[kind], whole, planes)
    assert 0.1 < covered / (whole[2] * whole[3]) < 0.8
    mean, error = found.pop("sum")
    assert abs(whole[2] * whole[3] - covered - mean) < 4.5 * error
    assert set(found) == set(truth)
    for name, expected in truth.items():
        mean, error = found[name]
        scale = max(np.abs(expected).max(), 1e-2 * covered)
        assert np.all(error < 0.05 * scale), f"{name}: too noisy, ± {error.max() / scale}"
        assert np.all(np.abs(mean + expected) < 4.5 * error + 3e-3 * scale), (
            f"{name}: {mean} ± {error}, not {-expected}"
        )


@pytest.mark.parametrize("kind", KINDS)
def test_beyond_the_far_plane_is_nothing(kind):
    """What moves along the cut is right: a strip that gets deeper upwards, moved sideways."""
    up, forward, left, eye = POSE[:3, 1], POSE[:3, 2], POSE[:3, 0], POSE[:3, 3]
    sides = np.array([[0.3, -0.4, 1.0], [-0.2, -0.4, 1.0], [-0.2, 0.6, 2.0], [0.3, 0.6, 2.0]])
    corners = eye + sides @ np.stack([left, up, forward])
    far = 1.5 / (1.1 if kind == "parallel" else 1.0)  # the parallel camera's depth is scaled
    window = (SIZE // 2, 0, SIZE // 2, SIZE)  # the right half: moving to the left takes off what covers it
    found = estimate(scene(kind, corners, window, far_clip=far))
    cut = corners.copy()
    cut[2:] = 0.5 * (corners[2:] + corners[[1, 0]])
    expected = exact(kind, cut, window)["vertices"].sum(0) @ left
    mean, error = (np.sum(x @ left) for x in found["vertices"])
    assert abs(expected) > 1.0 and error < 0.05 * abs(expected)
    assert abs(mean + expected) < 4.5 * error, (mean, error, -expected)


@jax.jit
def growth(of: jd.Scene, key):
    """Sum of the image, and its derivative as the ball grows."""
    vertices = of.parameters()["ball.vertices"]

    def total(factor):
        moved = of.replace({"ball.vertices": factor * vertices})
        return jd.render(moved, key, spp=16, integrator=INTEGRATOR).mean(-1).sum()

    return jax.value_and_grad(total)(jnp.asarray(1.0))


@pytest.mark.parametrize("bumps", [0.0, 0.02])
def test_outlines_of_fine_meshes(bumps):
    """Seen in parallel anything that grows covers its area twice. Many faces at its outline are seen edge-on."""
    ball = sphere(5)
    vertices = np.asarray(ball.vertices)
    vertices = vertices * (1 + bumps * np.random.default_rng(0).standard_normal((len(vertices), 1)))
    camera = jd.Orthographic(
        jd.look_at([0.5, -5, 1.2], [0, 0, 0], [0, 0, 1]) @ np.diag([1.7, 1.7, 1, 1]), jd.Film(SIZE, SIZE, jd.Box())
    )
    shapes = {"ball": jd.Shape(jd.Mesh(vertices, ball.faces), jd.Diffuse(0.0))}
    of = jd.Scene(shapes, camera, jd.ConstantEnvironment(1.0))
    rows = np.array([jax.device_get(growth(of, key)) for key in jax.random.split(jax.random.key(2), 8)], float)
    covered = SIZE**2 - rows[:, 0].mean()
    ratio = rows[:, 1] / (-2 * covered)
    error = ratio.std(ddof=1) / np.sqrt(len(ratio))
    assert error < 0.01 and abs(ratio.mean() - 1) < 4.5 * error + 0.003, f"{ratio.mean()} ± {error}"


# A lit box that turns: creases.

EYE = jd.look_at([1.5, -5.0, 2.0], [0, 0, 0], [0, 0, 1])
ANGLE = 0.38  # a side is seen at a slant: from the centre of the lens, not from all of it
BOX_CAMERAS = {
    "parallel": jd.Orthographic(EYE @ np.diag([1.2, 1.2, 1.0, 1.0]), jd.Film(SIZE, SIZE, jd.Box())),
    "lens": jd.ThinLens(EYE, 30.0, jd.Film(SIZE, SIZE, jd.Box()), 1.3, 6.0),
}


def film_per_area(kind, point, normal):
    """Square pixels per area of a face turned to the camera, the mean over the lens: zero where it is turned away."""
    camera, rotation, eye = BOX_CAMERAS[kind], EYE[:3, :3], EYE[:3, 3]
    if kind == "parallel":
        return (SIZE / 2 / 1.2) ** 2 * max(-normal @ rotation[:, 2], 0.0)
    focal = 0.5 * SIZE / np.tan(np.deg2rad(15.0))
    points, weights = lens_points(12, 48)
    lens = eye + float(camera.aperture_radius) * points @ rotation[:, :2].T
    facing = np.maximum((lens - point) @ normal, 0.0)
    return focal**2 * weights @ facing / ((point - eye) @ rotation[:, 2]) ** 3


@cache
def lit_box_sum(kind, angle, nodes=10):
    vertices = turned(angle, np.asarray(BOX.vertices, float))
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    total = 0.0
    for a, b, c in vertices[np.asarray(BOX.faces)]:
        normal = np.cross(b - a, c - a)
        twice_area = np.linalg.norm(normal)
        normal = normal / twice_area
        for u, wu in zip(x, w, strict=True):
            for v, wv in zip(x, w, strict=True):
                p = a + u * (b - a) + u * v * (c - b)
                seen = film_per_area(kind, p, normal)
                if seen > 0:
                    total += wu * wv * u * twice_area * seen * irradiance(p, normal, LIGHT)
    return 0.5 / np.pi * total


@jax.jit
def lit_box_derivative(of: jd.Scene, key):
    """Sums of the terms over the image, and their derivatives as the box turns."""

    def sums(angle):
        moved = of.replace({"box.vertices": turned(angle, BOX.vertices, jnp)})
        terms = jd.derivative_terms(moved, key, spp=32, integrator=jd.PathTracer(max_depth=2, edge_samples=1.0))
        return jax.tree.map(lambda t: t.mean(-1).sum(), terms)

    return jax.jvp(sums, (jnp.asarray(ANGLE),), (jnp.asarray(1.0),))


@pytest.mark.parametrize("kind", BOX_CAMERAS)
def test_creases_of_a_turning_box(kind):
    """With the wide lens, sides of the box turn towards a part of it: their edges are of both kinds."""
    shapes = {
        "box": jd.Shape(BOX, jd.Diffuse(0.5)),
        "light": jd.Shape(jd.Mesh(LIGHT, QUAD), jd.Diffuse(0.0), jd.AreaEmitter(1.0)),
    }
    of = jd.Scene(shapes, BOX_CAMERAS[kind])
    value, truth = lit_box_sum(kind, ANGLE), (lit_box_sum(kind, ANGLE + 1e-3) - lit_box_sum(kind, ANGLE - 1e-3)) / 2e-3
    rows = [jax.device_get(lit_box_derivative(of, key)) for key in jax.random.split(jax.random.key(1), 12)]
    radiance = np.array([row[0]["interior"] for row in rows])
    assert abs(radiance.mean() - value) < 4 * radiance.std() / np.sqrt(11) + 2e-4 * value, (radiance.mean(), value)
    terms = {name: np.array([row[1][name] for row in rows]) for name in rows[0][1]}
    total = sum(terms.values())
    mean, error = total.mean(), total.std(ddof=1) / np.sqrt(12)
    assert error < 0.05 * abs(truth), (mean, error, truth)
    assert abs(mean - truth) < 4.5 * error + 1e-3 * abs(truth), f"{mean} ± {error}, exactly {truth}"
    assert abs(terms["creases"].mean()) > 6 * error, {n: t.mean() for n, t in terms.items()}
