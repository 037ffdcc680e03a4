"""Bidirectional path tracing: every strategy by itself, their weights, the path tracer's image, and derivatives."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle
from jaxdr.scene.packed import pack
from jaxdr.scene.splat import splat
from jaxdr.transport.bidirectional import BidirectionalSettings, strategies
from jaxdr.transport.connections import Ends, found_emission, with_camera, with_each_other, with_emitters
from jaxdr.transport.emission import sample_emitter
from jaxdr.transport.interaction import material_point
from jaxdr.transport.primary import primary_samples
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.subpaths import camera_start, extend, light_start, trace_on
from tests.references.polygon_shadow import irradiance
from tests.transport.bidirectional_scenes import LIGHTS, SKY, UP, ball, camera, floor, lamp, room, scenes, textured_lamp

RGB = np.array([0.2, 0.5, 0.8])


@partial(jax.jit, static_argnames=("spp", "integrator"))
def images(scene, keys, spp, integrator):
    return jax.lax.map(lambda key: jd.render(scene, key, spp=spp, integrator=integrator), keys)


@partial(jax.jit, static_argnames=("count", "depth"))
def strategy_images(scene, key, count, depth):
    """Images by each strategy alone, unweighted, [C, H, W, 3], from `count` pairs of subpaths a pixel."""
    packed, film = pack(scene), scene.camera.film
    width, height = film.width, film.height
    keys = jax.random.split(key, 3)
    primary = primary_samples(packed, jnp.arange(count), keys[0], "warp", "fixed")
    u = uniform(keys[1], (width * height * count, 4))
    found = strategies(packed, primary, u, keys[2], BidirectionalSettings(depth, 1, "warp"))
    seen = found.film_points.shape[0]
    own = found.value[:-seen].reshape(-1, height, width, count, 3).mean(3)
    spread = jax.vmap(lambda points, values: splat(film, points, values))(
        found.film_points, found.value[-seen:] / count
    )
    return jnp.concatenate([own, spread])


@cache
def names(area: bool, depth: int):
    """(s, t) in the order of `strategies`."""
    met = [(0, t) for t in range(2, depth + 2)] if area else []
    each = [(j + 2, i + 2) for i in range(depth - 1) for j in range(depth - 2 - i)]
    return [*met, *((1, t) for t in range(2, depth + 1)), *each, *((s, 1) for s in range(2, depth + 1))]


def z_scores(a, b):
    """Differences of means over the first axis over their standard errors, and the latter over the mean of `a`."""
    error = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
    difference = a.mean(0) - b.mean(0)
    return np.where(error > 0, difference / np.where(error > 0, error, 1.0), 0.0), error / np.abs(a).mean()


def straight_down(size=4):
    """One by one, from below the lamp."""
    matrix = jd.look_at([0.3, 0.2, 1.5], [0.3, 0.2, 0.0], [0, 1, 0]) @ np.diag([0.5, 0.5, 1.0, 1.0])
    return jd.Orthographic(matrix, jd.Film(size, size, jd.Box()))


def floor_points(size=4, each=16):
    """Points of the floor that the pixels of `straight_down` see, [size, size, each², 3]."""
    steps = (np.arange(size * each) + 0.5) / (size * each) - 0.5
    x, y = np.meshgrid(0.3 + steps, 0.2 - steps)
    points = np.stack([x, y, np.zeros_like(x)], -1).reshape(size, each, size, each, 3)
    return points.transpose(0, 2, 1, 3, 4).reshape(size, size, -1, 3)


def point_irradiance(x):
    offset = np.array([0.8, -0.5, 1.5]) - x
    return np.array([1.5, 1.0, 0.5]) * (offset[..., 2] / np.linalg.norm(offset, axis=-1) ** 3)[..., None]


SQUARE = np.array([[-0.2, -0.3, 1.9], [-0.2, 0.3, 1.9], [0.4, 0.3, 1.9], [0.4, -0.3, 1.9]])


@pytest.mark.parametrize("kind", ["point", "area", "sky", "far"])
def test_floor_seen_by_each_strategy(kind):
    """Direct light in closed form from light subpaths alone, (2, 1), from emitter samples and from what rays meet."""
    shapes = {"floor": jd.Shape(rectangle(4.0, 4.0), jd.Diffuse(RGB))}
    lights, sky, area = {}, None, kind in ("area", "sky")
    if kind == "area":
        shapes["lamp"] = lamp()
        x = floor_points(each=2)
        exact = np.array([8.0 * irradiance(p, UP, SQUARE) for p in x.reshape(-1, 3)]).reshape(4, 4, -1, 1)
    elif kind == "sky":
        sky, exact = jd.ConstantEnvironment(1.5), np.full((4, 4, 1, 1), 1.5 * np.pi)
    elif kind == "point":
        lights, exact = {"point": LIGHTS["point"]}, point_irradiance(floor_points())
    else:
        lights, exact = {"far": LIGHTS["far"]}, np.full((4, 4, 1, 1), 0.7 / np.sqrt(1 + 0.16 + 0.25))
    exact = RGB / np.pi * exact.mean(2)
    scene = jd.Scene(shapes, straight_down(), sky, lights)
    found = np.stack([strategy_images(scene, key, 4096, 2) for key in jax.random.split(jax.random.key(1), 8)])
    for number, name in enumerate(names(area, 2)):
        if sum(name) == 3:
            ratio = found[:, number] / exact
            for values in (ratio, ratio.mean((1, 2, 3))):
                mean, error = values.mean(0), values.std(0, ddof=1) / np.sqrt(8)
                assert error.max() < (0.1 if values is ratio else 0.015), name
                assert np.abs(mean - 1.0).max() < 5 * error.max() + 5e-4, (name, mean)


EMITTERS = {
    "sky": ({}, SKY, {}),
    "textured": ({"lamp": textured_lamp()}, None, {}),
    "spot": ({}, None, {"spot": LIGHTS["spot"]}),
    "projector": ({}, None, {"slides": LIGHTS["slides"]}),
}


@pytest.mark.parametrize("kind", EMITTERS)
def test_direct_light_by_all_strategies(kind):
    """Pixel by pixel, unweighted, on a floor with a ball of rough glass."""
    extra, sky, lights = EMITTERS[kind]
    scene = jd.Scene(floor() | ball(jd.RoughDielectric(0.5, 1.5)) | extra, camera(4), sky, lights)
    area = bool(extra) or sky is not None
    found = np.stack([strategy_images(scene, key, 2048, 2) for key in jax.random.split(jax.random.key(2), 12)])
    by_name = dict(zip(names(area, 2), found.swapaxes(0, 1), strict=True))
    for name in [(2, 1)] + ([(0, 3)] if kind == "textured" else []):
        z, error = z_scores(by_name[1, 2].mean(-1), by_name[name].mean(-1))
        assert error.mean() < 0.02
        assert np.abs(z).max() < 5.0, (name, z)


def test_paths_of_one_length_by_all_strategies():
    """Mean over the image, unweighted: (0, 5), (1, 4), (2, 3), (3, 2), (4, 1) and the shorter ones."""
    scene = jd.Scene(room() | ball(jd.RoughDielectric(0.6, 1.5)) | {"lamp": lamp(size=1.5)}, camera(4))
    found = np.stack([strategy_images(scene, key, 2048, 4) for key in jax.random.split(jax.random.key(3), 16)])
    means = dict(zip(names(True, 4), found.mean((2, 3, 4)).T, strict=True))
    for length in (2, 3, 4):
        every = {name: value for name, value in means.items() if sum(name) == length + 1}
        assert len(every) == length + 1
        one = every.pop((1, length))
        for name, other in every.items():
            z, error = z_scores(one, other)
            assert error < 0.05 and np.abs(z) < 4.5, (name, one.mean(), other.mean(), z)


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("kind", ["area", "sky"])
def test_weights_add_up_to_one(kind, power):
    """Those of the five strategies that find one path of four segments."""
    bodies = floor() | ball(jd.RoughDielectric(0.6, 1.5))
    scene = jd.Scene(room() | bodies | {"lamp": lamp(size=1.5)}, camera()) if kind == "area" else None
    scene = scene or jd.Scene(bodies, camera(), SKY)
    with jax.enable_x64(True):
        scene = jax.tree.map(lambda x: jnp.asarray(x, float) if jnp.issubdtype(x.dtype, jnp.floating) else x, scene)
        total, count = _sum_of_weights(scene, power)
    assert count > 300
    np.testing.assert_allclose(total, 1.0, rtol=1e-6)


def _sum_of_weights(scene, power):
    packed, keys = pack(scene), jax.random.split(jax.random.key(4), 4)
    primary = primary_samples(packed, jnp.arange(64), keys[0], "warp", "fixed")
    paths = primary.u.shape[0]
    u = jnp.asarray(uniform(keys[1], (paths, 4), float))
    sample = sample_emitter(packed, u[:, :2])
    z1 = camera_start(packed, primary)
    numbers = jnp.asarray(uniform(keys[2], (1, paths, 2), float))
    light = trace_on(packed, light_start(packed, sample, u[:, 2:], power, "warp"), numbers, True, power, "warp")
    y1, y2 = (jax.tree.map(lambda a, i=i: a[i], light) for i in (0, 1))

    def onto(vertex, target, adjoint):
        """One vertex more, at a given point."""
        target = target._replace(valid=jnp.ones_like(target.valid))
        vertex = vertex._replace(point=vertex.point._replace(valid=jnp.ones_like(vertex.point.valid)))
        towards = target.position - vertex.point.position
        towards /= jnp.linalg.norm(towards, axis=-1, keepdims=True)
        scatterer = Scatterer(packed, vertex.point, vertex.back)
        return extend(vertex, scatterer, target, towards, scatterer.pdf(towards), None, adjoint, power)

    c2 = onto(z1, y2.point, False)
    c3 = onto(c2, y1.point, False)
    if scene.environment is None:
        c4 = onto(c3, sample.point, False)
    else:
        nowhere = material_point(packed, jnp.zeros(paths, jnp.int32), sample.point.barycentric, jnp.zeros(paths, bool))
        scatterer = Scatterer(packed, c3.point, c3.back)
        forward = scatterer.pdf(sample.direction)
        c4 = extend(c3, scatterer, nowhere, sample.direction, forward, None, False, power)
    y3 = onto(y2, z1.point, True)

    def alone(vertex):
        return Ends(vertex, Scatterer(packed, vertex.point, vertex.back), paths)

    whole = jax.tree.map(lambda *v: jnp.stack(v), z1, c2, c3, c4)
    weights = [
        found_emission(packed, whole, power)[1][3],
        with_emitters(packed, alone(c3), u[:, :2], power).weight,
        with_each_other(alone(c2), alone(y1), [(0, 0)], power).weight,
        with_each_other(alone(z1), alone(y2), [(0, 0)], power).weight,
        with_camera(packed, alone(y3), None, power)[0].weight,
    ]
    densities = jnp.stack([v.density for v in (z1, c2, c3, c4, y1, y2, y3)])
    used = (densities > 0).all(0) & z1.point.valid & y1.point.valid & y2.point.valid
    # They share the path fairly: none is always (next to) nothing.
    assert all(np.asarray(w)[np.asarray(used)].max() > 0.05 for w in weights)
    return np.asarray(sum(weights))[np.asarray(used)], int(used.sum())


QUICK = ("rough_glass", "glass", "lights_and_sky", "lens", "shine")


def compare(name, keys, spp, heuristic="balance"):
    """(z-scores of the image's means, of its pixels) against the path tracer."""
    make, depth = scenes()[name]
    scene, split = make(), [jax.random.split(jax.random.key(k), keys) for k in (5, 6)]
    one = np.asarray(images(scene, split[0], spp, jd.PathTracer(depth, None)), float)
    two = np.asarray(images(scene, split[1], spp, jd.BidirectionalPathTracer(depth, heuristic)), float)
    assert np.isfinite(two).all()
    means, error = z_scores(one.mean((1, 2)), two.mean((1, 2)))
    return means, z_scores(one.mean(-1), two.mean(-1))[0], error


@pytest.mark.parametrize("name", QUICK)
def test_same_image_as_the_path_tracer(name):
    means, pixels, error = compare(name, 12, 128, "power" if name in ("glass", "lens") else "balance")
    assert error.max() < 0.02
    assert np.abs(means).max() < 4.5, means
    assert np.sqrt((pixels**2).mean()) < 1.35, pixels


@pytest.mark.slow
@pytest.mark.parametrize("heuristic", jd.integrator.HEURISTICS)
@pytest.mark.parametrize("name", scenes())
def test_same_image_as_the_path_tracer_everywhere(name, heuristic):
    means, pixels, error = compare(name, 32, 1024, heuristic)
    assert error.max() < 0.02
    assert np.abs(means).max() < 4.0, means
    assert np.sqrt((pixels**2).mean()) < 1.25, pixels
