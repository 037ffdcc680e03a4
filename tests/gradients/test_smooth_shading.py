"""Interpolated normals against finite differences: what jumps at an edge is the light that faces themselves block."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

SIZE = 24
BALL = jd.shapes.sphere(1, radius=0.5).smooth()
LAMP = jd.shapes.transformed(jd.shapes.rectangle(0.5, 0.5), jd.look_at((8, -1, 0), (0, 0, 0), (0, 0, 1)))
SCENE = jd.Scene(
    shapes={
        "ball": jd.Shape(BALL, jd.Diffuse(0.8)),
        "lamp": jd.Shape(LAMP, jd.Diffuse(0.0), jd.AreaEmitter(500.0)),
    },
    camera=jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 18.0, jd.Film(SIZE, SIZE, jd.Box())),
)
INTEGRATOR = jd.PathTracer(max_depth=2, sampling="emitter")
KEYS = jax.random.split(jax.random.key(3), 12)
# A turn hardly changes the sum of the image: pixels count with different weights.
WEIGHT = np.random.default_rng(4).uniform(size=(SIZE, SIZE, 1))


def turned(angle):
    """The scene with the ball turned about z, across the terminator."""
    x, y, z = BALL.vertices.T
    c, s = jnp.cos(angle), jnp.sin(angle)
    return SCENE.replace({"ball.vertices": jnp.stack([c * x - s * y, s * x + c * y, z], -1)})


@jax.jit
def difference(key, step):
    """Central difference with common random numbers."""

    def half(angle):
        return (WEIGHT * jd.render(turned(angle), key, spp=1024, integrator=INTEGRATOR)).mean()

    return (half(0.2 + step) - half(0.2 - step)) / (2 * step)


@partial(jax.jit, static_argnames="boundary")
def derivative(key, boundary):
    integrator = jd.PathTracer(max_depth=2, sampling="emitter", boundary=boundary)

    def terms(angle):
        found = jd.derivative_terms(turned(angle), key, spp=64, integrator=integrator)
        return jax.tree.map(lambda term: (WEIGHT * term).mean(), found)

    return jax.jvp(terms, (jnp.asarray(0.2),), (jnp.asarray(1.0),))[1]


@cache
def differences():
    """Of independent keys."""
    return np.array([float(difference(key, 0.01)) for key in KEYS])


@pytest.mark.parametrize(
    ("boundary", "calls"),
    [
        pytest.param(jd.KernelDensity(), 12, marks=pytest.mark.slow, id="kernel density"),
        pytest.param(jd.LineSampling(), 12, marks=pytest.mark.slow, id="lines"),
        pytest.param(jd.WarpedArea(sigma0=0.01), 256, marks=pytest.mark.slow, id="warped area"),
    ],
)
def test_terminator_of_a_coarse_ball(boundary, calls):
    """The faces' horizons turn with the ball: as creases in the picture, and across the lamp as boundaries.

    The terms nearly cancel. Errors are relative to the largest of them; 3 % are left to the step of the differences.
    """
    exact = differences()
    rows = [jax.device_get(derivative(key, boundary)) for key in jax.random.split(jax.random.key(3), calls)]
    found = np.array([sum(row.values()) for row in rows])
    terms = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
    scale = max(map(abs, terms.values()))
    error = np.hypot(exact.std(ddof=1) / len(KEYS) ** 0.5, found.std(ddof=1) / calls**0.5)
    assert error < 0.02 * scale, (exact.mean(), found.mean(), error, terms)
    assert abs(found.mean() - exact.mean()) < 4 * error + 0.03 * scale, (exact.mean(), found.mean(), error, terms)
    assert min(abs(terms["creases"]), abs(terms["boundary"])) > 0.3 * scale, terms
