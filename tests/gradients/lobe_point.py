"""One point of a plane with a narrow lobe, and its radiance in closed form: an integral over what the lobe sees.

The film covers about a millimetre of the plane, so its mean is the radiance of the point. In the lobe there are an open
roof of two quads, a lamp that may be far or near, and the sky; nothing there hides anything else.
"""

from functools import partial

import jax
import numpy as np

import jaxdr as jd
from tests.gradients.floor_point import mean_and_error
from tests.gradients.phong import Phong

REFLECTANCE = 0.8
CAMERA = np.array([0.3, -3.0, 2.6])
MIRROR = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
QUAD = ((0, 1, 2), (0, 2, 3))
SLOPE = np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0)  # about where the lobe points to
ACROSS = np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0)
SIDE = np.array([1.0, 0.0, 0.0])
# Two faces that fold at the ridge (corners 1 and 4), which is nearer to the mirror than the eaves.
ROOF = np.array(
    [
        2.3 * SLOPE + a * SIDE + b * ACROSS - c * SLOPE
        for b in (-0.45, 0.25)
        for a, c in ((-0.5, 0.0), (-0.1, 0.3), (0.35, 0.0))
    ]
)
ROOF_FACES = ((0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2))
ASIDE = ROOF + 4.0 * SIDE  # out of the lobe
# Far from the lobe, and lights the two sides differently; near, in the middle of the lobe.
FAR_LAMP = np.array([14.0, -36.0, 8.0]) + 5 * np.array([[-1.0, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]])
NEAR_LAMP = np.array([0.9 * SLOPE + 0.1 * (a * SIDE + b * ACROSS) for a, b in ((-2, -1), (1, -1), (1, 1), (-2, 1))])
LARGE_LAMP = np.array([4.0 * SLOPE + 1.5 * (a * SIDE + b * ACROSS) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def _to_world(translation):
    """A camera matrix's derivative."""
    derivative = np.zeros((4, 4))
    derivative[:3, 3] = translation
    return derivative


def _along(direction):
    return lambda vertices: np.broadcast_to(direction, vertices.shape)


# Velocities by name: the parameter, and a function of its value.
MOTIONS = {
    "roof along x": ("roof.vertices", _along(SIDE)),
    "roof up": ("roof.vertices", _along(ACROSS)),
    "roof away": ("roof.vertices", _along(SLOPE)),
    "roof widens": ("roof.vertices", lambda vertices: vertices * SIDE),
    "lamp along x": ("lamp.vertices", _along(SIDE)),
    "lamp away": ("lamp.vertices", _along(SLOPE)),
    "mirror up": ("mirror.vertices", _along(np.array([0.0, 0.0, 1.0]))),
    "mirror turns about x": ("mirror.vertices", lambda vertices: np.cross([1.0, 0.0, 0.0], vertices)),
    "mirror turns about y": ("mirror.vertices", lambda vertices: np.cross([0.0, 1.0, 0.0], vertices)),
    "camera along x": ("camera.to_world", lambda _: _to_world(SIDE)),
    "camera up": ("camera.to_world", lambda _: _to_world([0.0, 0.0, 1.0])),
}
NAMES = ("roof.vertices", "lamp.vertices", "mirror.vertices", "camera.to_world")

# What lights the point: the sky behind the roof, the roof in the light of a far lamp, the lamp itself, also behind it.
CASES = {
    "sky": {"sky": 1.0},
    "roof": {"lamp_radiance": 20.0, "reflectance": 0.7},
    "lamp": {"roof": ASIDE, "lamp": NEAR_LAMP, "lamp_radiance": 1.0},
    "eclipse": {"lamp": LARGE_LAMP, "lamp_radiance": 1.0},
}


def scene(
    roof=ROOF,
    lamp=FAR_LAMP,
    width=0.15,
    lamp_radiance=0.0,
    sky=0.0,
    reflectance=0.0,
) -> jd.Scene:
    return jd.Scene(
        shapes={
            "mirror": jd.Shape(jd.Mesh(MIRROR, QUAD), Phong(width, REFLECTANCE)),
            "roof": jd.Shape(jd.Mesh(roof, ROOF_FACES), jd.TwoSided(jd.Diffuse(reflectance))),
            "lamp": jd.Shape(jd.Mesh(lamp, QUAD), jd.Diffuse(0.0), jd.AreaEmitter(lamp_radiance)),
        },
        camera=jd.Perspective(jd.look_at(CAMERA, np.zeros(3), [0, 0, 1]), 0.01, jd.Film(16, 16, jd.Box())),
        environment=jd.ConstantEnvironment(sky),
    )


def radiance(values: dict, width: float, lamp_radiance: float, sky: float, reflectance: float) -> float:
    """Radiance of the point; `values`: vertices of the shapes, motion of the camera."""
    mirror = values["mirror.vertices"]
    normal = _unit(np.cross(mirror[1] - mirror[0], mirror[2] - mirror[0]))
    direction = -_unit(CAMERA)
    position = CAMERA + values["camera.to_world"][:3, 3]
    point = position + (mirror[0] - position) @ normal / (direction @ normal) * direction
    lobe = direction - 2 * (direction @ normal) * normal
    lamp = values["lamp.vertices"]
    total = sky
    distance = np.linalg.norm(lamp.mean(0))
    # The lamp is out of the lobe, all alone in it, or larger than the roof and behind it.
    behind = lamp_radiance if 3 < distance < 10 else sky
    for face in ROOF_FACES:
        corners = values["roof.vertices"][list(face)]
        total += _seen(corners, point, lobe, width, lambda x, n: _lit(x, n, lamp, lamp_radiance, reflectance) - behind)
    for face in QUAD:
        total += _seen(lamp[list(face)], point, lobe, width, lambda x, n: lamp_radiance - sky)
    return REFLECTANCE * total


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def triangle(corners, order=24):
    """Quadrature on a triangle: (points [n, 3], weights [n], unit normals [n, 3])."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    nodes, weights = 0.5 + 0.5 * nodes, 0.5 * weights
    a, b = (t.ravel() for t in np.meshgrid(nodes, nodes, indexing="ij"))
    along, across = corners[1] - corners[0], corners[2] - corners[0]
    points = corners[0] + a[:, None] * along + (b * (1 - a))[:, None] * across
    normal = np.cross(along, across)
    weights = (weights[:, None] * weights).ravel() * (1 - a) * np.linalg.norm(normal)
    return points, weights, np.broadcast_to(_unit(normal), points.shape)


def _seen(corners, point, lobe, width, emission):
    """Integral of the lobe times radiance over the directions of a triangle."""
    x, weights, normal = triangle(corners)
    squared = ((x - point) ** 2).sum(-1)
    towards = _unit(x - point)
    exponent = width**-2
    pdf = (exponent + 1) / (2 * np.pi) * np.maximum(towards @ lobe, 0) ** exponent
    facing = -normal[0] * np.sign(normal[0] @ towards[0])
    return np.sum(weights * pdf * np.abs(towards @ facing) / squared * emission(x, facing))


def _lit(x, normal, lamp, lamp_radiance, reflectance):
    """Radiance that diffuse points scatter under the lamp."""
    on_lamp, weights, across = map(np.concatenate, zip(*(triangle(lamp[list(f)], 4) for f in QUAD), strict=True))
    offset = on_lamp - x[:, None]
    towards = _unit(offset)
    transfer = np.maximum(-(towards * across).sum(-1), 0) * np.maximum(towards @ normal, 0) / (offset**2).sum(-1)
    return reflectance / np.pi * lamp_radiance * (transfer @ weights)


def exact(roof=ROOF, lamp=FAR_LAMP, width=0.15, **light) -> tuple[float, dict[str, float]]:
    """Radiance and its derivatives by motion: central differences of the integral, in double precision."""
    light = {"lamp_radiance": 0.0, "sky": 0.0, "reflectance": 0.0} | light
    values = {
        "mirror.vertices": MIRROR,
        "roof.vertices": roof,
        "lamp.vertices": lamp,
        "camera.to_world": np.zeros((4, 4)),
    }

    def at(name, amount):
        parameter, velocity = MOTIONS[name]
        return radiance(values | {parameter: values[parameter] + amount * velocity(values[parameter])}, width, **light)

    step = 1e-5
    return radiance(values, width, **light), {m: (at(m, step) - at(m, -step)) / (2 * step) for m in MOTIONS}


@partial(jax.jit, static_argnames=("boundary", "spp", "depth"))
def _estimate(of: jd.Scene, key, boundary, spp: int, depth: int):
    values = {name: of.parameters()[name] for name in NAMES}

    def mean(values):
        return jd.render(of.replace(values), key, spp=spp, integrator=jd.PathTracer(depth, boundary)).mean()

    return jax.value_and_grad(mean)(values)


def estimates(of: jd.Scene, boundary, keys: int = 8, spp: int = 16, depth: int = 2):
    """Radiance [keys] and its derivatives {motion: [keys]} for independent keys."""
    radiance, derivatives = [], {name: [] for name in MOTIONS}
    for key in jax.random.split(jax.random.key(0), keys):
        value, gradient = jax.device_get(_estimate(of, key, boundary, spp, depth))
        radiance.append(value)
        for name, (parameter, velocity) in MOTIONS.items():
            derivatives[name].append(
                np.sum(gradient[parameter].astype(float) * velocity(np.asarray(of.parameters()[parameter], float)))
            )
    return np.array(radiance, float), {name: np.array(rows) for name, rows in derivatives.items()}


def check(case: str, boundary, tolerance: float = 0.005, **settings):
    """Assert that the radiance and every derivative are the closed form; errors relative to the largest derivative."""
    value, truth = exact(**CASES[case])
    found, rows = estimates(scene(**CASES[case]), boundary, **settings)
    mean, deviation = mean_and_error(found)
    assert abs(mean - value) < 0.002 * value + 4 * deviation, f"radiance is off: {mean} ± {deviation}, exactly {value}"
    scale = max(abs(d) for d in truth.values())
    for name, exactly in truth.items():
        mean, deviation = mean_and_error(rows[name])
        assert deviation < 0.02 * scale, f"{name}: too few samples, {mean} ± {deviation}"
        off = f"{name} is off: {mean:.5f} ± {deviation:.5f}, exactly {exactly:.5f}"
        assert abs(mean - exactly) < tolerance * scale + 4 * deviation, off
