"""Antithetic pairs at narrow lobes: mirror images, and derivatives against quadrature in double precision.

One point x of a wall is lit by way of a floor with a narrow lobe. Nothing hides anything, so that the interior term is
all of the derivative, and that of an integral over floor and lamp.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.packed import pack
from jaxdr.transport import mirrored_pairs
from jaxdr.transport.interaction import material_point
from jaxdr.transport.mirrored_pairs import Ends
from jaxdr.transport.path import trace_paths
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples

WALL_AT, WALL_NORMAL = np.array([0.1, -0.6, 0.7]), np.array([0.0, 0.8, -0.6])
LAMP_AT, LAMP_SIDE, LAMP_NORMAL = np.array([-0.1, 0.6, 0.4]), 0.2, np.array([0.0, 0.0, -1.0])
RADIANCE, INTENSITY, ALBEDO, ALPHA = 20.0, 1.0, 0.5, 0.1
SPP, SIZE, KEYS = 16, 32, 32
MOTIONS = [(shape, axis) for shape in ("floor", "lamp") for axis in range(3)] + [("floor", "turn")]


def quad(center, normal, side):
    across = np.array([1.0, 0.0, 0.0])
    up = np.cross(normal, across)
    corners = [center + 0.5 * side * (a * across + b * up) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return jd.Mesh(np.array(corners), [[0, 1, 2], [0, 2, 3]])


def scene(kind: str, alpha: float = ALPHA) -> jd.Scene:
    """Lit by a lamp or by a light without area, which shines on the wall, too."""
    shapes = {
        "floor": jd.Shape(quad(np.zeros(3), np.array([0.0, 0.0, 1.0]), 2.0), jd.RoughConductor(alpha)),
        "wall": jd.Shape(quad(WALL_AT, WALL_NORMAL, 0.05), jd.Diffuse(ALBEDO)),
    }
    lights = {}
    if kind == "point":
        lights = {"lamp": jd.PointLight(LAMP_AT, INTENSITY)}
    else:
        shapes["lamp"] = jd.Shape(quad(LAMP_AT, LAMP_NORMAL, LAMP_SIDE), jd.Diffuse(0.0), jd.AreaEmitter(RADIANCE))
    pose = jd.look_at(WALL_AT + 0.5 * WALL_NORMAL, WALL_AT, [1, 0, 0])
    return jd.Scene(shapes, jd.Perspective(pose, 0.01, jd.Film(SIZE, SIZE, jd.Box())), lights=lights)


def moved(of: jd.Scene, amounts):
    """Shapes moved along the axes, the floor turned about x through its middle."""
    shifts, turn = amounts
    values = {}
    for name, shift in shifts.items():
        parameter = "lamp.position" if name == "lamp" and of.lights else f"{name}.vertices"
        values[parameter] = of.parameters()[parameter] + shift
    floor = values["floor.vertices"]
    values["floor.vertices"] = floor + turn * jnp.cross(jnp.array([1.0, 0.0, 0.0]), floor)
    return of.replace(values)


@partial(jax.jit, static_argnames="pairs")
def estimate(of: jd.Scene, key, pairs: bool):
    """(radiance of the point, its derivatives by motion)."""
    film, path = jax.random.split(key)
    settings = PathSettings(3, True, "auto", pairs=pairs)

    def radiance(amounts):
        packed = pack(moved(of, amounts))
        primary = primary_samples(packed, jnp.arange(SPP), film, settings.rays, Form.FIXED)
        start = primary.first, primary.direction, primary.u
        record = trace_paths(packed, *start, path, settings, primary.near)
        return record.radiance.mean()

    start = {"floor": jnp.zeros(3), "lamp": jnp.zeros(3)}, jnp.zeros(())
    value, (shifts, turn) = jax.value_and_grad(radiance)(start)
    return value, jnp.concatenate([shifts["floor"], shifts["lamp"], turn[None]])


def estimates(of: jd.Scene, pairs: bool):
    rows = [estimate(of, key, pairs) for key in jax.random.split(jax.random.key(3), KEYS)]
    return np.array([row[0] for row in rows], float), np.array([row[1] for row in rows], float)


def gauss(count: int, side: float):
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return 0.5 * side * nodes, 0.5 * side * weights


def exact(kind: str, shifts, turn: float) -> float:
    """Radiance of the point: GGX of perfect mirrors (Walter et al. 2007, Eq. 20, 33, 34) on a grid of the floor."""
    grid, weight = gauss(160, 2.0)
    u, v = (t.ravel() for t in np.meshgrid(grid, grid, indexing="ij"))
    area = np.outer(weight, weight).ravel()
    across, up, normal = np.array([1.0, 0, 0]), np.array([0, 1, turn]), np.array([0, -turn, 1])
    area, normal = area * np.linalg.norm(up), normal / np.linalg.norm(normal)
    y = shifts["floor"] + u[:, None] * across + v[:, None] * up
    to_x = WALL_AT - y
    squared = (to_x**2).sum(-1)
    to_x = to_x / np.sqrt(squared)[:, None]
    arriving = ALBEDO / np.pi * np.maximum(-to_x @ WALL_NORMAL, 0) * np.maximum(to_x @ normal, 0) / squared
    total, lamp = 0.0, LAMP_AT + shifts["lamp"]
    if kind == "point":
        direct = lamp - WALL_AT
        cosine = max(direct @ WALL_NORMAL, 0.0) / np.linalg.norm(direct)
        total = ALBEDO / np.pi * INTENSITY * cosine / (direct @ direct)
        points, powers = lamp[None], [INTENSITY]
    else:
        nodes, weights = gauss(8, LAMP_SIDE)
        a, b = (t.ravel() for t in np.meshgrid(nodes, nodes, indexing="ij"))
        points = lamp + a[:, None] * across + b[:, None] * np.cross(LAMP_NORMAL, across)
        powers = RADIANCE * np.outer(weights, weights).ravel()
    for z, power in zip(points, powers, strict=True):
        to_z = z - y
        far = (to_z**2).sum(-1)
        to_z = to_z / np.sqrt(far)[:, None]
        emitted = power * (1.0 if kind == "point" else np.maximum(-to_z @ LAMP_NORMAL, 0)) / far
        half = to_x + to_z
        cosine = (half @ normal) / np.linalg.norm(half, axis=-1)
        facets = ALPHA**2 / (np.pi * (cosine**2 * (ALPHA**2 - 1) + 1) ** 2)
        shadowing = 1.0
        for w in (to_x, to_z):
            shadowing = shadowing * 2 / (1 + np.sqrt(1 + ALPHA**2 * (1 / (w @ normal) ** 2 - 1)))
        total += np.sum(area * arriving * facets * shadowing / (4 * (to_x @ normal)) * emitted)
    return total


def exact_derivatives(kind: str, step: float = 1e-5) -> np.ndarray:
    found = []
    for name, axis in MOTIONS:
        ends = []
        for sign in (step, -step):
            shifts, turn = {"floor": np.zeros(3), "lamp": np.zeros(3)}, 0.0
            if axis == "turn":
                turn = sign
            else:
                shifts[name][axis] = sign
            ends.append(exact(kind, shifts, turn))
        found.append((ends[0] - ends[1]) / (2 * step))
    return np.array(found)


@pytest.mark.parametrize("kind", ["lamp", "point"])
def test_derivatives_are_those_of_the_integral(kind):
    of, truth = scene(kind), exact_derivatives(kind)
    values, rows = estimates(of, pairs=True)
    value = exact(kind, {"floor": np.zeros(3), "lamp": np.zeros(3)}, 0.0)
    assert abs(values.mean() - value) < 4 * values.std(ddof=1) / np.sqrt(KEYS)
    error = rows.std(0, ddof=1) / np.sqrt(KEYS)
    assert np.all(error < 0.03 * np.abs(truth).max()), error / np.abs(truth).max()
    assert np.all(np.abs(rows.mean(0) - truth) < 4.5 * error), (rows.mean(0), error, truth)


def test_values_stay_and_noise_falls():
    of = scene("lamp")
    (values, alone), (same, pairs) = (estimates(of, pairs) for pairs in (False, True))
    np.testing.assert_allclose(same, values, rtol=1e-5)
    assert np.all(pairs.std(0)[:2] < 0.5 * alone.std(0)[:2]), (pairs.std(0), alone.std(0))


def test_wide_lobes_have_no_pairs():
    of = scene("lamp", alpha=0.3)
    (_, alone), (_, pairs) = (estimates(of, pairs) for pairs in (False, True))
    np.testing.assert_allclose(pairs, alone, rtol=1e-3, atol=1e-5 * np.abs(alone).max())


def test_the_mirror_image_of_the_mirror_image_is_the_point():
    packed = pack(scene("lamp"))
    n = 64
    key = jax.random.key(0)
    x = jax.random.normal(key, (n, 3)) + jnp.array([0.0, 0.0, 4.0])
    weights = jax.random.dirichlet(key, jnp.ones(3), (n,))
    y = material_point(packed, jnp.zeros(n, jnp.int32), weights, jnp.ones(n, bool))
    z = material_point(packed, jnp.full(n, packed.faces.shape[0] - 1), weights[::-1], jnp.ones(n, bool))
    z = z._replace(position=z.position + jnp.array([0.0, 0.0, 5.0]))
    far = jnp.arange(n) % 2 == 0
    ends = Ends(z, far, jnp.broadcast_to(jnp.array([0.36, 0.48, 0.8]), (n, 3)), far, far, None)
    image, opposite = mirrored_pairs._mirrored(x, y, ends)
    again, _ = mirrored_pairs._mirrored(x, y._replace(position=image), ends)
    assert opposite.all()
    np.testing.assert_allclose(again, y.position, atol=2e-5)
    # In the middle between both, a mirror shows the emitter.
    middle = 0.5 * (image + y.position)
    from_x = np.asarray((x - middle) / jnp.linalg.norm(x - middle, axis=-1, keepdims=True))
    to_z = np.where(far[:, None], ends.direction, z.position - middle)
    to_z = to_z / np.linalg.norm(to_z, axis=-1, keepdims=True)
    np.testing.assert_allclose(from_x * [-1, -1, 1], to_z, atol=1e-5)
