"""Boundary terms of bidirectional path tracing: closed forms, strategies against each other and the path tracer."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from experiments import one_term
from jaxdr.boundary.shared.term import Chunk
from jaxdr.scene.packed import pack
from jaxdr.scene.splat import splat
from jaxdr.transport.bidirectional import BidirectionalSettings, strategies
from jaxdr.transport.path_settings import PathSettings
from jaxdr.transport.primary import Form, primary_samples
from jaxdr.transport.sampler import uniform
from tests.gradients import floor_point as point
from tests.references.polygon_shadow import irradiance, irradiance_derivatives, silhouette
from tests.transport.bidirectional_scenes import UP, camera, floor, lamp, room

WIDE = jd.WarpedArea(sigma0=0.1)
ESTIMATORS = {"warped": WIDE, "kernel": jd.KernelDensity(capacity=1.0)}
VIEW, SIZE = 0.5, 8  # degrees, pixels


def patch(blocker) -> jd.Scene:
    """The scene of `floor_point` with a camera that sees some 7 by 20 cm of the floor."""
    of = point.scene(blocker)
    view = jd.Perspective(jd.look_at(point.CAMERA, point.POINT, point.UP), VIEW, jd.Film(SIZE, SIZE, jd.Gaussian()))
    return jd.Scene(of.shapes, view)


@cache
def exact(kind):
    """Mean radiance of what the film sees and its derivatives, in closed form for each of many film points."""
    blocker = BLOCKERS[kind]
    view = patch(blocker).camera
    offset = view.film.filter.sample(jnp.asarray((np.arange(SIZE * SIZE * 2)[:, None] * [0.7549, 0.5698]) % 1.0))
    centre = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), -1).reshape(-1, 1, 2) + 0.5
    film = (centre + np.asarray(offset).reshape(SIZE * SIZE, 2, 2)).reshape(-1, 2)
    origin, direction = (np.asarray(x, float) for x in view.view().rays(jnp.asarray(film)))
    vertices = np.asarray(blocker.vertices, float)
    faces = [face for face in np.asarray(blocker.faces) if np.all(vertices[face, 2] > 0)]
    value, d_blocker, d_light, d_height = 0.0, np.zeros_like(vertices), 0.0, 0.0
    for d in np.broadcast_to(direction, (len(film), 3)):
        start = origin.reshape(-1, 3)[0]
        at = start - d * start[2] / d[2]
        outlines = [silhouette(at, vertices)] if blocker.closed else faces
        pieces = [vertices[outline] for outline in outlines]
        value += irradiance(at, point.UP, point.LIGHT, pieces)
        of_pieces, of_light, of_point = irradiance_derivatives(at, point.UP, point.LIGHT, pieces)
        for outline, of_piece in zip(outlines, of_pieces, strict=True):
            np.add.at(d_blocker, outline, of_piece)
        d_light, d_height = d_light + of_light, d_height + of_point @ (d / d[2])
    scale = point.REFLECTANCE / np.pi * point.RADIANCE / len(film)
    truth = {"blocker.vertices": d_blocker, "light.vertices": d_light, "floor.height": d_height}
    return scale * value, {name: scale * x for name, x in truth.items()}


BLOCKERS = {
    "half plane": point.sheet(point.HALF_PLANE, 0.1),
    "quadrangle": point.sheet(point.QUADRANGLE, 0.1),
    "box": point.BOX,
}


@partial(jax.jit, static_argnames=("boundary", "spp", "depth"))
def gradients(of, values, key, boundary, spp, depth):
    def radiance(values):
        integrator = jd.BidirectionalPathTracer(depth, boundary=boundary, edge_samples=0.01)
        return jnp.mean(jd.render(of.replace(values), key, spp, integrator))

    return jax.value_and_grad(radiance)(values)


def check(kind, boundary, keys, spp, tolerance, widest):
    """Errors are relative to the largest entry of the blocker's derivative."""
    of, (value, truth) = patch(BLOCKERS[kind]), exact(kind)
    values = {name: of.parameters()[name] for name in point.NAMES}
    rows = [
        jax.device_get(gradients(of, values, key, boundary, spp, 2))
        for key in jax.random.split(jax.random.key(0), keys)
    ]
    mean, deviation = point.mean_and_error(np.array([row[0] for row in rows], float))
    assert abs(mean - value) < 0.002 * value + 4 * deviation, (mean, deviation, value)
    found = {name: np.stack([row[1][name] for row in rows]).astype(float) for name in values}
    found["floor.height"] = found.pop("floor.vertices")[..., 2].sum(-1)
    scale = np.abs(truth["blocker.vertices"]).max()
    for name, true in truth.items():
        mean, deviation = (x / scale for x in point.mean_and_error(found[name]))
        assert deviation.max() < (0.15 if name == "floor.height" else widest), (name, deviation)
        assert np.all(np.abs(mean - true / scale) < tolerance + 4 * deviation), (name, mean, deviation, true / scale)


