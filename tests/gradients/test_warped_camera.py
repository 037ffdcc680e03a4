"""Warped areas for what the camera sees: closed forms of black quadrangles and a turning box, and fixed rays beside."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import box, rectangle, sphere
from tests.boundary.film import test_film_edges as film
from tests.references.central_differences import central

WARP = jd.WarpedArea(sigma0=0.02)
SEEN, SEEN_WIDE = (jd.PathTracer(1, warp, primary="warp") for warp in (WARP, jd.WarpedArea(sigma0=0.05)))


def smooth(of: jd.Scene, stddev=0.5) -> jd.Scene:
    """The same under a Gaussian filter."""
    camera = of.camera
    wide = jd.Film(camera.film.width, camera.film.height, jd.Gaussian(stddev))
    return jd.Scene(of.shapes, dataclasses.replace(camera, film=wide), of.environment)


@jax.jit
def gradient(of: jd.Scene, key):
    """Derivatives of the sum of the image by all vertices."""
    values = {n: v for n, v in of.parameters().items() if n.endswith(".vertices")}

    def total(values):
        return jd.render(of.replace(values), key, spp=16, integrator=SEEN).mean(-1).sum()

    return jax.grad(total)(values)


def estimate(of: jd.Scene, keys=16):
    """{name: (mean over keys, standard error)}."""
    rows = [jax.device_get(gradient(of, key)) for key in jax.random.split(jax.random.key(0), keys)]
    stacked = {name: np.stack([row[name] for row in rows]).astype(float) for name in rows[0]}
    return {n: (a.mean(0), a.std(0, ddof=1) / np.sqrt(keys)) for n, a in stacked.items()}


def assert_derivative(found, exact, bias=0.03, precision=0.06):
    mean, error = found
    scale = np.abs(exact).max()
    assert np.all(error < precision * scale), f"too noisy: ± {error.max() / scale}"
    assert np.all(np.abs(mean - exact) < 4.5 * error + bias * scale), f"{mean} ± {error}, exactly\n{exact}"


def half_plane(angle=0.4, gap=0.1, depth=2.0):
    """A black quadrangle with one side in sight, and the derivative of every pixel by its translations [H, W, 3]."""
    c, s = np.cos(angle), np.sin(angle)
    corners = np.array([[-9.0, -9, 0], [gap, -9, 0], [gap, 9, 0], [-9, 9, 0]])
    corners = corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0, 0, depth]
    focal = 0.5 * film.SIZE / np.tan(np.deg2rad(30.0))
    along = np.linspace(-20, 20, 20_001)
    line = film.SIZE / 2 - focal / depth * gap * np.array([c, s]) + along[:, None] * [-s, c]
    # The filters of all pixels along the side.
    offset = line[:, None] - (np.arange(film.SIZE) + 0.5)[None, :, None]
    x, y = np.moveaxis(np.exp(-0.5 * (offset / 0.5) ** 2) / (0.5 * np.sqrt(2 * np.pi)), -1, 0)
    length = y.T @ x * (along[1] - along[0])
    return corners, -length[..., None] * focal / depth * np.array([c, s, -gap / depth])


@jax.jit
def translated(of: jd.Scene, key):
    """Derivatives of all pixels by translations of the quadrangle and of the camera [2, H, W, 3]."""
    values = of.parameters()

    def image(shift):
        moved = {"quad.vertices": values["quad.vertices"] + shift[0]}
        moved["camera.to_world"] = values["camera.to_world"].at[:3, 3].add(shift[1])
        return jd.render(of.replace(moved), key, spp=32, integrator=SEEN_WIDE).mean(-1)

    return jnp.moveaxis(jax.jacfwd(image)(jnp.zeros((2, 3))), 2, 0)


def test_side_of_a_half_plane_before_a_white_sky():
    """The sky is fixed on the film and its boundary moves over it; the camera's step is the half plane's in reverse."""
    corners, exact = half_plane()
    of = smooth(film.scene({"quad": corners}))
    rows = np.stack([jax.device_get(translated(of, key)) for key in jax.random.split(jax.random.key(0), 12)])
    mean, error = rows.mean(0), rows.std(0, ddof=1) / np.sqrt(len(rows))
    for found, noise, true in zip(mean, error, (exact, -exact), strict=True):
        deviation = np.sqrt(((noise * true) ** 2).sum()) / (true**2).sum()
        projection = (found * true).sum() / (true**2).sum()
        assert deviation < 0.03 and abs(projection - 1) < 0.02 + 4 * deviation, (projection, deviation)
        assert np.all(np.abs(found - true) < 5 * noise + 0.04 * np.abs(true).max())


@pytest.mark.slow
@pytest.mark.parametrize("case", ["tilted", "inside"])
def test_black_quadrangle_before_a_white_sky(case):
    """A few per cent are missing, as is expected near corners, over a kernel width."""
    corners = film.CASES[case]
    mean, error = estimate(smooth(film.scene({"quad": corners})), 40)["quad.vertices"]
    exact = -central(lambda c: abs(film.signed_area(film.outline(c))), corners)
    projection = (mean * exact).sum() / (exact**2).sum()
    deviation = np.sqrt(((error * exact) ** 2).sum()) / (exact**2).sum()
    assert deviation < 0.03 and abs(projection - 0.95) < 0.05 + 4 * deviation, (projection, deviation)


@pytest.mark.slow
def test_partly_hidden_quadrangle():
    """Black before black: where the nearer one moves over the other, nothing changes."""
    near = film.SQUARE * [0.6, 0.5, 0.7] + [0.25, 0.15, 0.0]
    found = estimate(smooth(film.scene({"far": film.SQUARE, "near": near})), 40)
    assert_derivative(found["far.vertices"], -central(lambda c: film.union_area(c, near), film.SQUARE), 0.1, 0.1)
    assert_derivative(found["near.vertices"], -central(lambda c: film.union_area(film.SQUARE, c), near), 0.1, 0.1)


LIT_BOX = smooth(film.LIT_BOX)


@jax.jit
def turning_box(key):
    def sums(angle):
        moved = LIT_BOX.replace({"box.vertices": film.turned(angle, film.BOX.vertices, jnp)})
        terms = jd.derivative_terms(moved, key, spp=32, integrator=jd.PathTracer(2, WARP, primary="warp"))
        return jax.tree.map(lambda t: t.mean(-1).sum(), terms)

    return jax.jvp(sums, (jnp.asarray(0.3),), (jnp.asarray(1.0),))


def test_creases_of_a_turning_box():
    """They stay on the surface. Before nothing no other surface shows, so that the warp adds nothing either."""
    exact = (film.lit_box_sum(0.3 + 1e-4) - film.lit_box_sum(0.3 - 1e-4)) / 2e-4
    rows = [jax.device_get(turning_box(key)) for key in jax.random.split(jax.random.key(1), 12)]
    assert set(rows[0][0]) == {"interior", "warp", "boundary"}
    assert all(row[0][name] == 0 for row in rows for name in ("warp", "boundary"))
    total = np.array([sum(row[1].values()) for row in rows])
    mean, error = total.mean(), total.std(ddof=1) / np.sqrt(12)
    assert error < 0.15 * abs(exact), (mean, error, exact)
    assert abs(mean - exact) < 4.5 * error, f"{mean} ± {error}, exactly {exact}"


def ball_before_a_wall() -> jd.Scene:
    """A grey sphere before a bright wall, under a panel, seen from the side of the panel."""
    shapes = {
        "ball": jd.Shape(sphere(2, 0.5), jd.Diffuse(0.3)),
        "wall": jd.Shape(rectangle(4.0, 4.0, center=(0, 0, -1.0)), jd.Diffuse(0.8)),
        "panel": jd.Shape(
            jd.Mesh([[-1, 2, 2.0], [1, 2, 2.0], [1, 3, 1.0], [-1, 3, 1.0]], [[0, 2, 1], [0, 3, 2]]),
            jd.Diffuse(0.0),
            jd.AreaEmitter(10.0),
        ),
    }
    look = jd.look_at([0.3, -0.5, 4.0], [0, 0, 0], [0, 1, 0])
    return jd.Scene(shapes, jd.Perspective(look, 30.0, jd.Film(12, 12, jd.Gaussian(0.5))))


@pytest.mark.slow
@pytest.mark.parametrize("max_depth", [2, 3])
def test_same_derivative_as_with_fixed_rays(max_depth):
    """z-test of every pixel, of a translation and of the camera's step, over keys."""
    of = ball_before_a_wall()
    vertices, pose = of.parameters()["ball.vertices"], of.parameters()["camera.to_world"]

    def image(shifts, key, integrator):
        ball, camera = shifts
        moved = {"ball.vertices": vertices + jnp.asarray([1.0, 0.4, 0.2]) * ball}
        moved["camera.to_world"] = pose.at[:3, 3].add(jnp.asarray([0.5, 1.0, 0.0]) * camera)
        return jd.render(of.replace(moved), key, 64, integrator).mean(-1)

    rows = []
    for primary in ("fixed_ray", "warp"):
        integrator = jd.PathTracer(max_depth, jd.WarpedArea(sigma0=0.02), primary=primary)
        run = jax.jit(jax.jacfwd(lambda shifts, key, i=integrator: image(shifts, key, i)))
        each = [jax.device_get(run(jnp.zeros(2), key)) for key in jax.random.split(jax.random.key(3), 16)]
        rows.append(np.stack(each).astype(float))
    (one, other), (noise, more) = ([f(r) for r in rows] for f in (lambda r: r.mean(0), lambda r: r.std(0, ddof=1) / 4))
    z = (other - one) / np.maximum(np.hypot(noise, more), 1e-3 * np.abs(one).max())
    assert np.abs(z).max() < 6 and np.sqrt((z**2).mean()) < 1.4, (np.abs(z).max(), np.sqrt((z**2).mean()))
    for axis in (0, 1):
        scale = (one[..., axis] ** 2).sum()
        projection = (one[..., axis] * other[..., axis]).sum() / scale
        error = np.sqrt(((one[..., axis] * np.hypot(noise, more)[..., axis]) ** 2).sum()) / scale
        assert error < 0.05 and abs(projection - 1) < 0.02 + 4 * error, (projection, error)


def test_what_is_not_covered():
    with pytest.raises(ValueError, match=r'primary="warp" needs boundary=WarpedArea\(\.\.\.\) .*got KernelDensity'):
        jd.PathTracer(primary="warp", boundary=jd.KernelDensity())
    of = film.scene({"quad": film.SQUARE})
    with pytest.raises(ValueError, match='primary="warp" differentiates the pixel filter, and a Box'):
        jd.render(of, jax.random.key(0), 1, SEEN)
    view = jd.Orthographic(film.LOOK, jd.Film(4, 4, jd.Gaussian()))
    with pytest.raises(ValueError, match='primary="warp" needs a camera with a position, not Orthographic'):
        jd.derivative_terms(jd.Scene(of.shapes, view), jax.random.key(0), 1, SEEN)
    lights = {"lamp": jd.PointLight([0, 0, -1.0], 1.0)}
    lit = jd.Scene({"box": jd.Shape(box())}, smooth(of).camera, lights=lights)
    with pytest.raises(ValueError, match="lights without area light up"):
        jd.derivative_terms(lit, jax.random.key(0), 1, SEEN)
