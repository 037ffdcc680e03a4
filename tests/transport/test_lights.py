"""Lights without area: a floor point's radiance in closed form, in value and in every parameter of the light."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle
from jaxdr.scene.packed import pack
from jaxdr.transport.emission import emitter_shares, sample_emitter
from tests.transport.test_path import RGB, block_means, cluttered, image

AT = np.array([0.2, -0.1, 0.0])  # the floor point that the camera sees
POSITION, COLOUR = np.array([0.5, 0.4, 1.5]), np.array([3.0, 2.0, 1.0])
PICTURE = np.random.default_rng(0).uniform(0.5, 1.5, (3, 4, 3))
DOWN = jd.look_at(POSITION, [0, 0, 0], [0, 1, 0])


def smooth_angle(direction, position):
    offset = AT - position
    return np.arccos(offset @ direction / np.linalg.norm(offset) / np.linalg.norm(direction))


def falloff(position, intensity, direction, cutoff_angle, beam_width):
    angle = smooth_angle(direction, position)
    cutoff, beam = np.deg2rad([cutoff_angle, beam_width])
    return intensity * np.clip((cutoff - angle) / (cutoff - beam), 0, 1)


def irradiance(position, intensity):
    """On the floor."""
    offset = position - AT
    return intensity * offset[2] / np.linalg.norm(offset) ** 3


def projected(to_world, irradiance_, fov, scale):
    """On the floor: bilinear, 1 / (z^2 cos) on the axis' side, the floor's cosine."""
    height, width, _ = irradiance_.shape
    local = to_world[:3, :3].T @ (AT - to_world[:3, 3])
    focal = 0.5 * width / np.tan(np.deg2rad(fov) / 2)
    x, y = np.array([width, height]) / 2 - focal * local[:2] / local[2] - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    a, b = x - i, y - j
    value = (1 - b) * ((1 - a) * irradiance_[j, i] + a * irradiance_[j, i + 1])
    value = value + b * ((1 - a) * irradiance_[j + 1, i] + a * irradiance_[j + 1, i + 1])
    distance = np.linalg.norm(local)
    offset = to_world[:3, 3] - AT
    return np.pi * scale * value / (local[2] ** 2 * local[2] / distance) * offset[2] / distance


LIGHTS = {  # the light, and its irradiance on the floor from its parameters
    "point": (jd.PointLight(POSITION, COLOUR), irradiance),
    "spot": (
        jd.SpotLight(POSITION, [-0.3, -0.3, -1.0], COLOUR, 30.0, 2.0),
        lambda position, **rest: irradiance(position, falloff(position, **rest)),
    ),
    "beam": (
        jd.SpotLight(POSITION, AT - POSITION, COLOUR),
        lambda position, **rest: irradiance(position, falloff(position, **rest)),
    ),
    "directional": (
        jd.DirectionalLight([0.3, 0.2, -2.0], COLOUR),
        lambda direction, irradiance: -irradiance * direction[2] / np.linalg.norm(direction),
    ),
    "projector": (
        jd.Projector(PICTURE, DOWN, 50.0, 0.7),
        lambda to_world, irradiance, fov, scale: projected(to_world, irradiance, fov, scale),
    ),
}


def scene(light):
    camera = jd.Perspective(jd.look_at([1, -3, 2], AT, [0, 0, 1]), 1e-3, jd.Film(8, 8, jd.Box()))
    return jd.Scene({"floor": jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(RGB))}, camera, lights={"lamp": light})


@pytest.mark.parametrize("kind", LIGHTS)
def test_floor_point(kind):
    """Radiance, and derivatives in position, direction, intensity, angles, image and camera against the formula's."""
    light, formula = LIGHTS[kind]
    of = scene(light)
    values = {name[5:]: np.asarray(v, float) for name, v in of.parameters().items() if name.startswith("lamp.")}
    assert values

    def mean(values):
        replaced = of.replace({f"lamp.{name}": v for name, v in values.items()})
        return jd.render(replaced, jax.random.key(0), 1, jd.PathTracer(2, None)).mean((0, 1))

    at = jax.tree.map(lambda v: jnp.asarray(v, jnp.float32), values)
    found, jacobian = jax.jit(lambda v: (mean(v), jax.jacrev(mean)(v)))(at)
    np.testing.assert_allclose(found, RGB / np.pi * formula(**values), rtol=1e-4)
    scale = np.abs(found).max()
    for name, value in values.items():
        for index in np.ndindex(value.shape) if value.ndim < 3 else ((0, 1, 0), (1, 1, 1), (1, 2, 2)):
            step = np.zeros_like(value)
            step[index] = 1e-5
            above, below = (formula(**{**values, name: value + sign * step}) for sign in (1, -1))
            exact = RGB / np.pi * (above - below) / 2e-5
            np.testing.assert_allclose(jacobian[name][:, *index], exact, rtol=2e-3, atol=2e-4 * scale)