@pytest.mark.slow
@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("kind", BLOCKERS)
def test_direct_light_is_the_closed_form(kind, name):
    """Apex, occluder and target move; all strategies together."""
    boundary = jd.WarpedArea(sigma0=0.03) if name == "warped" else point.SHEET
    boundary = point.CLOSED if (name, kind) == ("kernel", "box") else boundary
    check(kind, boundary, keys=48, spp=256, tolerance=0.02, widest=0.04)


def blocked(bsdf=None) -> jd.Scene:
    """A sheet between a large lamp and the floor of a room, and what moves there."""
    square = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.1], [0.5, 0.5, 0.0], [-0.5, 0.5, -0.1]])
    sheet = jd.Mesh(square + np.array([0.1, 0.2, 0.9]), [[0, 1, 2], [0, 2, 3]])
    shapes = room() | {"sheet": jd.Shape(sheet, jd.TwoSided(bsdf or jd.Diffuse(0.6))), "lamp": lamp(size=1.5)}
    return jd.Scene(shapes, camera(4, film_filter=jd.Gaussian()))


def motion(of: jd.Scene):
    """The sheet moves across and turns, the lamp moves the other way, the reflector along."""
    v = np.asarray(of.parameters()["sheet.vertices"])
    turn = np.cross([0.0, 0.3, 1.0], v - v.mean(0)) + np.array([1.0, 0.2, 0.3])
    along = {"sheet.vertices": turn, "lamp.vertices": np.full((4, 3), -0.5)}
    if "pipe" in of.shapes:
        along["pipe.vertices"] = np.broadcast_to([0.3, -0.5, 0.0], of.parameters()["pipe.vertices"].shape)
    return {name: jnp.asarray(value, v.dtype) for name, value in along.items()}


@partial(jax.jit, static_argnames=("boundary", "count", "depth"))
def by_strategy(of, along, key, boundary, count, depth):
    """(boundary terms of every strategy alone, unweighted, their derivatives), images [C, H, W, 3]."""
    at = of.parameters()

    def images(step):
        packed = pack(of.replace({name: at[name] + step * d for name, d in along.items()}))
        film, keys = packed.camera.film, jax.random.split(key, 4)
        pixels = film.width * film.height
        primary = primary_samples(packed, jnp.arange(count), keys[0], "auto", Form.MATERIAL)
        u = uniform(keys[1], (pixels * count, 4))
        found = strategies(packed, primary, u, keys[2], BidirectionalSettings(depth, 1, "auto"))
        weight = jnp.where((found.value != 0).any(-1), 1.0, 0.0)
        context = one_term.context(of, (True,) * len(of.shapes), PathSettings(depth, True, "auto"))
        prepared = boundary.prepare(context, keys[3])
        chunk = Chunk(jnp.arange(count), jnp.full(count, 1 / count), primary, found, keys[3])
        values = boundary.estimate_connected(context._replace(packed=packed), prepared, chunk, weight, keys[3])
        seen = found.film_points.shape[0]
        own = values[:-seen].reshape(-1, film.height, film.width, count, 3).mean(3)
        spread = jax.vmap(lambda points, v: splat(film, points, v / count))(found.film_points, values[-seen:])
        return jnp.concatenate([own, spread])

    return jax.jvp(images, (0.0,), (1.0,))


