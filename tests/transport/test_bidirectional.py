"""Bidirectional path tracing: every strategy by itself, their weights, the path tracer's image, and derivatives."""

from functools import cache, partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle
from jaxdr.geometry.vector import dot
from jaxdr.integrators.bidirectional import HEURISTICS
from jaxdr.scene.packed import pack
from jaxdr.scene.splat import splat
from jaxdr.transport.bidirectional import BidirectionalSettings, strategies
from jaxdr.transport.connections import Ends, found_emission, with_camera, with_each_other, with_emitters
from jaxdr.transport.emission import sample_emitter
from jaxdr.transport.interaction import material_point
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.sampler import uniform
from jaxdr.transport.shading import Scatterer
from jaxdr.transport.subpaths import Onwards, camera_start, extend, light_start, trace_on
from tests.references.polygon_shadow import irradiance
from tests.transport.bidirectional_scenes import (
    LIGHTS,
    SKY,
    UP,
    ball,
    camera,
    facing_down,
    floor,
    lamp,
    room,
    scenes,
    textured_lamp,
)

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
    primary = primary_samples(packed, jnp.arange(count), keys[0], "auto", Form.FIXED)
    u = uniform(keys[1], (width * height * count, 4))
    found = strategies(packed, primary, u, keys[2], BidirectionalSettings(depth, 1, "auto"))
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
    # A background of one radiance has no noise but that of sums in float32.
    rounding = 1e-6 * np.abs(a).mean(0)
    error = np.sqrt(a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b) + rounding**2)
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


@pytest.mark.parametrize("kind", ["lights", "area"])
def test_floor_seen_by_each_strategy(kind):
    """Direct light in closed form from light subpaths alone, (2, 1), from emitter samples and from what rays meet."""
    shapes, lights = {"floor": jd.Shape(rectangle(4.0, 4.0), jd.Diffuse(RGB))}, {}
    if kind == "area":
        shapes["lamp"] = lamp()
        x = floor_points(each=6)
        exact = np.array([8.0 * irradiance(p, UP, SQUARE) for p in x.reshape(-1, 3)]).reshape(4, 4, -1, 1)
    else:
        lights = {name: LIGHTS[name] for name in ("point", "far")}
        exact = point_irradiance(floor_points()) + 0.7 / np.sqrt(1 + 0.16 + 0.25)
    exact = RGB / np.pi * exact.mean(2)
    scene = jd.Scene(shapes, straight_down(), None, lights)
    found = np.stack([strategy_images(scene, key, 4096, 2) for key in jax.random.split(jax.random.key(1), 8)])
    for number, name in enumerate(names(kind == "area", 2)):
        if sum(name) == 3:
            ratio = found[:, number] / exact
            for values in (ratio, ratio.mean((1, 2, 3))):
                mean, error = values.mean(0), values.std(0, ddof=1) / np.sqrt(8)
                assert error.max() < (0.12 if values is ratio else 0.015), name
                assert np.abs(mean - 1.0).max() < 5 * error.max() + 5e-4, (name, mean)


EMITTERS = {"area": ({"lamp": textured_lamp()}, SKY, {}), "lights": ({}, None, LIGHTS)}


@pytest.mark.parametrize("kind", EMITTERS)
def test_direct_light_by_all_strategies(kind):
    """Pixel by pixel, unweighted, on a floor with a ball of rough glass."""
    extra, sky, lights = EMITTERS[kind]
    scene = jd.Scene(floor() | ball(jd.RoughDielectric(0.5, 1.5)) | extra, camera(4), sky, lights)
    found = np.stack([strategy_images(scene, key, 1024, 2) for key in jax.random.split(jax.random.key(2), 12)])
    by_name = dict(zip(names(kind == "area", 2), found.swapaxes(0, 1), strict=True))
    for name in [(2, 1)] + ([(0, 3)] if kind == "area" else []):
        z, error = z_scores(by_name[1, 2].mean(-1), by_name[name].mean(-1))
        assert error.mean() < 0.04
        assert np.abs(z).max() < 5.0, (name, z)


