"""Hard shadows of a quadrangle on a floor: the sum of the image against integrals over the shadow on the film.

The camera sees the floor and the shadow, not what throws it. The reference integrates in float64 and differentiates
by central differences.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxdr as jd
from tests.references.central_differences import central

SIZE = 16
EYE = jd.look_at([0.3, -4.0, 1.6], [0.2, 0.4, 0.0], [0, 0, 1])
FOV = 26.0
REFLECTANCE = 0.6
QUAD = np.array([[-0.2, -0.1, 2.0], [0.35, -0.05, 2.1], [0.3, 0.4, 2.2], [-0.15, 0.35, 2.1]])
FACES = [[0, 1, 2], [0, 2, 3]]
FOCAL = 0.5 * SIZE / np.tan(np.deg2rad(FOV) / 2)
LIGHTS = {
    "point": (jd.PointLight([0.2, 0.5, 4.0], 5.0), {"position"}),
    "spot": (jd.SpotLight([0.3, -0.2, 4.0], [0.05, 0.3, -2.0], 8.0, 40.0, 3.0), {"position", "direction"}),
    "directional": (jd.DirectionalLight([0.1, -0.2, -1.0], 2.0), {"direction"}),
}


def irradiance(light: dict, points):
    """On the floor, of a light with these parameters."""
    if "irradiance" in light:
        d = light["direction"] / np.linalg.norm(light["direction"])
        return np.full(len(points), -d[2] * light["irradiance"][0])
    offset = light["position"] - points
    distance = np.linalg.norm(offset, axis=1)
    value = light["intensity"][0] * offset[:, 2] / distance**3
    if "direction" in light:
        d = light["direction"] / np.linalg.norm(light["direction"])
        angle = np.arccos(-offset @ d / distance)
        cutoff, beam = np.deg2rad(light["cutoff_angle"]), np.deg2rad(light["beam_width"])
        value = value * np.clip((cutoff - angle) / (cutoff - beam), 0, 1)
    return value


def shadow(light: dict, corners, height):
    """Corners of the shadow on the floor."""
    if "position" in light:
        rays = corners - light["position"]
    else:
        rays = np.broadcast_to(light["direction"], corners.shape)
    return corners + rays * ((height - corners[:, 2]) / rays[:, 2])[:, None]


def film_points(points, eye):
    local = (points - eye) @ EYE[:3, :3]
    return SIZE / 2 - FOCAL * local[:, :2] / local[:, 2:]


def triangle_integral(light, corners, height, eye, nodes=24):
    """Radiance over a triangle on the film, signed by its orientation."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    x, w = (x + 1) / 2, w / 2
    u, v = np.meshgrid(x, x, indexing="ij")
    weight = np.outer(w, w) * u
    a, b, c = corners
    p = (a + u[..., None] * (b - a) + (u * v)[..., None] * (c - b)).reshape(-1, 2)
    local = np.concatenate([(SIZE / 2 - p) / FOCAL, np.ones((len(p), 1))], 1)
    d = local @ EYE[:3, :3].T
    points = eye + d * ((height - eye[2]) / d[:, 2])[:, None]
    (bx, by), (cx, cy) = b - a, c - b
    return (bx * cy - by * cx) * weight.ravel() @ (light(points) if callable(light) else irradiance(light, points))


def image_sum(light, corners, height=0.0, eye=EYE[:3, 3]):
    """Of one channel; the film's window less the shadow."""
    window = np.array([[0, 0], [SIZE, 0], [SIZE, SIZE], [0, SIZE]], float)
    polygon = film_points(shadow(light, corners, height), eye)
    total = 0.0
    for outline, sign in ((window, 1.0), (polygon, -1.0)):
        parts = sum(triangle_integral(light, outline[list(f)], height, eye) for f in FACES)
        total += sign * abs(parts)
    return REFLECTANCE / np.pi * total


def scene(light):
    floor = jd.Mesh(30.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]), FACES)
    shapes = {
        "quad": jd.Shape(jd.Mesh(QUAD, FACES), jd.Diffuse(0.0)),
        "floor": jd.Shape(floor, jd.Diffuse(REFLECTANCE)),
    }
    return jd.Scene(shapes, jd.Perspective(EYE, FOV, jd.Film(SIZE, SIZE, jd.Box())), lights={"lamp": light})