def names(depth):
    """(s, t) in the order of `strategies`."""
    each = [(j + 2, i + 2) for i in range(depth - 1) for j in range(depth - 2 - i)]
    first = [(0, t) for t in range(2, depth + 2)] + [(1, t) for t in range(2, depth + 1)]
    return [*first, *each, *((s, 1) for s in range(2, depth + 1))]


@pytest.mark.parametrize("name", ESTIMATORS)
def test_what_moves_a_shadow_is_the_closed_form(name):
    """Nothing but the blocker moves, so the boundary term is all; lights met by chance and emitter samples, alone."""
    boundary = WIDE if name == "warped" else point.SHEET
    of, truth = patch(BLOCKERS["half plane"]), exact("half plane")[1]["blocker.vertices"]
    along = {"blocker.vertices": jnp.asarray(np.broadcast_to([1.0, 0.0, 0.0], truth.shape), jnp.float32)}
    along["blocker.vertices"] *= np.sign(truth[:, :1])  # or what both sides do would cancel
    exactly = np.abs(truth[:, 0]).sum()
    rows = []
    for key in jax.random.split(jax.random.key(4), 16):
        value, derivative = by_strategy(of, along, key, boundary, 128, 2)
        assert not np.asarray(value).any()
        rows.append(np.asarray(derivative, float).mean((1, 2, 3)))
    mean, error = (dict(zip(names(2), x, strict=True)) for x in point.mean_and_error(np.stack(rows) / exactly))
    for strategy, widest in (((0, 3), 0.08), ((1, 2), 0.06)):
        assert error[strategy] < widest, (strategy, error)
        assert abs(mean[strategy] - 1.0) < 0.02 + 4 * error[strategy], (strategy, mean, error)


def compare_strategies(of, boundary, depth, keys, count, widest):
    """Boundary terms of paths of one length by each strategy: left and right half of the image."""
    rows = []
    for key in jax.random.split(jax.random.key(1), keys):
        value, derivative = by_strategy(of, motion(of), key, boundary, count, depth)
        assert not np.asarray(value).any()
        d = np.asarray(derivative, float).mean((1, 3))
        rows.append(np.stack([d[:, :2].mean(1), d[:, 2:].mean(1)], -1))
    mean, error = point.mean_and_error(np.stack(rows))
    found = dict(zip(names(depth), zip(mean, error, strict=True), strict=True))
    for length in range(2, depth + 1):
        every = {name: x for name, x in found.items() if sum(name) == length + 1}
        assert len(every) == length + 1
        best = min(every, key=lambda name: every[name][1].max())
        a, ea = every.pop(best)
        scale = np.abs(a).max()
        for name, (b, eb) in every.items():
            # Lights met by chance are noisy; all others must have something to say.
            assert name[0] == 0 or eb.max() < widest * scale, (best, a, ea, name, b, eb)
            z = (a - b) / np.hypot(ea, eb)
            assert np.abs(z).max() < 4.5, (best, a, ea, name, b, eb)
    return found


@pytest.mark.parametrize("name", ESTIMATORS)
def test_paths_of_one_length_by_all_strategies(name):
    compare_strategies(blocked(), ESTIMATORS[name], depth=3, keys=16, count=384, widest=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ESTIMATORS)
def test_longer_paths_by_all_strategies(name):
    compare_strategies(blocked(jd.RoughConductor(0.5)), ESTIMATORS[name], depth=4, keys=32, count=1024, widest=0.4)


