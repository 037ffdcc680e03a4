"""Where surfaces pass through each other in the image: against areas of clipped polygons, and against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from tests.boundary.film.test_film_edges import (
    LOOK,
    NEAR,
    QUAD,
    SIZE,
    assert_derivative,
    clip,
    estimate,
    outline,
    signed_area,
)
from tests.references.central_differences import central

WALL = np.array([[-9.0, -9.0, 3.0], [-9.0, 9.0, 3.0], [9.0, 9.0, 3.0], [9.0, -9.0, 3.0]])
BOARD = np.array([[-0.8, -0.5, 2.6], [-0.8, 0.7, 2.5], [0.9, 0.6, 3.6], [0.9, -0.7, 3.4]])
GLOW = {"wall": 1.0, "board": 3.0}


def pierced(wall=WALL, board=BOARD) -> jd.Scene:
    """A glowing wall that fills the view, and a glowing board that comes out of it."""
    shapes = {
        name: jd.Shape(jd.Mesh(corners, QUAD), jd.Diffuse(0.0), jd.AreaEmitter(GLOW[name]))
        for name, corners in (("wall", wall), ("board", board))
    }
    return jd.Scene(shapes, jd.Perspective(LOOK, 60.0, jd.Film(SIZE, SIZE, jd.Box()), near_clip=NEAR))


def brightness(board, depth=3.0):
    """Sum of the image: the board shows where it is in front of the wall."""
    front = (clip(np.asarray(board, float)[corners], np.array([0.0, 0.0, -1.0]), -depth) for corners in QUAD)
    area = sum(abs(signed_area(outline(polygon))) for polygon in front if len(polygon))
    return GLOW["wall"] * SIZE**2 + (GLOW["board"] - GLOW["wall"]) * area


def test_a_board_that_comes_out_of_a_wall():
    """By every vertex of the board, and by common motions of the wall."""
    scene = pierced()
    image = jd.render(scene, jax.random.key(3), spp=256, integrator=jd.PathTracer(max_depth=1))
    np.testing.assert_allclose(float(image.mean(-1).sum()), brightness(BOARD), rtol=2e-3)
    found = estimate(scene, keys=24)
    exact = central(brightness, BOARD)
    assert_derivative(found["board"], exact)
    mean, error = (value.sum(0) if i == 0 else np.sqrt((value**2).sum(0)) for i, value in enumerate(found["wall"]))
    forward = central(lambda d: brightness(BOARD, 3.0 + d[0]), np.zeros(1))[0]
    assert_derivative((mean[2:], error[2:]), np.array([forward]), 0.05)
    # The wall's outline is out of sight. So to shift the wall along itself changes nothing.
    assert np.all(np.abs(mean[:2]) < 4.5 * error[:2] + 1e-3 * abs(forward))


def test_both_in_one_mesh():
    """A mesh that passes through itself: the same derivative, from pairs of its own faces."""
    vertices = np.concatenate([WALL, BOARD])
    faces = [*QUAD, *(np.asarray(QUAD) + 4).tolist()]
    colors = jd.FaceColors(np.repeat([[1.0] * 3, [3.0] * 3], 2, axis=0))
    mesh = jd.Mesh(vertices, faces)
    scene = jd.Scene({"both": jd.Shape(mesh, jd.Diffuse(0.0), jd.AreaEmitter(colors))}, pierced().camera)
    mean, error = estimate(scene, keys=24)["both"]
    assert_derivative((mean[4:], error[4:]), central(brightness, BOARD))


def sunk(primary, depth, filter_) -> tuple[jd.Scene, jd.PathTracer]:
    """A dark box that is sunk into a bright floor, under an even sky."""
    scene = jd.Scene(
        {
            "box": jd.Shape(jd.shapes.box((0.9, 0.7, 0.8), (0.1, 0.0, 0.1)), jd.Diffuse((0.1, 0.15, 0.2))),
            "floor": jd.Shape(jd.shapes.plane(6.0), jd.TwoSided(jd.Diffuse(0.7))),
        },
        jd.Perspective(jd.look_at((1.6, -2.2, 2.4), (0, 0, 0.1), (0, 0, 1)), 32.0, jd.Film(SIZE, SIZE, filter_)),
        jd.ConstantEnvironment(1.0),
    )
    boundary = jd.GuidedEdges() if primary == "fixed_ray" else jd.KernelDensity()
    return scene, jd.PathTracer(max_depth=depth, boundary=boundary, primary=primary, edge_samples=1.0)


RISE, SLIDE = ((0.0, 0.0, 1.0), (0.0, 0.0, -0.5)), ((0.8, 0.6, 0.0), (0.8, 0.6, 0.0))


@pytest.mark.parametrize(
    "primary, depth, filter_, motion",
    [
        ("fixed_ray", 2, jd.Box(), RISE),
        ("material", 2, jd.Gaussian(), RISE),
        ("fixed_ray", 3, jd.Gaussian(), SLIDE),
    ],
    ids=["fixed rays", "material form", "indirect light"],
)
def test_a_box_in_the_floor(primary, depth, filter_, motion):
    """Both move: through each other, and together, where light comes from one to the other."""
    scene, tracer = sunk(primary, depth, filter_)
    names = ("box.vertices", "floor.vertices")
    start = [scene.parameters()[name] for name in names]
    weights = jnp.linspace(0.2, 1.0, SIZE)[:, None, None] + jnp.linspace(0.0, 0.5, SIZE)[None, :, None]

    def total(t, key, spp, tracer):
        moved = {name: x + jnp.asarray(v) * t for name, x, v in zip(names, start, motion, strict=True)}
        return (jd.render(scene.replace(moved), key, spp=spp, integrator=tracer) * weights).sum()

    derivative = jax.jit(jax.grad(lambda t, key: total(t, key, 64, tracer)))
    image = jax.jit(lambda t, key: total(t, key, 1024, jd.PathTracer(max_depth=depth)))
    count, step = 12 if depth == 2 else 96, 0.03  # indirect light has rare, large values
    keys = jax.random.split(jax.random.key(0), count)
    exact = [float(image(step, key) - image(-step, key)) / (2 * step) for key in keys[:12]]
    found = [float(derivative(step * shift, key)) for shift, key in zip(np.linspace(-1, 1, count), keys, strict=True)]
    error = np.hypot(*(np.std(x, ddof=1) / np.sqrt(len(x)) for x in (exact, found)))
    assert error < 0.03 * abs(np.mean(exact)), (np.mean(found), np.mean(exact), error)
    assert abs(np.mean(found) - np.mean(exact)) < 4.5 * error, (np.mean(found), np.mean(exact), error)