def test_nothing_beyond_the_cone_the_frustum_and_the_floor():
    aside = jd.look_at(POSITION, [1.5, 1.5, 0], [0, 1, 0])
    for light in (
        jd.SpotLight(POSITION, [1.0, 0.0, -1.0], COLOUR),
        jd.Projector(PICTURE, aside, 30.0),
        jd.Projector(PICTURE, jd.look_at(POSITION, 2 * POSITION - AT, [0, 1, 0]), 30.0),  # AT is behind it
        jd.PointLight(POSITION * [1, 1, -1], COLOUR),
        jd.DirectionalLight([0, 0, 1], COLOUR),
    ):
        assert np.all(image(scene(light), jax.random.key(0), 1, 2) == 0)


def all_emitters():
    room = cluttered()
    lights = {
        "a": jd.PointLight([-1, 0, 2], 0.5),
        "b": jd.PointLight([1, 1, 1], (0.0, 1.0, 0.0)),
        "off": jd.PointLight([1, -1, 1], 0.0),
        "spot": jd.SpotLight([0, -2, 2], [0, 1, -1], 3.0),
        "sun": jd.DirectionalLight([0.3, 0.2, -1.0], 0.7),
        "picture": jd.Projector(PICTURE, jd.look_at([-2, -2, 2], [0, 0, 0], [0, 0, 1]), 30.0),
        "other": jd.Projector(np.ones((2, 2, 3)), jd.look_at([2, 2, 2], [0, 0, 0], [0, 0, 1]), 20.0),
    }
    return jd.Scene(room.shapes, room.camera, room.environment, lights)


def test_every_emitter_is_chosen_as_often_as_its_share():
    packed = pack(all_emitters())
    shares = emitter_shares(packed)
    assert float(shares.environment + shares.surfaces + shares.lights.sum()) == pytest.approx(1, abs=1e-6)
    assert np.all(np.asarray(shares.lights) >= 0.0099)  # the one that is off, too
    count = 200_000
    sample = jax.jit(sample_emitter)(packed, jax.random.uniform(jax.random.key(1), (count, 2)))
    light = np.asarray(sample.light)
    np.testing.assert_allclose(np.bincount(light[light >= 0], minlength=7) / count, shares.lights, atol=0.005)
    environment = (light < 0) & np.asarray(sample.infinite)
    assert abs(environment.mean() - float(shares.environment)) < 0.005
    np.testing.assert_allclose(sample.pdf[environment], shares.environment / (4 * np.pi), rtol=1e-5)
    np.testing.assert_allclose(sample.pdf[light >= 0], np.asarray(shares.lights)[light[light >= 0]], rtol=1e-4)
    names = sorted(all_emitters().lights)
    place = {"b": [1, 1, 1], "spot": [0, -2, 2], "picture": [-2, -2, 2]}
    for name, position in place.items():
        found = np.asarray(sample.point.position)[light == names.index(name)]
        np.testing.assert_allclose(found, np.broadcast_to(position, found.shape))


def test_shares_follow_power():
    """A lamp twice as bright has twice the share, but for what is dealt evenly."""
    room = all_emitters()
    one = emitter_shares(pack(room)).lights
    two = emitter_shares(pack(room.replace({"a.intensity": 1.0 * jnp.ones(3)}))).lights
    names = sorted(room.lights)
    a, b = names.index("a"), names.index("b")
    even = 0.1 / 9
    ratio = (two[a] - even) / (two[b] - even) / ((one[a] - even) / (one[b] - even))
    assert float(ratio) == pytest.approx(2, rel=1e-3)
    dark = room.replace({name: jnp.zeros_like(v) for name, v in room.parameters().items() if "intensity" in name})
    assert np.all(np.isfinite(emitter_shares(pack(dark)).lights))