def test_paths_of_one_length_by_all_strategies():
    """Mean over the image, unweighted: (0, 5), (1, 4), (2, 3), (3, 2), (4, 1) and the shorter ones."""
    scene = jd.Scene(room() | ball(jd.RoughDielectric(0.6, 1.5)) | {"lamp": lamp(size=1.5)}, camera(4))
    found = np.stack([strategy_images(scene, key, 1024, 4) for key in jax.random.split(jax.random.key(3), 32)])
    means = dict(zip(names(True, 4), found.mean((2, 3, 4)).T, strict=True))
    for length in (2, 3, 4):
        every = {name: value for name, value in means.items() if sum(name) == length + 1}
        assert len(every) == length + 1
        one = every.pop((1, length))
        for name, other in every.items():
            z, error = z_scores(one, other)
            assert error < 0.06 and np.abs(z) < 4.5, (name, one.mean(), other.mean(), z)


def refracted_irradiance(r, above, below, eta):
    """At distances r from the axis on a floor under water, `below` its surface, from a light of intensity 1 `above`."""
    angle = np.linspace(0.0, 0.2, 20001)[1:]
    inside = np.arcsin(np.sin(angle) / eta)
    places = above * np.tan(angle) + below * np.tan(inside)
    s, p = np.sin(angle - inside) / np.sin(angle + inside), np.tan(angle - inside) / np.tan(angle + inside)
    flux = (1.0 - 0.5 * (s**2 + p**2)) * np.sin(angle)
    return np.interp(r, places, flux / (places * np.gradient(places, angle)))


@pytest.mark.parametrize("kind", ["mirror", "water"])
def test_caustic_of_a_point(kind):
    """Over one delta lobe, in closed form: only subpaths from the light find it, the path tracer never."""
    beam = {"light": jd.SpotLight([0.3, 0.2, 1.6], [0, 0, -1], np.pi, 3.0, 2.9)}
    steps = 0.02 * (np.arange(4) - 1.5)
    radius = np.hypot(*np.meshgrid(steps, steps))
    if kind == "water":
        surface = jd.Shape(rectangle(6.0, 6.0, (0, 0, 1.0)), jd.Dielectric(1.33, 1.0))
        shapes = {"floor": jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(RGB)), "surface": surface}
        at, target, exact = 0.9, 0.0, refracted_irradiance(radius, 0.6, 1.0, 1.33)
    else:
        ceiling = jd.Shape(facing_down(6.0, 6.0, (0, 0, 2.0)), jd.Diffuse(RGB))
        shapes = {"ceiling": ceiling, "mirror": jd.Shape(rectangle(6.0, 6.0), jd.Conductor())}
        at, target, exact = 1.0, 2.0, 3.6 / (3.6**2 + radius**2) ** 1.5
    matrix = jd.look_at([0.3, 0.2, at], [0.3, 0.2, target], [0, 1, 0]) @ np.diag([0.04, 0.04, 1.0, 1.0])
    scene = jd.Scene(shapes, jd.Orthographic(matrix, jd.Film(4, 4, jd.Box())), None, beam)
    found = np.asarray(images(scene, jax.random.split(jax.random.key(12), 8), 2048, jd.BidirectionalPathTracer(3)))
    ratio = found / (RGB * exact[..., None])
    for values in (ratio, ratio.mean((1, 2, 3))):
        error = values.std(0, ddof=1) / np.sqrt(8)
        assert error.max() < (0.05 if values is ratio else 0.01)
        assert np.abs(values.mean(0) - 1.0).max() < 5 * error.max(), values.mean(0)


@pytest.mark.parametrize(
    ("kind", "power"),
    [("sky", 2), *(pytest.param(*case, marks=pytest.mark.slow) for case in (("area", 1), ("area", 2), ("sky", 1)))],
)
def test_weights_add_up_to_one(kind, power):
    """Those of the five strategies that find one path of four segments."""
    bodies = floor() | ball(jd.RoughDielectric(0.6, 1.5))
    scene = jd.Scene(room() | bodies | {"lamp": lamp(size=1.5)}, camera()) if kind == "area" else None
    scene = scene or jd.Scene(bodies, camera(), SKY)
    with jax.enable_x64(True):
        scene = jax.tree.map(lambda x: jnp.asarray(x, float) if jnp.issubdtype(x.dtype, jnp.floating) else x, scene)
        weights, used = jax.jit(_weights, static_argnums=1)(scene, power)
    total, count = np.asarray(weights).sum(0)[np.asarray(used)], int(used.sum())
    # They share the path fairly: none is always (next to) nothing.
    assert (np.asarray(weights)[:, np.asarray(used)].max(1) > 0.05).all()
    assert count > 200
    np.testing.assert_allclose(total, 1.0, rtol=3e-4)  # rays start off the surfaces, see HIGH