def derivatives(of, key, names, spp=16):
    def total(values):
        values = dict(values)
        vertices = of.parameters()["floor.vertices"]
        values["floor.vertices"] = vertices + values.pop("height") * jnp.asarray([0.0, 0.0, 1.0])
        to_world = of.parameters()["camera.to_world"]
        values["camera.to_world"] = to_world.at[:3, 3].add(values.pop("eye"))
        image = jd.render(of.replace(values), key, spp, jd.PathTracer(2, edge_samples=0.25))
        return image[..., 0].sum()

    at = {name: of.parameters()[name] for name in ("quad.vertices", *(f"lamp.{n}" for n in sorted(names)))}
    return jax.value_and_grad(total)(at | {"height": jnp.zeros(()), "eye": jnp.zeros(3)})


def exact(light, names):
    values = {n[5:]: np.asarray(v, float) for n, v in scene(light).parameters().items() if n.startswith("lamp.")}
    eye = EYE[:3, 3]

    found = {f"lamp.{n}": central(lambda v, n=n: image_sum({**values, n: v}, QUAD), values[n]) for n in names}
    found["quad.vertices"] = central(lambda v: image_sum(values, v), QUAD)
    found["eye"] = central(lambda v: image_sum(values, QUAD, 0.0, v), eye)
    found["height"] = central(lambda v: image_sum(values, QUAD, v), np.array(0.0))
    return image_sum(values, QUAD), found


def check(rows, truth, precision=0.02):
    """Means over keys against exact derivatives by name."""
    for name, expected in truth.items():
        stacked = np.stack([row[name] for row in rows])
        mean, error = stacked.mean(0), stacked.std(0, ddof=1) / len(rows) ** 0.5
        scale = np.abs(expected).max()
        assert np.all(error < precision * scale), (name, error / scale)
        assert np.all(np.abs(mean - expected) < 5 * error + 1e-3 * scale), (name, mean / scale, expected / scale)


@pytest.mark.parametrize(
    "kind", [pytest.param("spot", marks=pytest.mark.slow), "point", pytest.param("directional", marks=pytest.mark.slow)]
)
def test_shadow_of_a_quadrangle(kind):
    """What throws the shadow, the light, the floor and the camera move."""
    light, names = LIGHTS[kind]
    of, (value, truth) = scene(light), exact(light, names)
    step = jax.jit(lambda key: derivatives(of, key, names))
    rows = [jax.device_get(step(key)) for key in jax.random.split(jax.random.key(0), 32)]
    np.testing.assert_allclose(np.mean([row[0] for row in rows]), value, rtol=2e-3)
    check([row[1] for row in rows], truth)


def projected_sum(to_world, fov, height=0.0):
    """Of an image of ones that a projector throws on the floor, beside nothing."""
    tangent = np.tan(np.deg2rad(fov) / 2)
    corners = (
        to_world[:3, 3]
        + np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]])
        * [
            tangent,
            tangent,
            1,
        ]
        @ to_world[:3, :3].T
    )
    axis, position = to_world[:3, 2], to_world[:3, 3]
    outline = film_points(shadow({"position": position}, corners, height), EYE[:3, 3])

    def received(points):
        offset = points - position
        distance, depth = np.linalg.norm(offset, axis=1), offset @ axis
        return np.pi / (depth**2 * depth / distance) * -offset[:, 2] / distance

    parts = sum(triangle_integral(received, outline[list(f)], height, EYE[:3, 3]) for f in FACES)
    return REFLECTANCE / np.pi * abs(parts)


@pytest.mark.slow
def test_border_of_a_projected_image():
    """The projector turns, moves and zooms; the floor moves."""
    to_world = np.asarray(jd.look_at([0.4, 1.0, 3.0], [0.2, 0.4, 0.0], [0, 1, 0]))
    of = scene(jd.Projector(np.ones((2, 2, 3)), to_world, 20.0))
    of = jd.Scene({"floor": of.shapes["floor"]}, of.camera, lights=of.lights)
    turn = np.zeros((4, 4))
    turn[:3, :3] = np.cross([0.3, 0.5, -0.8], to_world[:3, :3], axis=0)
    moves = [turn, *(np.pad(np.eye(3)[:, k : k + 1], ((0, 1), (3, 0))) for k in range(3))]

    def total(values, key):
        matrix = sum((v * jnp.asarray(m, float) for v, m in zip(values["moves"], moves, strict=True)), to_world)
        vertices = of.parameters()["floor.vertices"] + values["height"] * jnp.asarray([0.0, 0.0, 1.0])
        replaced = {"lamp.to_world": matrix, "lamp.fov": values["fov"], "floor.vertices": vertices}
        return jd.render(of.replace(replaced), key, 16, jd.PathTracer(2, edge_samples=0.25))[..., 1].sum()

    at = {"moves": jnp.zeros(4), "fov": jnp.asarray(20.0), "height": jnp.zeros(())}
    step = jax.jit(lambda key: jax.value_and_grad(total)(at, key))
    rows = [jax.device_get(step(key)) for key in jax.random.split(jax.random.key(1), 12)]
    np.testing.assert_allclose(np.mean([row[0] for row in rows]), projected_sum(to_world, 20.0), rtol=4e-3)

    def turned(v):
        angle = np.linalg.norm([0.3, 0.5, -0.8]) * v[0]
        matrix = to_world + sum(x * m for x, m in zip(v[1:], moves[1:], strict=True))
        axis = np.array([0.3, 0.5, -0.8]) / np.linalg.norm([0.3, 0.5, -0.8])
        matrix[:3, :3] = Rotation.from_rotvec(angle * axis).as_matrix() @ to_world[:3, :3]
        return projected_sum(matrix, 20.0)

    truth = {
        "moves": central(turned, np.zeros(4)),
        "fov": central(lambda v: projected_sum(to_world, v), np.array(20.0)),
        "height": central(lambda v: projected_sum(to_world, 20.0, v), np.array(0.0)),
    }
    check([row[1] for row in rows], truth)


