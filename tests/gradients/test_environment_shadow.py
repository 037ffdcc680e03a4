"""A floor point under an environment map behind a rectangle, one of which moves: line integrals and quadrature."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.gradients.floor_point import POINT, REFLECTANCE
from tests.gradients.floor_point import scene as floor_scene
from tests.scene.test_environment_map import TURN, expected
from tests.transport.test_environment import AXES, generator, upper_directions

HEIGHT, LOW, HIGH = 0.6, np.array([-0.3, -0.4]), np.array([0.5, 0.3])
SUN = 300.0  # times the radiance elsewhere, in one texel


def sky(size, sun):
    """A map whose sun shines past a side of the rectangle on the point."""
    height, width = size
    image = 1.0 + np.random.default_rng(3).uniform(0, 1, (height, width, 3))
    image[[0, -1]] = 1.0
    d = np.array([HIGH[0] + 0.02, -0.1, HEIGHT]) @ TURN[:3, :3]
    d /= np.linalg.norm(d)
    row = round(np.arccos(d[1]) / np.pi * (height - 1))
    image[row, round(np.arctan2(d[0], -d[2]) / (2 * np.pi) * width - 0.5) % width] = sun
    return image


def scene(image):
    x0, y0, x1, y1 = *LOW, *HIGH
    corners = np.array([[x0, y0, HEIGHT], [x1, y0, HEIGHT], [x1, y1, HEIGHT], [x0, y1, HEIGHT]])
    of = floor_scene(jd.Mesh(corners, [[0, 1, 2], [0, 2, 3]]))
    return jd.Scene({n: of.shapes[n] for n in ("blocker", "floor")}, of.camera, jd.EnvironmentMap(image, TURN))


def exact(image, nodes=20_000):
    """Derivatives of the radiance by translations in x and y: what a side uncovers less what the other covers."""
    result = []
    for axis in (0, 1):
        other = 1 - axis
        s = (np.arange(nodes) + 0.5) / nodes * (HIGH - LOW)[other] + LOW[other]
        total = 0.0
        for side, sign in ((LOW, 1.0), (HIGH, -1.0)):
            d = np.full((nodes, 3), HEIGHT)
            d[:, axis], d[:, other] = side[axis], s
            weight = HEIGHT**2 / (d**2).sum(1) ** 2 * (HIGH - LOW)[other] / nodes
            total = total + sign * weight @ expected(image, TURN, d - POINT)
        result.append(total)
    return REFLECTANCE / np.pi * np.array(result)


@partial(jax.jit, static_argnames=("boundary", "spp"))
def derivatives(of, key, boundary, spp):
    vertices = of.parameters()["blocker.vertices"]

    def mean(shift):
        moved = of.replace({"blocker.vertices": vertices + jnp.append(shift, 0.0)})
        return jd.render(moved, key, spp, jd.PathTracer(2, boundary)).mean((0, 1))

    return jax.jacfwd(mean)(jnp.zeros(2)).T


def visible_radiance(image, to_world):
    """Of the floor point: what the whole sky sends less what comes from behind the rectangle."""
    x, y = (LOW[k] + (np.arange(400) + 0.5) / 400 * (HIGH - LOW)[k] for k in (0, 1))
    d = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((400, 400), HEIGHT)], -1).reshape(-1, 3)
    weight = HEIGHT**2 / (d**2).sum(1) ** 2 * np.prod(HIGH - LOW) / 400**2
    whole, sky_weight = upper_directions(800, 1600)
    hidden = weight @ expected(image, to_world, d)
    return REFLECTANCE / np.pi * (sky_weight @ expected(image, to_world, whole) - hidden)


@partial(jax.jit, static_argnames=("boundary", "spp", "sampling"))
def turned_derivatives(of, key, tangents, boundary, spp, sampling="mis"):
    to_world = of.parameters()["environment.to_world"]

    def mean(turns):
        turned = of.replace({"environment.to_world": to_world + jnp.tensordot(turns, tangents, 1)})
        return jd.render(turned, key, spp, jd.PathTracer(2, boundary, sampling=sampling)).mean((0, 1))

    return jax.jacfwd(mean)(jnp.zeros(len(tangents))).T


SKEW = np.pad([[0.2, 0.5, 0.0], [0.3, -0.4, 0.1], [0.0, 0.1, 0.3]], ((0, 1), (0, 1)))


@pytest.mark.parametrize(
    "boundary, error_bound",
    [
        pytest.param(None, 0.05, id="none", marks=pytest.mark.slow),
        pytest.param(jd.KernelDensity(0.02), 0.03, id="kernel", marks=pytest.mark.slow),
        pytest.param(jd.LineSampling(), 0.01, id="lines"),
    ],
)
def test_turning_map_behind_a_rectangle(boundary, error_bound):
    """Rotations, and a change of the matrix that is none. Without boundary terms the look-up's slope is sampled."""
    image = sky((16, 32), SUN)
    tangents = np.stack([generator(axis) @ TURN for axis in AXES.values()] + [SKEW @ TURN])

    def central(tangent, step=1e-3):
        turns = [np.eye(4) + sign * step * (tangent @ np.linalg.inv(TURN)) for sign in (1, -1)]
        if np.allclose(tangent, tangents[-1]):  # the look-up takes the transpose for the inverse
            turns = [np.linalg.inv(turn).T for turn in turns]
        one, two = (visible_radiance(image, turn @ TURN) for turn in turns)
        return (one - two) / (2 * step)

    truth = np.stack([central(tangent) for tangent in tangents])
    scale = np.abs(truth).max()
    keys = jax.random.split(jax.random.key(6), 16)
    tangents = jnp.asarray(tangents, jnp.float32)
    rows = np.array([turned_derivatives(scene(image), key, tangents, boundary, 64) for key in keys]) / scale
    mean, error = rows.mean(0), rows.std(0, ddof=1) / 4
    assert np.all(error < error_bound), error
    assert np.all(np.abs(mean - truth / scale) < 4.5 * error + 0.005), (mean, error, truth / scale)


CASES = {  # size of the map, its sun, boundary, the bias allowed for: a strip in a plane for one on the sphere
    "even sky, kernel": ((16, 32), 1.0, jd.KernelDensity(0.1), 0.01),
    "sun, kernel": ((16, 32), SUN, jd.KernelDensity(0.02), 0.005),
    "small sun, wide kernel": ((64, 128), 20 * SUN, jd.KernelDensity(0.1, capacity=1.0), 0.01),
    "sun, lines": ((16, 32), SUN, jd.LineSampling(), 0.001),
    "small sun, lines": ((64, 128), 20 * SUN, jd.LineSampling(), 0.001),
}
QUICK = ("sun, lines",)


@pytest.mark.parametrize("case", [pytest.param(c, marks=() if c in QUICK else pytest.mark.slow) for c in CASES])
def test_shadow_of_a_rectangle(case):
    size, sun, boundary, bias = CASES[case]
    image = sky(size, sun)
    truth = exact(image)
    scale = np.abs(truth).max()
    keys = jax.random.split(jax.random.key(5), 16)
    rows = np.array([jax.device_get(derivatives(scene(image), key, boundary, 64)) for key in keys]) / scale
    mean, error = rows.mean(0), rows.std(0, ddof=1) / 4
    assert np.all(error < 0.03), error
    assert np.all(np.abs(mean - truth / scale) < 4.5 * error + bias), (mean, error, truth / scale)