# Rays start a little off the surfaces, so what they hit is not quite in their direction. In corners of the room, and at
# grazing angles, the densities of a direction and of the direction to its hit differ by more than rounding. So every
# point lies at least so high above the surface of the next one.
HIGH = 0.1


def _weights(scene, power):
    """Weights of the strategies, [5, N], for N paths, and which of these all strategies can find."""
    packed, keys = pack(scene), jax.random.split(jax.random.key(4), 4)
    primary = primary_samples(packed, jnp.arange(1024), keys[0], "auto", Form.FIXED)
    paths = primary.u.shape[0]
    u = jnp.asarray(uniform(keys[1], (paths, 4), float))
    sample = sample_emitter(packed, u[:, :2])
    z1 = camera_start(packed, primary)
    numbers = jnp.asarray(uniform(keys[2], (1, paths, 2), float))
    light = trace_on(packed, light_start(packed, sample, u[:, 2:], power, "auto"), numbers, True, power, "auto")
    y1, y2 = (jax.tree.map(lambda a, i=i: a[i], light) for i in (0, 1))

    def onto(vertex, target, adjoint):
        """One vertex more, at a given point."""
        target = target._replace(valid=jnp.ones_like(target.valid))
        vertex = vertex._replace(point=vertex.point._replace(valid=jnp.ones_like(vertex.point.valid)))
        towards = target.position - vertex.point.position
        towards /= jnp.linalg.norm(towards, axis=-1, keepdims=True)
        scatterer = Scatterer(packed, vertex.point, vertex.back)
        return extend(vertex, scatterer, target, Onwards(towards, scatterer.pdf(towards)), adjoint, power)

    c2 = onto(z1, y2.point, False)
    c3 = onto(c2, y1.point, False)
    if scene.environment is None:
        c4 = onto(c3, sample.point, False)
    else:
        nowhere = material_point(packed, jnp.zeros(paths, jnp.int32), sample.point.barycentric, jnp.zeros(paths, bool))
        scatterer = Scatterer(packed, c3.point, c3.back)
        forward = scatterer.pdf(sample.direction)
        c4 = extend(c3, scatterer, nowhere, Onwards(sample.direction, forward), False, power)
    y3 = onto(y2, z1.point, True)

    def alone(vertex):
        return Ends(vertex, Scatterer(packed, vertex.point, vertex.back), paths)

    whole = jax.tree.map(lambda *v: jnp.stack(v), z1, c2, c3, c4)
    weights = [
        found_emission(packed, whole, power)[1][3],
        with_emitters(packed, alone(c3), sample, power).weight,
        with_each_other(alone(c2), alone(y1), power).weight,
        with_each_other(alone(z1), alone(y2), power).weight,
        with_camera(packed, alone(y3), None, power)[0].weight,
    ]
    densities = jnp.stack([v.density for v in (z1, c2, c3, c4, y1, y2, y3)])
    used = (densities > 0).all(0) & z1.point.valid & y1.point.valid & y2.point.valid
    points = [vertex.point for vertex in (z1, y2, y1, sample)]
    for one, two in list(pairwise(points))[: 3 if scene.environment is None else 2]:
        for normal in (one.normal, two.normal):
            used &= jnp.abs(dot(normal, two.position - one.position)) > HIGH
    return jnp.stack(weights), used


