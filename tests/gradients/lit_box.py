"""The soft shadow of a lit box that moves, against central differences: a check of any estimator."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import box, rectangle

KEYS = jax.random.split(jax.random.key(1), 16)
STEP = 0.02


def box_scene() -> jd.Scene:
    """A box beside the picture; its soft shadow, and what the lit box sends to the floor, are in it."""
    shapes = {
        "box": jd.Shape(box((0.6, 0.6, 0.6), center=(0.0, 0.0, 0.7))),
        "floor": jd.Shape(rectangle(8.0, 8.0)),
        "lamp": jd.Shape(
            jd.Mesh([[-1.3, -0.4, 2], [-1.3, 0.4, 2], [-0.5, 0.4, 2], [-0.5, -0.4, 2]], [[0, 1, 2], [0, 2, 3]]),
            jd.Diffuse(0.0),
            jd.AreaEmitter(10.0),
        ),
    }
    camera = jd.Perspective(jd.look_at([3, -3, 3], [1.3, 0, 0], [0, 0, 1]), 8.0, jd.Film(8, 8, jd.Box()))
    return jd.Scene(shapes, camera)


SCENE = box_scene()


@partial(jax.jit, static_argnums=(0, 1, 2))
def by_x(tracer, spp, differences, key):
    """Derivative of the mean image by a translation of the box, [8, 8]: by `render`'s rule, or central differences."""
    vertices = SCENE.parameters()["box.vertices"]

    def image(x):
        moved = SCENE.replace({"box.vertices": vertices + x * jnp.asarray([1.0, 0.0, 0.0])})
        return jd.render(moved, key, spp=spp, integrator=tracer).mean(-1)

    if differences:
        return (image(STEP) - image(-STEP)) / (2 * STEP)
    return jax.jvp(image, (0.0,), (1.0,))[1]


def check_shadow(boundary, depth):
    """Assert derivatives by quarters of the film, and as a whole, without any bias allowed for."""

    def quarters(tracer, spp, differences):
        rows = np.stack([by_x(tracer, spp, differences, key) for key in KEYS])
        return rows.reshape(len(KEYS), 2, 4, 2, 4).mean((2, 4))

    found = quarters(jd.PathTracer(depth, boundary), 64, False)
    right = quarters(jd.PathTracer(depth, boundary=None), 1024, True)
    error = np.sqrt((found.var(0, ddof=1) + right.var(0, ddof=1)) / len(KEYS))
    size = np.abs(right.mean(0)).max()
    assert np.all(error < 0.05 * size), (error, size)
    assert np.all(np.abs(found.mean(0) - right.mean(0)) < 4.5 * error), (found.mean(0), right.mean(0), error)
    whole = (found - right).mean((1, 2))
    assert abs(whole.mean()) < 4.5 * whole.std(ddof=1) / len(KEYS) ** 0.5


def check_refusals(boundary):
    """Assert that an estimator that draws edges refuses mirrors and rough glass, by its name."""

    def moved(scene, x):
        vertices = scene.parameters()["box.vertices"] + x
        return jd.render(scene.replace({"box.vertices": vertices}), jax.random.key(0), 1, jd.PathTracer(2, boundary))

    for bsdf, words in ((jd.Conductor(), "no visibility changes over mirrors"), (jd.RoughDielectric(), "rough glass")):
        other = jd.Scene(dict(SCENE.shapes) | {"floor": jd.Shape(SCENE.shapes["floor"].mesh, bsdf)}, SCENE.camera)
        with pytest.raises(ValueError, match=f"{type(boundary).__name__} covers .*{words}"):
            jax.eval_shape(lambda x, other=other: jax.jvp(lambda x: moved(other, x), (x,), (1.0,)), 0.0)
