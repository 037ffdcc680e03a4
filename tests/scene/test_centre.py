"""A scene far from the origin is traced at the origin: images and derivatives are those of the same scene nearby."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.packed import centre_of, pack

GRID = 2.0**-6  # of all coordinates, so that rounding moves nothing at the furthest place
PLACES = ((1024.0, 2048.0, 0.0), (-131072.0, 0.0, 131072.0))


def placed(at) -> jd.Scene:
    """A ball over a floor, under a lamp and lights without area; its middle is at `at`."""
    at = np.asarray(at)

    def there(mesh: jd.Mesh) -> jd.Mesh:
        return mesh.with_vertices(np.round(np.asarray(mesh.vertices) / GRID) * GRID + at)

    def pose(origin, target, up):
        matrix = np.array(jd.look_at(origin, target, up))
        matrix[:3, 3] = np.round(matrix[:3, 3] / GRID) * GRID + at
        return matrix

    lamp = jd.shapes.transformed(jd.shapes.rectangle(1.0, 1.0), jd.look_at((2, 1, 4), (0, 0, 0.5), (0, 1, 0)))
    picture = np.linspace(0.2, 1.0, 48).reshape(4, 4, 3)
    return jd.Scene(
        shapes={
            "ball": jd.Shape(there(jd.shapes.sphere(2, 0.5, (0.0, 0.0, 0.8))), jd.Diffuse(0.7)),
            "floor": jd.Shape(there(jd.shapes.plane(6.0)), jd.TwoSided(jd.Diffuse(0.5))),
            "lamp": jd.Shape(there(lamp), jd.Diffuse(0.0), jd.AreaEmitter(20.0)),
        },
        camera=jd.Perspective(pose((0, -4, 2.5), (0, 0, 0.5), (0, 0, 1)), 35.0, jd.Film(24, 24)),
        lights={
            "bulb": jd.PointLight(at + np.array([1.0, -1.0, 3.0]), 5.0),
            "sun": jd.DirectionalLight((0.2, 0.3, -1.0), 0.5),
            "slide": jd.Projector(picture, pose((-2, -2, 3), (0, 0, 0), (0, 0, 1)), 30.0),
        },
    )


@jax.jit
def image_and_derivative(scene: jd.Scene, key):
    """Everything that has a place moves."""
    parameters = scene.parameters()
    still = {name: parameters[name] for name in ("ball.vertices", "bulb.position", "slide.to_world", "camera.to_world")}

    def image(t):
        moved = {name: value.at[..., :1, -1].add(t) if value.ndim > 1 else value + t for name, value in still.items()}
        return jd.render(scene.replace(moved), key, 4, jd.PathTracer(2))

    return jax.jvp(image, (jnp.zeros(()),), (jnp.ones(()),))


def test_images_and_derivatives_do_not_depend_on_the_place():
    near = image_and_derivative(placed((0.0, 0.0, 0.0)), jax.random.key(0))
    assert np.abs(near[1]).max() > 1.0
    for place in PLACES:
        for found, expected in zip(image_and_derivative(placed(place), jax.random.key(0)), near, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_positions_are_those_of_the_world():
    aovs = [jd.render_aovs(placed(at), jax.random.key(0), 4, ("position", "alpha")) for at in ((0, 0, 0), PLACES[0])]
    inside = np.asarray(aovs[0]["alpha"][..., 0]) == 1.0
    assert inside.sum() > 100
    moved = np.asarray(aovs[1]["position"] - aovs[0]["position"])[inside]
    np.testing.assert_allclose(moved, np.broadcast_to(PLACES[0], moved.shape), atol=1e-3)


@pytest.mark.parametrize("size", [1e-6, 1.0, 3.0, 1e6])
@pytest.mark.parametrize("at", [0.0, 0.9, -1.1, 5.0, -1e3])
def test_the_centre_is_near_and_differences_are_exact(size, at):
    box = np.asarray(jd.shapes.box().vertices)
    points = (size * (box / np.ptp(box) + at)).astype(np.float32)
    centre = np.asarray(centre_of(jnp.asarray(points)))
    assert np.abs(points - centre).max() < 3.0 * np.linalg.norm(np.ptp(points, axis=0))
    if abs(at) < 1.0:
        assert not centre.any()
    np.testing.assert_array_equal((points - centre).astype(float), points.astype(float) - centre.astype(float))


def test_all_that_packing_places_is_near():
    packed = pack(placed(PLACES[0]))
    np.testing.assert_array_equal(packed.centre, PLACES[0])
    assert np.abs(packed.vertices).max() < 10.0
    assert np.abs(packed.camera.to_world).max() < 10.0