@pytest.mark.slow
def test_emitters_add_up():
    """An image with all emitters is the sum of the images with each of them."""
    room = all_emitters()
    parts = [jd.Scene(room.shapes, room.camera, None, {name: light}) for name, light in room.lights.items()]
    black = {n: jd.Shape(s.mesh, s.bsdf) for n, s in room.shapes.items()}
    parts = [jd.Scene(black, room.camera, None, scene.lights) for scene in parts]
    parts.append(jd.Scene(black, room.camera, room.environment))
    parts.append(jd.Scene(room.shapes, room.camera))
    whole, error = block_means(room, jax.random.key(2), 64, 2, "mis", keys=8)
    each = [block_means(part, jax.random.key(3), 64, 2, "mis", keys=8) for part in parts]
    together = sum(mean for mean, _ in each)
    error = np.sqrt(error**2 + sum(e**2 for _, e in each))
    assert np.all(error < 0.02 * whole.mean()), error / whole.mean()
    assert np.max(np.abs(whole - together) / error) < 6


def test_ids_and_arguments():
    room = scene(LIGHTS["point"][0])
    lamp = room.lights["lamp"]
    for lights, message in (
        ({"floor": lamp}, "'floor' is the id of a shape and of a light"),
        ({"camera": lamp}, "'camera' can't be a light id"),
        ({"a.b": lamp}, "'a.b' can't be a light id"),
        ({"lamp": room.shapes["floor"]}, "lights\\['lamp'\\] is a Shape, expected a jaxdr.DeltaLight"),
    ):
        with pytest.raises(ValueError, match=f"Scene: {message}"):
            jd.Scene(room.shapes, room.camera, lights=lights)
    for make, message in (
        (lambda: jd.PointLight([0, 0]), "PointLight: position must be three numbers"),
        (lambda: jd.PointLight([0, 0, 0], [1, 2]), "PointLight: intensity"),
        (lambda: jd.SpotLight([0, 0, 0], [0, 0, 0]), "SpotLight: direction must not be zero"),
        (lambda: jd.SpotLight([0, 0, 0], [0, 0, 1], 1.0, 20.0, 20.0), "beam_width < cutoff_angle"),
        (lambda: jd.DirectionalLight([0, 0, 0]), "DirectionalLight: direction must not be zero"),
        (lambda: jd.SpotLight([0, 0, 0], [0, 1e25, 0]), "SpotLight: direction must not be zero, nor of an extreme"),
        (lambda: jd.DirectionalLight([0, 0, 1e-25]), "DirectionalLight: direction must not be zero, nor of an extreme"),
        (lambda: jd.TexturedSpotLight([0, 0, 0], [0, 0, 1], np.ones((0, 2, 3)), [0, 1, 0]), "must be an RGB image"),
        (lambda: jd.Projector(np.ones((2, 2)), np.eye(4), 30.0), "Projector: irradiance must be an RGB image"),
        (lambda: jd.Projector(np.ones((0, 2, 3)), np.eye(4), 30.0), "Projector: irradiance must be an RGB image"),
        (lambda: jd.Projector(PICTURE, np.diag([2.0, 2, 2, 1]), 30.0), "Projector: to_world must not scale"),
        (lambda: jd.Projector(PICTURE, np.diag([1.0, 2, 1, 1]), 30.0), "Projector: to_world may rotate"),
        (lambda: jd.Projector(PICTURE, np.diag([0.0, 0, 0, 1]), 30.0), "Projector: to_world can't be inverted"),
        (lambda: jd.Projector(PICTURE, np.eye(3), 30.0), "Projector: to_world"),
        (lambda: jd.Projector(PICTURE, np.eye(4), 30.0, fov_axis="up"), "fov_axis must be one of x, y"),
    ):
        with pytest.raises(ValueError, match=message):
            make()
    assert set(room.parameters()) >= {"lamp.position", "lamp.intensity"}