def compare(name, keys, spp, heuristic="balance", depth=None):
    """(z-scores of the image's means, of its pixels) against the path tracer."""
    make, deep = scenes()[name]
    depth = depth or deep
    scene, split = make(), [jax.random.split(jax.random.key(k), keys) for k in (5, 6)]
    one = np.asarray(images(scene, split[0], spp, jd.PathTracer(depth, None)), float)
    two = np.asarray(images(scene, split[1], spp, jd.BidirectionalPathTracer(depth, heuristic)), float)
    assert np.isfinite(two).all()
    means, error = z_scores(one.mean((1, 2)), two.mean((1, 2)))
    return means, z_scores(one.mean(-1), two.mean(-1))[0], error


def test_same_image_as_the_path_tracer():
    """With three segments: every kind of connection, in a program a third as long as with four."""
    means, pixels, error = compare("zoo", 12, 128, "power", depth=3)
    assert error.max() < 0.02
    assert np.abs(means).max() < 4.5, means
    assert np.sqrt((pixels**2).mean()) < 1.35, pixels


@pytest.mark.slow
@pytest.mark.parametrize("heuristic", HEURISTICS)
@pytest.mark.parametrize("name", scenes())
def test_same_image_as_the_path_tracer_everywhere(name, heuristic):
    means, pixels, error = compare(name, 32, 1024, heuristic)
    assert error.max() < 0.02
    assert np.abs(means).max() < 4.0, means
    assert np.sqrt((pixels**2).mean()) < 1.25, pixels


def floor_scene(light=None, film_filter=None, extra=None):
    """Nothing but an even floor in view: no visibility changes."""
    shapes = {"floor": jd.Shape(rectangle(6.0, 6.0), jd.Diffuse(RGB))} | (extra or {})
    view = jd.Perspective(
        jd.look_at([0.3, 0.0, 2.0], [0.3, 0.2, 0], UP), 30.0, jd.Film(4, 4, film_filter or jd.Gaussian())
    )
    return jd.Scene(shapes, view, None, {} if light is None else {"point": light})


def test_derivative_by_materials_and_lights():
    """Direct light is the product of reflectance and radiance: along both at once, its derivative is twice itself."""
    scene = floor_scene(extra={"lamp": lamp(at=(0.1, 0.0, 2.5))})
    wanted = ("floor.bsdf.reflectance", "lamp.emitter.radiance")
    values = {name: scene.parameters()[name] for name in wanted}

    @jax.jit
    def both(key):
        def image(values):
            return jd.render(scene.replace(values), key, 512, jd.BidirectionalPathTracer(2))

        return jax.jvp(image, (values,), (values,))

    found = [both(key) for key in jax.random.split(jax.random.key(7), 6)]
    image, derivative = (np.stack([f[k].mean((0, 1)) for f in found]) for k in (0, 1))
    z, error = z_scores(2 * image, derivative)
    assert error.max() < 0.01 and np.abs(z).max() < 5.0, (image.mean(0), derivative.mean(0))


def test_derivative_by_what_moves():
    """Light, camera and a floor that tilts, all of it in view: material points, and the moving filter."""
    scene = floor_scene(jd.PointLight([0.5, 0.2, 1.2], 1.0))
    parameters = scene.parameters()
    floor_points_ = np.asarray(parameters["floor.vertices"])
    tilt = np.zeros_like(floor_points_)
    tilt[:, 2] = 0.3 * floor_points_[:, 0]
    push = np.zeros((4, 4))
    push[:3, 3] = [0.2, -0.3, 0.1]
    motion = {"floor.vertices": tilt, "camera.to_world": push, "point.position": np.array([0.3, -0.5, 0.4])}
    motion = {name: jnp.asarray(value, float) for name, value in motion.items()}
    values = {name: parameters[name] for name in motion}

    def moved(step):
        return scene.replace({name: values[name] + step * motion[name] for name in motion})

    step, exact = 0.02, []
    for sign in (1, -1):
        exact.append(images(moved(sign * step), jax.random.split(jax.random.key(8), 2), 2048, jd.PathTracer(2, None)))
    exact = np.asarray(exact[0] - exact[1], float).mean((0, -1)) / (2 * step)

    @jax.jit
    def derivative(key):
        def image(step):
            return jd.render(moved(step), key, 1024, jd.BidirectionalPathTracer(2, boundary=None))

        return jax.jvp(image, (0.0,), (1.0,))[1].mean(-1)

    found = np.stack([derivative(key) for key in jax.random.split(jax.random.key(9), 8)])
    mean, error = found.mean(0), found.std(0, ddof=1) / np.sqrt(len(found))
    assert error.max() < 0.1 * np.abs(exact).max()
    assert np.abs(mean - exact).max() < 5 * error.max(), (mean, exact, error)