SKY = jd.EnvironmentMap(np.random.default_rng(2).uniform(0.1, 2.0, (6, 12, 3)))


def caustic() -> jd.Scene:
    """A half pipe of rough metal above a floor, lit from the side by a small lamp; a sheet shades some of it.

    Where the pipe touches the floor, the derivative of what one sends the other has no finite variance.
    """
    angle = np.linspace(0.0, np.pi, 9)
    arc = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.15 + 0.0 * angle], -1)
    pipe = np.concatenate([arc, arc + np.array([0.0, 0.0, 0.5])])
    i = np.arange(8)
    faces = np.concatenate([np.stack([i, i + 1, i + 10], -1), np.stack([i, i + 10, i + 9], -1)])
    sheet = np.array([[0.1, -0.4, 0.6], [0.4, -0.4, 0.6], [0.4, -0.3, 0.9], [0.1, -0.3, 0.9]])
    shapes = floor() | {
        "pipe": jd.Shape(jd.Mesh(pipe, faces), jd.TwoSided(jd.RoughConductor(0.2))),
        "sheet": jd.Shape(jd.Mesh(sheet, [[0, 1, 2], [0, 2, 3]]), jd.TwoSided(jd.Diffuse(0.3))),
        "lamp": lamp(at=(0.2, -1.0, 1.6), size=0.2, radiance=80.0),
    }
    view = jd.Perspective(jd.look_at([0.0, -0.5, 2.0], [0, 0.1, 0], UP), 40.0, jd.Film(8, 8, jd.Gaussian()))
    return jd.Scene(shapes, view)


# The caustic's lamp is small: as wide a kernel as the others' loses a third of the shadow's motion at its corners.
NARROW = ESTIMATORS | {"warped": jd.WarpedArea(sigma0=0.03)}
WHOLE = {
    "room": (blocked, 3, ESTIMATORS),
    "sky": (
        lambda: jd.Scene({k: s for k, s in blocked().shapes.items() if k != "room"} | floor(), blocked().camera, SKY),
        3,
        ESTIMATORS,
    ),
    "caustic": (caustic, 3, NARROW),
}


@partial(jax.jit, static_argnames=("integrator", "spp"))
def image_derivative(of, along, key, integrator, spp):
    at = of.parameters()

    def image(step):
        return jd.render(of.replace({name: at[name] + step * d for name, d in along.items()}), key, spp, integrator)

    return jax.jvp(image, (0.0,), (1.0,))


@pytest.mark.slow
@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("kind", WHOLE)
def test_same_derivative_as_the_path_tracer(kind, name):
    """Pixel by pixel and for the means of both halves of the image, all terms together."""
    make, depth, estimators = WHOLE[kind]
    of = make()
    along = motion(of)
    rows = []
    both = (
        jd.BidirectionalPathTracer(depth, boundary=estimators[name]),
        jd.PathTracer(depth, jd.KernelDensity(capacity=2.0)),
    )
    for number, integrator in enumerate(both):
        keys = jax.random.split(jax.random.key(2 + number), 24)
        rows.append(
            np.stack([image_derivative(of, along, key, integrator, 256)[1] for key in keys]).astype(float).mean(-1)
        )
    middle = rows[0].shape[2] // 2
    halves = [np.stack([r[:, :, :middle].mean((1, 2)), r[:, :, middle:].mean((1, 2))], -1) for r in rows]
    for one, two, limit in ((*rows, 5.0), (*halves, 4.0)):
        (a, ea), (b, eb) = point.mean_and_error(one), point.mean_and_error(two)
        error = np.hypot(ea, eb)
        assert np.sqrt((error**2).mean()) < 0.2 * np.sqrt((b**2).mean()), (a, ea, b, eb)
        assert np.abs((a - b) / error).max() < limit, (a, ea, b, eb)
