"""Light of environment maps: a floor point's irradiance by quadrature, in value and in every parameter of the map."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere
from tests.scene.bsdf.checks import direction
from tests.scene.test_environment_map import TURN, expected, pixels

RGB = np.array([0.2, 0.5, 0.8])
AXES = {"x": np.array([1.0, 0.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


@cache
def upper_directions(rows=300, columns=600):
    """(directions above the floor, cosine times solid angle of their cells)."""
    theta = (np.arange(rows) + 0.5) / rows * np.pi / 2
    phi = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    area = 2 * np.sin(theta) * np.sin(np.pi / 4 / rows) * 2 * np.pi / columns
    weight = np.repeat(area * np.cos(theta), columns)
    return direction(*np.meshgrid(theta, phi, indexing="ij")).reshape(-1, 3), weight


def irradiance(image, to_world):
    directions, weight = upper_directions()
    return weight @ expected(image, to_world, directions)


def floor_scene(sky, bsdf=None):
    floor = jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(RGB) if bsdf is None else bsdf)
    camera = jd.Perspective(jd.look_at([1, -3, 2], [0, 0, 0], [0, 0, 1]), 0.02, jd.Film(16, 16, jd.Box()))
    return jd.Scene({"floor": floor}, camera, sky)


@partial(jax.jit, static_argnames="sampling")
def values_and_jacobians(scene, tangents, key, sampling):
    """Mean of the image, its derivative by every texel, and along tangents of `to_world`."""
    integrator = jd.PathTracer(2, None, sampling=sampling)

    def mean(parameters):
        return jd.render(scene.replace(parameters), key, 64, integrator).mean((0, 1))

    at = {name: scene.parameters()[f"environment.{name}"] for name in ("radiance", "to_world", "scale")}
    value, pull = jax.vjp(lambda p: mean({f"environment.{n}": v for n, v in p.items()}), at)
    pulled = jax.vmap(pull)(jnp.eye(3))[0]
    pushed = [(pulled["to_world"] * t).sum((-2, -1)) for t in tangents]
    return value, pulled["radiance"], jnp.stack(pushed), pulled["scale"]


def generator(axis):
    """Derivative of a turn about the axis."""
    return np.pad(np.cross(axis, np.eye(3)).T, ((0, 1), (0, 1)))


@pytest.mark.parametrize("sampling", ["mis", pytest.param("emitter", marks=pytest.mark.slow)])
def test_floor_under_a_map(sampling):
    image, scale = pixels("even", 20.0), 0.5
    tangents = [generator(axis) @ TURN for axis in AXES.values()]
    scene = floor_scene(jd.EnvironmentMap(image, TURN, scale))
    rows = [
        jax.device_get(values_and_jacobians(scene, jnp.asarray(tangents, jnp.float32), key, sampling))
        for key in jax.random.split(jax.random.key(0), 16)
    ]
    whole = RGB / np.pi * irradiance(image, TURN)
    lights = np.zeros((*image.shape[:2], *image.shape[:2]))
    lights[np.arange(8)[:, None], np.arange(16), np.arange(8)[:, None], np.arange(16)] = 1.0
    lights = np.moveaxis(lights.reshape(128, *image.shape[:2]), 0, -1)
    texels = (upper_directions()[1] @ expected(lights, TURN, upper_directions()[0])).reshape(8, 16)
    turned = []
    for axis in AXES.values():
        steps = [np.eye(4), np.eye(4)]
        for step, sign in zip(steps, (1, -1), strict=True):
            step[:3, :3] = Rotation.from_rotvec(sign * 1e-3 * axis).as_matrix()
        turned.append((irradiance(image, steps[0] @ TURN) - irradiance(image, steps[1] @ TURN)) / 2e-3)
    truth = (
        scale * whole,
        scale / np.pi * np.einsum("c,hw,cd->chwd", RGB, texels, np.eye(3)),
        scale * RGB / np.pi * np.array(turned),
        whole,
    )
    precision = (0.005, 0.05, 0.1, 0.005)
    for found, exact, share in zip(zip(*rows, strict=True), truth, precision, strict=True):
        mean, error = np.mean(found, 0), np.std(found, 0, ddof=1) / 4
        assert mean.shape == exact.shape
        assert np.all(error < share * np.abs(exact).max()), error.max() / np.abs(exact).max()
        assert np.all(np.abs(mean - exact) < 5 * error + 5e-4 * np.abs(exact).max())


@partial(jax.jit, static_argnames=("spp", "depth"))
def picture(scene, key, spp, depth=2):
    return jd.render(scene, key, spp, jd.PathTracer(depth, None))


def ball_scene(sky):
    shapes = {"ball": jd.Shape(sphere(2), jd.Diffuse(RGB)), "floor": jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(0.5))}
    camera = jd.Perspective(jd.look_at([1, -4, 2], [0, 0, 0], [0, 0, 1]), 60.0, jd.Film(8, 8))
    return jd.Scene(shapes, camera, sky)


def pictures(sky, spp, keys=8):
    scene = ball_scene(sky)
    stack = np.stack([picture(scene, key, spp) for key in jax.random.split(jax.random.key(3), keys)])
    blocks = stack.reshape(keys, 4, 2, 4, 2, 3).mean((2, 4)).reshape(keys, -1)
    return blocks.mean(0), blocks.std(0, ddof=1) / np.sqrt(keys)


def test_a_map_of_one_colour_is_the_constant_environment():
    colour = np.array([1.0, 0.5, 2.0])
    (a, da), (b, db) = (
        pictures(jd.EnvironmentMap(np.tile(colour, (6, 8, 1))), 64),
        pictures(jd.ConstantEnvironment(colour), 64),
    )
    error = np.hypot(da, db)
    assert error.max() < 0.02
    assert np.max(np.abs(a - b) / (error + 1e-5)) < 6  # 8 keys


def test_quarter_turn_of_a_map_is_a_quarter_of_its_columns():
    image = pixels("even", 10.0)
    quarter = np.eye(4)
    quarter[:3, :3] = Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    # Turned about +y from +z towards +x: what was at column i, u = i / 16, is a quarter to the left.
    a = picture(ball_scene(jd.EnvironmentMap(image, TURN @ quarter)), jax.random.key(4), 1, 1)
    b = picture(ball_scene(jd.EnvironmentMap(np.roll(image, -4, axis=1), TURN)), jax.random.key(4), 1, 1)
    assert np.ptp(a) > 0.1
    np.testing.assert_allclose(a, b, atol=2e-5)
