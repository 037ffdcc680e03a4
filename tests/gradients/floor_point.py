"""A scene whose camera sees one floor point under a polygonal light behind a blocker, with its exact radiance.

The film covers about a millimetre of floor, so its mean is the radiance of `POINT` to a relative error of 1e-6.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from tests.references.polygon_shadow import irradiance, irradiance_derivatives, silhouette

POINT = np.zeros(3)
UP = np.array([0.0, 0.0, 1.0])
CAMERA = np.array([1.0, -7.2, 2.4])
RADIANCE = 3.0
REFLECTANCE = 0.6
FILM = 32
NAMES = ("blocker.vertices", "light.vertices", "floor.vertices")
# Kernel radius of every test here, relative to the blocker's bounding box; a `sheet` chooses the box.
RELATIVE_RADIUS = 1e-3

LIGHT = np.array([[-1.5, -1.5, 1.2], [-1.5, 1.5, 1.2], [1.5, 1.5, 1.2], [1.5, -1.5, 1.2]])
# One edge of the half plane crosses the whole light as seen from the point; the others are out of the light's reach.
HALF_PLANE = np.array([[-2.0, -1.5, 0.6], [0.15, -1.5, 0.6], [0.15, 1.5, 0.6], [-2.0, 1.5, 0.6]])
# All four corners before the light; not planar.
QUADRANGLE = np.array([[-0.35, -0.3, 0.6], [0.45, -0.2, 0.65], [0.25, 0.4, 0.55], [-0.2, 0.35, 0.6]])
# The first corner is a notch in the left side.
BOOMERANG = np.array([[0.0, 0.0, 0.6], [-0.35, -0.4, 0.6], [0.45, 0.0, 0.6], [-0.35, 0.4, 0.6]])


# The default estimator, for sheets and for closed blockers.
SHEET = jd.KernelDensity(RELATIVE_RADIUS)
CLOSED = jd.KernelDensity(0.02)


def sheet(corners, radius: float) -> jd.Mesh:
    """Two triangles over four corners, and a speck far below the floor.

    The kernel radius is relative to the bounding box, a traced value. The speck makes it `radius` (on the light, in
    scene units): all sheets and radii share one compiled program.
    """
    low, high = corners.min(0), corners.max(0)
    depth = np.sqrt((radius / RELATIVE_RADIUS) ** 2 - np.sum((high - low)[:2] ** 2))
    speck = np.array([low, high, [low[0], high[1], 0]]) * [1, 1, 0] + [0, 0, high[2] - depth]
    return jd.Mesh(np.concatenate([corners, speck]), [[0, 1, 2], [0, 2, 3], [4, 5, 6]])


def flat(corners) -> jd.Mesh:
    """An open blocker of two triangles over four corners."""
    return jd.Mesh(corners, [[0, 1, 2], [0, 2, 3]])


def prism(profile, half_length: float) -> jd.Mesh:
    """Closed prism along y over a quadrangle of points (x, z), clockwise seen from -y, cut from corner 0 to 2."""
    profile = np.asarray(profile, float)
    near = np.insert(profile, 1, -half_length, axis=1)
    ring = [(i, (i + 1) % 4) for i in range(4)]
    sides = [[a, b, 4 + a] for a, b in ring] + [[b, 4 + b, 4 + a] for a, b in ring]
    caps = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    return jd.Mesh(np.concatenate([near, near * [1, -1, 1]]), sides + caps)


def arrowhead(concave: float, hidden: float) -> jd.Mesh:
    """A prism with an arrowhead's profile. Its outline meets the light at x = 0 and 0.2, seen from the point.

    A concave edge lies `concave` inside the left side of the shadow, a hidden convex one `hidden` inside the right.
    """
    on_light = [(0.0, 0.65), (0.2 - hidden, 0.75), (concave, 0.65), (0.2, 0.55)]
    return prism([(x * z / LIGHT[0, 2], z) for x, z in on_light], half_length=1.0)


BOX = prism([[-0.3, 0.5], [-0.25, 0.7], [0.2, 0.65], [0.15, 0.45]], half_length=0.5)


def scene(blocker: jd.Mesh, floor_size=0.5, light=LIGHT) -> jd.Scene:
    """The floor (one triangle), the light, and the blocker between them."""
    floor = jd.Mesh(floor_size * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2]])
    black = jd.Diffuse(0.0)
    return jd.Scene(
        shapes={
            "floor": jd.Shape(floor, jd.Diffuse(REFLECTANCE)),
            "light": jd.Shape(jd.Mesh(light, [[0, 1, 2], [0, 2, 3]]), black, jd.AreaEmitter(RADIANCE)),
            "blocker": jd.Shape(blocker, black),
        },
        camera=jd.Perspective(jd.look_at(CAMERA, POINT, UP), 0.01, jd.Film(FILM, FILM, jd.Box())),
    )


def exact(blocker: jd.Mesh, light=LIGHT):
    """Radiance of the point and its derivatives by name, in closed form. Closed blockers must look convex from it."""
    vertices = np.asarray(blocker.vertices, float)
    if blocker.closed:
        outlines = [silhouette(POINT, vertices)]
    else:
        outlines = [face for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    pieces = [vertices[outline] for outline in outlines]
    d_pieces, d_light, d_point = irradiance_derivatives(POINT, UP, light, pieces)
    d_blocker = np.zeros_like(vertices)
    for outline, d_piece in zip(outlines, d_pieces, strict=True):
        np.add.at(d_blocker, outline, d_piece)
    # Raising the floor slides the point along the camera ray.
    slide = (CAMERA - POINT) / (CAMERA - POINT)[2]
    derivatives = {"blocker.vertices": d_blocker, "light.vertices": d_light, "floor.height": d_point @ slide}
    scale = REFLECTANCE / np.pi * RADIANCE
    return scale * irradiance(POINT, UP, light, pieces), {k: scale * v for k, v in derivatives.items()}


def estimates(
    of: jd.Scene,
    boundary,
    keys: int = 8,
    spp: int = 128,
    sampling: str = "emitter",
    rays: str = "auto",
    max_depth: int = 2,
    more: tuple[str, ...] = (),
):
    """Radiance [keys] and its reverse-mode derivatives {name: [keys, ...]}, of `more` as well, for independent keys."""
    parameters = of.parameters()
    values = {name: parameters[name] for name in (*NAMES, *more)}
    run = partial(_estimate, of, values, boundary=boundary, spp=spp, sampling=sampling, rays=rays, max_depth=max_depth)
    rows = [jax.device_get(run(key)) for key in jax.random.split(jax.random.key(0), keys)]
    derivatives = {name: np.stack([row[1][name] for row in rows]).astype(float) for name in values}
    floor = derivatives.pop("floor.vertices")
    return np.array([row[0] for row in rows], float), derivatives | {"floor.height": floor[..., 2].sum(-1)}


@partial(jax.jit, static_argnames=("boundary", "spp", "sampling", "rays", "max_depth"))
def _estimate(of, values, key, boundary, spp, sampling, rays, max_depth):
    def radiance(values):
        integrator = jd.PathTracer(max_depth=max_depth, boundary=boundary, sampling=sampling, rays=rays)
        return jnp.mean(jd.render(of.replace(values), key, spp=spp, integrator=integrator))

    return jax.value_and_grad(radiance)(values)


def mean_and_error(rows):
    """Mean over keys and its standard error."""
    return rows.mean(0), rows.std(0, ddof=1) / np.sqrt(len(rows))


def check_derivatives(blocker: jd.Mesh, boundary, tolerance=0.005, floor_size=0.5, light=LIGHT, **settings):
    """Assert that the radiance and every derivative are the closed form, up to noise and the kernel's bias.

    Errors are relative to the largest entry of the derivative, or of the blocker's if that is larger.
    """
    value, truth = exact(blocker, light)
    radiance, rows = estimates(scene(blocker, floor_size=floor_size, light=light), boundary, **settings)
    mean, deviation = mean_and_error(radiance)
    assert abs(mean - value) < 0.002 * value + 4 * deviation, f"radiance is off: {mean} ± {deviation}, exactly {value}"
    for name, true in truth.items():
        scale = max(np.max(np.abs(true)), np.max(np.abs(truth["blocker.vertices"])))
        true, (mean, deviation) = true / scale, (x / scale for x in mean_and_error(rows[name]))
        assert np.max(deviation) < 0.03, f"{name}: too few samples, ± {np.max(deviation):.3f}"
        wrong = np.abs(mean - true) > tolerance + 4 * deviation
        assert not np.any(wrong), f"{name} is off:\n{mean}\n± {deviation}, exactly\n{true}"
