"""One point of a rough glass interface, and its radiance as an integral over both hemispheres, by quadrature.

The film covers about a millimetre of the interface, a plane that has air above and glass below, so its mean is the
radiance of the point. On either side, or astride of the plane, there are a black plate and a lamp before the sky.
Facets are Beckmann's: the model's own jump, where a facet would face down, is nothing then.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import jaxdr as jd
from tests.gradients.lobe_point import triangle

ETA, ALPHA, LIGHT = 1.5, 0.3, 5.0
UP = np.array([0.0, 0.0, 1.0])
SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
QUAD = ((0, 1, 2), (0, 2, 3))
ABOVE, BELOW = np.array([0.3, -3.0, 2.6]), np.array([0.2, -1.3, -3.6])  # where the camera is
NAMES = ("glass.vertices", "plate.vertices", "lamp.vertices", "camera.to_world", "glass.bsdf.eta", "glass.bsdf.alpha")


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def mirrored(camera):
    """Direction of the light that is reflected to the camera."""
    return unit(camera * [-1, -1, 1])


def refracted(camera):
    """Direction of the light that is refracted to the camera; it must not be totally reflected."""
    relative = ETA if camera[2] > 0 else 1.0 / ETA
    across = -unit(camera)[:2] / relative
    return np.array([*across, -np.sign(camera[2]) * np.sqrt(1.0 - across @ across)])


def patch(direction, distance, low, high):
    """A quad across a direction that faces back, from `low` to `high` in units of distance times (aside, up)."""
    aside = unit(np.cross(direction, UP))
    up = np.cross(aside, direction)
    corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([distance * (direction + a * aside + b * up) for a, b in corners])


FAR = 40.0 * UP + 1e-3 * SQUARE  # a speck that counts for nothing
HORIZON = unit(np.array([-0.1, 1.0, 0.0]))

# Camera, plate, lamp, radiance of the sky. Lamps shine by `LIGHT` on the side that they show.
CASES = {
    "reflected": (ABOVE, patch(mirrored(ABOVE), 2.0, (-0.7, -0.6), (0.15, 0.2)), FAR, 1.0),
    "refracted": (ABOVE, patch(refracted(ABOVE), 2.0, (-0.5, -0.4), (0.05, 0.1)), FAR, 1.0),
    "astride": (ABOVE, patch(HORIZON, 2.5, (-0.6, -0.8), (0.5, 0.9)), FAR, 1.0),
    "from inside": (BELOW, patch(refracted(BELOW), 2.0, (-0.5, -0.4), (0.05, 0.1)), FAR, 1.0),
    "lamp": (ABOVE, FAR, patch(refracted(ABOVE), 2.0, (-0.4, -0.3), (0.05, 0.1)), 0.0),
    "lamp astride": (ABOVE, FAR, patch(HORIZON, 2.5, (-0.6, -0.8), (0.5, 0.9)), 0.0),
    "lamp astride behind a plate": (
        ABOVE,
        patch(HORIZON, 1.5, (-0.3, -0.5), (0.2, 0.4)),
        patch(HORIZON, 2.5, (-0.6, -0.8), (0.5, 0.9)),
        0.0,
    ),
    "lamp inside behind a plate": (
        BELOW,
        patch(refracted(BELOW), 2.0, (-0.3, -0.2), (0.1, 0.1)),
        patch(refracted(BELOW), 3.0, (-0.6, -0.6), (0.6, 0.6)),
        0.0,
    ),
}


def scene(case: str, alpha: float = ALPHA) -> jd.Scene:
    camera, plate, lamp, sky = CASES[case]
    black = jd.Diffuse(0.0)
    shapes = {
        "glass": jd.Shape(jd.Mesh(SQUARE, QUAD), jd.RoughDielectric(alpha, ETA, 1.0, distribution="beckmann")),
        "plate": jd.Shape(jd.Mesh(plate, QUAD), black),
        "lamp": jd.Shape(jd.Mesh(lamp, QUAD), black, None if sky else jd.AreaEmitter(LIGHT)),
    }
    view = jd.Perspective(jd.look_at(camera, np.zeros(3), UP), 0.01, jd.Film(16, 16, jd.Box()))
    return jd.Scene(shapes, view, jd.ConstantEnvironment(sky) if sky else None)


def _along(direction):
    return lambda values: np.broadcast_to(direction, values.shape)


def _to_world(values):
    derivative = np.zeros((4, 4))
    derivative[:3, 3] = [1.0, 0.4, 0.3]
    return derivative


# Velocities by name: the parameter, and a function of its value.
MOTIONS = {
    "plate along x": ("plate.vertices", _along([1.0, 0, 0])),
    "plate along y": ("plate.vertices", _along([0, 1.0, 0])),
    "plate along z": ("plate.vertices", _along([0, 0, 1.0])),
    "lamp along x": ("lamp.vertices", _along([1.0, 0, 0])),
    "lamp along z": ("lamp.vertices", _along([0, 0, 1.0])),
    "glass up": ("glass.vertices", _along(UP)),
    "glass turns about x": ("glass.vertices", lambda v: np.cross([1.0, 0, 0], v)),
    "glass turns about y": ("glass.vertices", lambda v: np.cross([0, 1.0, 0], v)),
    "camera": ("camera.to_world", _to_world),
    "eta": ("glass.bsdf.eta", np.ones_like),
    "alpha": ("glass.bsdf.alpha", np.ones_like),
}


def _polygon(corners, height, order=40):
    """Quadrature on a convex polygon: (points [n, 3], weights [n]).

    In parts above and below where `height` is zero, across which BSDFs have a bend.
    """
    points, weights = [], []
    for side in (1.0, -1.0):
        part = []
        for one, two, h1, h2 in zip(corners, np.roll(corners, -1, 0), height, np.roll(height, -1), strict=True):
            part += [one] if side * h1 >= 0 else []
            part += [one + h1 / (h1 - h2) * (two - one)] if h1 * h2 < 0 else []
        for i in range(1, len(part) - 1):
            ontriangle, weight, _ = triangle(np.stack([part[0], part[i], part[i + 1]]), order)
            points.append(ontriangle)
            weights.append(weight)
    return np.concatenate(points), np.concatenate(weights)


def _sphere(polar=120, azimuth=240):
    """Quadrature on the sphere, hemisphere by hemisphere."""
    nodes, weights = np.polynomial.legendre.leggauss(polar)
    z = np.concatenate([-0.5 - 0.5 * nodes, 0.5 + 0.5 * nodes])
    phi = (np.arange(azimuth) + 0.5) * 2 * np.pi / azimuth
    r = np.sqrt(1 - z * z)
    height = np.broadcast_to(z[:, None], (z.size, azimuth))
    points = np.stack([r[:, None] * np.cos(phi), r[:, None] * np.sin(phi), height], -1)
    return points.reshape(-1, 3), np.repeat(np.tile(0.5 * weights, 2) * 2 * np.pi / azimuth, azimuth)


@jax.jit
def _scattered(bsdf, wi, wo):
    wi = jnp.broadcast_to(wi, wo.shape)
    bsdf = jax.tree.map(lambda field: jnp.broadcast_to(field, (wo.shape[0], *field.shape)), bsdf)
    return bsdf.eval(wi, wo)[:, 0]


def radiance(values: dict, case: str) -> float:
    """Radiance of the point; `values` by name, of the camera its motion."""
    camera, _, _, sky = CASES[case]
    glass = values["glass.vertices"]
    x, y = unit(glass[1] - glass[0]), unit(glass[3] - glass[0])
    n = np.cross(x, y)
    frame = np.stack([x, np.cross(n, x), n])
    direction = -unit(camera)
    position = camera + values["camera.to_world"][:3, 3]
    point = position + (glass[0] - position) @ n / (direction @ n) * direction
    alpha, eta = (float(values[f"glass.bsdf.{name}"]) for name in ("alpha", "eta"))
    bsdf = jd.RoughDielectric(alpha, eta, 1.0, distribution="beckmann")
    wi = frame @ -direction

    def seen(corners):
        points, weights = _polygon(corners, (corners - point) @ n)
        offset = points - point
        squared = (offset**2).sum(-1)
        wo = offset / np.sqrt(squared)[:, None]
        normal = unit(np.cross(corners[1] - corners[0], corners[3] - corners[0]))
        return np.sum(weights * np.abs(wo @ normal) / squared * np.asarray(_scattered(bsdf, wi, wo @ frame.T)))

    plate, lamp = values["plate.vertices"], values["lamp.vertices"]
    if not sky:
        # Nothing else shines; a plate in the way is before the lamp with all of its outline.
        return LIGHT * (seen(lamp) - seen(plate))
    wo, weights = _sphere()
    return sky * (weights @ np.asarray(_scattered(bsdf, wi, wo)) - seen(plate))


def start(case: str) -> dict:
    """Values of all parameters in double precision."""
    _, plate, lamp, _ = CASES[case]
    return {
        "glass.vertices": SQUARE,
        "plate.vertices": plate,
        "lamp.vertices": lamp,
        "camera.to_world": np.zeros((4, 4)),
        "glass.bsdf.eta": np.array(ETA),
        "glass.bsdf.alpha": np.array(ALPHA),
    }


def exact(case: str, motions=tuple(MOTIONS), step=1e-4) -> tuple[float, dict[str, float]]:
    """Radiance and its derivatives by motion: central differences of the integral, in double precision."""
    with jax.enable_x64(True):
        values = start(case)

        def at(name, amount):
            parameter, velocity = MOTIONS[name]
            return radiance(values | {parameter: values[parameter] + amount * velocity(values[parameter])}, case)

        derivatives = {name: float((at(name, step) - at(name, -step)) / (2 * step)) for name in motions}
        return float(radiance(values, case)), derivatives


@partial(jax.jit, static_argnames=("boundary", "spp", "depth"))
def _estimate(of: jd.Scene, tangent, key, boundary, spp: int, depth: int):
    def mean(values):
        terms = jd.derivative_terms(of.replace(values), key, spp, jd.PathTracer(depth, boundary))
        return (terms["interior"] + terms["boundary"]).mean()

    return jax.jvp(mean, ({name: of.parameters()[name] for name in NAMES},), (tangent,))


def estimates(case: str, boundary, motions, keys: int = 8, spp: int = 16, depth: int = 2):
    """Radiance [keys] and its derivatives {motion: [keys]} for independent keys, without what the film's edges add."""
    of = scene(case)
    values = {name: np.asarray(of.parameters()[name]) for name in NAMES}
    radiance, derivatives = [], {name: [] for name in motions}
    for key in jax.random.split(jax.random.key(0), keys):
        for name in motions:
            parameter, velocity = MOTIONS[name]
            tangent = {other: np.zeros_like(value) for other, value in values.items()}
            tangent[parameter] = np.asarray(velocity(values[parameter]), values[parameter].dtype)
            value, derivative = jax.device_get(_estimate(of, tangent, key, boundary, spp, depth))
            derivatives[name].append(derivative)
        radiance.append(value)
    return np.array(radiance, float), {name: np.array(rows, float) for name, rows in derivatives.items()}