def test_keys_chunks_and_precision():
    """A batch of keys, several chunks, and float64 with the same numbers."""
    scene = jd.Scene(floor() | {"lamp": lamp()}, camera(4), jd.ConstantEnvironment(0.3))
    keys = jax.random.split(jax.random.key(10), 2)
    integrator = jd.BidirectionalPathTracer(3)
    found = jax.jit(jax.vmap(lambda key: jd.render(scene, key, 16, integrator)))(keys)
    np.testing.assert_allclose(found, images(scene, keys, 16, integrator), rtol=1e-4, atol=1e-6)
    chunked = jd.BidirectionalPathTracer(3, chunk_size=4 * 4 * 5 * 6)  # six samples each: the last chunk is not full
    np.testing.assert_allclose(images(scene, keys, 16, chunked).mean(), found.mean(), rtol=0.2)
    with jax.enable_x64(True):
        double = jax.tree.map(lambda x: jnp.asarray(x, float) if jnp.issubdtype(x.dtype, jnp.floating) else x, scene)
        image = jd.render(double, keys[0], 16, integrator)
        assert image.dtype == jnp.float64
        np.testing.assert_allclose(image, found[0], rtol=1e-3, atol=1e-4)


def test_emitters_seen_directly():
    """Paths of one segment come from the camera alone; without emitters it is dark."""
    scene = jd.Scene(floor(), camera(4), jd.ConstantEnvironment(0.3))
    keys = jax.random.split(jax.random.key(11), 1)
    one, two = (np.asarray(images(scene, keys, 4, tracer(1))) for tracer in (jd.PathTracer, jd.BidirectionalPathTracer))
    np.testing.assert_array_equal(one, two)
    dark = jd.Scene(floor(), camera(4))
    for depth in (1, 2):
        assert not np.asarray(images(dark, keys, 4, jd.BidirectionalPathTracer(depth))).any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_depth": 0}, "max_depth must be at least 1"),
        ({"boundary": jd.LineSampling()}, r"take PathTracer\(boundary=LineSampling"),
        ({"edge_samples": 0.0}, "edge_samples must be positive"),
        ({"rays": "optix"}, "rays must be one of"),
        ({"chunk_size": 0}, "chunk_size must be positive"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(ValueError, match=message):
        jd.BidirectionalPathTracer(**settings)


@pytest.mark.parametrize(
    ("name", "scene", "message"),
    [
        ("floor.vertices", floor_scene(film_filter=jd.Box()), "differentiates the pixel filter .* use Gaussian"),
        ("ball.vertices", floor_scene(extra=ball(jd.Dielectric())), "has no derivative by what moves"),
        ("ball.bsdf.eta", floor_scene(extra=ball(jd.Dielectric())), "has no derivative by what moves"),
        (
            "point.position",
            floor_scene(jd.PointLight([0, 0, 1]), extra=ball(jd.Conductor())),
            "has no derivative by what moves",
        ),
    ],
)
def test_what_has_no_derivative(name, scene, message):
    value = scene.parameters()[name]

    def image(value):
        return jd.render(scene.replace({name: value}), jax.random.key(0), 1, jd.BidirectionalPathTracer(3))

    with pytest.raises(ValueError, match=message):
        jax.eval_shape(lambda v: jax.jvp(image, (v,), (v,)), value)


def test_lights_without_area_have_no_boundary_term():
    scene = floor_scene(jd.PointLight([0, 0, 1]))

    def image(value):
        integrator = jd.BidirectionalPathTracer(2, boundary=jd.WarpedArea())
        return jd.render(scene.replace({"point.position": value}), jax.random.key(0), 1, integrator)

    with pytest.raises(ValueError, match="shadows of lights without area have no derivative"):
        jax.eval_shape(lambda v: jax.jvp(image, (v,), (v,)), scene.parameters()["point.position"])