# A point of a wall, lit by what a spot lights on the floor.

WALL = np.array([0.2, 2.5, 1.0])
SPOT = jd.SpotLight([0.3, 0.2, 4.0], [0.05, 0.1, -2.0], 8.0, 32.0, 3.0)


def wall_radiance(light, corners, height=0.0):
    def transported(points):
        offset = points - WALL
        squared = (offset**2).sum(1)
        return irradiance(light, points) * offset[:, 1].clip(max=0) * offset[:, 2] / squared**2

    def on_floor(triangle, nodes):
        x, w = np.polynomial.legendre.leggauss(nodes)
        x, w = (x + 1) / 2, w / 2
        u, v = np.meshgrid(x, x, indexing="ij")
        a, b, c = triangle
        points = (a + u[..., None] * (b - a) + (u * v)[..., None] * (c - b)).reshape(-1, 3)
        return np.linalg.norm(np.cross(b - a, c - b)) * (np.outer(w, w) * u).ravel() @ transported(points)

    whole = np.array([[-6.0, -6, height], [6, -6, height], [6, 2.5, height], [-6, 2.5, height]])
    dark = shadow(light, corners, height)
    total = sum(on_floor(whole[list(f)], 300) for f in FACES) - sum(on_floor(dark[list(f)], 32) for f in FACES)
    return REFLECTANCE**2 / np.pi**2 * total


def wall_scene():
    of = scene(SPOT)
    wall = jd.Mesh([[-3, 2.5, 0.5], [3, 2.5, 0.5], [3, 2.5, 1.5], [-3, 2.5, 1.5]], FACES)
    shapes = dict(of.shapes) | {"wall": jd.Shape(wall, jd.Diffuse(REFLECTANCE))}
    camera = jd.Perspective(jd.look_at([0.1, -1, 1], WALL, [0, 0, 1]), 0.01, jd.Film(16, 16, jd.Box()))
    return jd.Scene(shapes, camera, lights=of.lights)


def wall_derivatives(of, key, boundary, spp):
    def mean(values):
        vertices = of.parameters()["floor.vertices"] + values["height"] * jnp.asarray([0.0, 0.0, 1.0])
        replaced = {"floor.vertices": vertices} | {n: v for n, v in values.items() if n != "height"}
        return jd.render(of.replace(replaced), key, spp, jd.PathTracer(3, boundary)).mean()

    at = {name: of.parameters()[name] for name in ("quad.vertices", "lamp.position", "lamp.direction")}
    return jax.value_and_grad(mean)(at | {"height": jnp.zeros(())})


@pytest.mark.slow
def test_light_scattered_by_a_floor_with_a_shadow():
    light = {n[5:]: np.asarray(v, float) for n, v in scene(SPOT).parameters().items() if n.startswith("lamp.")}
    of = wall_scene()
    step = jax.jit(lambda key: wall_derivatives(of, key, jd.KernelDensity(), 64))
    rows = [jax.device_get(step(key)) for key in jax.random.split(jax.random.key(2), 12)]
    values = np.array([row[0] for row in rows])
    assert abs(values.mean() / wall_radiance(light, QUAD) - 1) < 0.01
    truth = {
        "quad.vertices": central(lambda v: wall_radiance(light, v), QUAD),
        "height": central(lambda v: wall_radiance(light, QUAD, v), np.array(0.0)),
        "lamp.position": central(lambda v: wall_radiance({**light, "position": v}, QUAD), light["position"]),
    }
    check([row[1] for row in rows], truth, 0.05)
