"""`render` as a whole: windows, chunks, keys, terms, error messages."""

import inspect
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere
from jaxdr.moving import Moving
from jaxdr.transport.keys import inner_key

WIDTH, HEIGHT = 12, 8
KEYS = jax.random.split(jax.random.key(20), 12)


def scene(crop=None, pixel_filter=None) -> jd.Scene:
    """A ball between a floor and a light, a dim sky."""
    light = jd.Mesh([[-1, -1, 3], [-1, 1, 3], [1, 1, 3], [1, -1, 3]], [[0, 1, 2], [0, 2, 3]])
    film = jd.Film(WIDTH, HEIGHT, pixel_filter or jd.Gaussian(0.5), crop)
    return jd.Scene(
        {
            "ball": jd.Shape(sphere(1), jd.Diffuse((0.7, 0.5, 0.3))),
            "floor": jd.Shape(rectangle(8.0, 8.0, (0.0, 0.0, -1.0)), jd.Diffuse(0.5)),
            "light": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
        },
        jd.Perspective(jd.look_at([0.5, -5, 1], [0, 0, -0.3], [0, 0, 1]), 40.0, film),
        jd.ConstantEnvironment(0.4),
    )


TRACER = jd.PathTracer(max_depth=2)


@partial(jax.jit, static_argnames=("spp", "integrator"))
def image(of, key, spp=16, integrator=TRACER):
    return jd.render(of, key, spp=spp, integrator=integrator)


@partial(jax.jit, static_argnames=("spp", "integrator"))
def derivative(of, key, spp=16, integrator=TRACER):
    """Image, and its derivative as the ball moves along x."""
    vertices = of.parameters()["ball.vertices"]

    def moved(x):
        at = vertices + x * jnp.asarray([1.0, 0.0, 0.0])
        return jd.render(of.replace({"ball.vertices": at}), key, spp=spp, integrator=integrator)

    return jax.jvp(moved, (jnp.asarray(0.0),), (jnp.asarray(1.0),))


def blocks(images):
    """Mean luminance of 4 x 4 blocks [keys, blocks]."""
    images = np.asarray(images).mean(-1)
    keys, height, width = images.shape
    return images.reshape(keys, height // 4, 4, width // 4, 4).mean((2, 4)).reshape(keys, -1)


def assert_same_expectation(first, second, what):
    """Equal means over keys, block by block: |difference| < 4.5 standard errors (small samples: Student's t)."""
    first, second = blocks(first), blocks(second)
    error = np.sqrt(first.var(0, ddof=1) / len(first) + second.var(0, ddof=1) / len(second))
    z = np.abs(first.mean(0) - second.mean(0)) / np.maximum(error, 1e-7)
    assert z.max() < 4.5, f"{what}: z = {z}"
    return error


@cache
def whole():
    """Images and derivatives for all keys."""
    return [np.stack(x) for x in zip(*(derivative(scene(), key) for key in KEYS), strict=True)]


@pytest.mark.slow
def test_crop_is_a_window_of_the_image():
    window = [np.stack(x) for x in zip(*(derivative(scene((4, 0, 8, 8)), key) for key in KEYS), strict=True)]
    assert window[0].shape == (12, 8, 8, 3)
    for name, everything, part in zip(("image", "derivative"), whole(), window, strict=True):
        error = assert_same_expectation(everything[:, :, 4:12], part, name)
        assert np.max(np.abs(blocks(part).mean(0)) / error) > 6, "all noise"
        with pytest.raises(AssertionError):  # another window differs
            assert_same_expectation(everything[:, :, 0:8], part, name)


@pytest.mark.slow
def test_chunks_leave_the_expectation_alone():
    """Seven samples a pixel in four chunks of two, of which the last is half empty."""
    small = jd.PathTracer(max_depth=2, chunk_size=200)
    chunked = [np.stack(x) for x in zip(*(derivative(scene(), key, 7, small) for key in KEYS), strict=True)]
    for name, a, b in zip(("image", "derivative"), chunked, whole(), strict=True):
        assert_same_expectation(a, b, name)


def test_samples_beyond_spp_count_for_nothing():
    """Under a constant sky alone the image is exact, also where the last chunk is half empty."""
    sky = jd.Scene(
        {"floor": jd.Shape(rectangle(0.1, 0.1, (0.0, 0.0, -50.0)))}, scene().camera, jd.ConstantEnvironment(0.75)
    )
    for spp in (1, 5, 7):
        pixels = image(sky, KEYS[0], spp, jd.PathTracer(max_depth=1, chunk_size=200))
        np.testing.assert_allclose(pixels, 0.75, rtol=1e-6)


def test_reverse_mode_through_chunks():
    """Reverse mode is the transpose of forward mode when chunks are rematerialised."""
    integrator = jd.PathTracer(max_depth=2, chunk_size=200)
    start = scene().parameters()["ball.vertices"]

    @jax.jit
    def reverse(key):
        def loss(vertices):
            return jd.render(scene_.replace({"ball.vertices": vertices}), key, spp=7, integrator=integrator).mean()

        return jax.grad(loss)(start)

    scene_ = scene()
    forward = float(derivative(scene_, KEYS[0], 7, integrator)[1].mean())
    gradient = np.asarray(reverse(KEYS[0]))[:, 0]
    assert abs(gradient.sum() - forward) < 1e-4 * np.abs(gradient).sum() and abs(forward) > 0


def test_boundary_does_not_touch_the_image():
    """The value is the same whatever the boundary estimator, differentiated or not."""
    plain = image(scene(), KEYS[1], 16, jd.PathTracer(max_depth=2, boundary=None))
    np.testing.assert_allclose(whole()[0][1], plain, rtol=1e-5, atol=1e-6)


def test_repeats_bit_for_bit():
    for again, before in zip(derivative(scene(), KEYS[2]), whole(), strict=True):
        np.testing.assert_array_equal(again, before[2])
        assert np.any(before[2] != before[3])


def test_terms_add_up_to_the_derivative():
    """`render`'s derivative is the sum of its terms' for its derivative key; boundary terms are zero in value."""
    of, key = scene(), KEYS[4]
    vertices = of.parameters()["ball.vertices"]
    derivative_key = jax.random.split(inner_key(key))[1]
    flags = [name == "ball" for name in of.shapes]

    @jax.jit
    def terms(x):
        moved = of.replace({"ball.vertices": vertices + x * jnp.asarray([1.0, 0.0, 0.0])})
        return jd.derivative_terms(moved, derivative_key, 16, TRACER, Moving(tuple(flags), False))

    values, tangents = jax.jvp(terms, (jnp.asarray(0.0),), (jnp.asarray(1.0),))
    assert set(values) == {"interior", "silhouettes", "creases", "boundary"}
    for name in ("silhouettes", "creases", "boundary"):
        assert np.all(np.asarray(values[name]) == 0) and np.any(np.asarray(tangents[name]) != 0)
    total = np.asarray(sum(tangents.values()))
    expected = np.asarray(derivative(of, key)[1])
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-4 * np.abs(expected).max())


def test_image_and_derivative_use_independent_keys():
    """The noise of the image tells nothing about that of the derivative: a squared loss has an unbiased gradient."""
    values, tangents = (x.mean(-1).reshape(12, -1) - x.mean((0, -1)).reshape(1, -1) for x in whole())
    product = (values * tangents).mean(1) / np.sqrt((values**2).mean() * (tangents**2).mean())  # mean over pixels
    assert abs(product.mean()) < max(4 * product.std(ddof=1) / np.sqrt(12), 0.1)


def test_nothing_moves_without_a_boundary():
    """`boundary=None`: a black ball before a sky does not change the image, since its silhouettes are left out."""
    black = scene().replace({"ball.bsdf.reflectance": jnp.zeros(3)})
    of = jd.Scene({"ball": black.shapes["ball"]}, black.camera, black.environment)
    assert np.all(np.asarray(derivative(of, KEYS[5], 4, jd.PathTracer(max_depth=1, boundary=None))[1]) == 0)
    assert np.any(np.asarray(derivative(of, KEYS[5], 4, jd.PathTracer(max_depth=1))[1]) != 0)


def test_no_derivative_of_what_is_not_asked_for():
    """Geometry that stays still costs no boundary term: its arrays are not in the program of the gradient."""

    def program(name):
        def loss(value):
            return jd.render(scene_.replace({name: value}), KEYS[0], 2, jd.PathTracer(max_depth=2)).sum()

        return len(jax.jit(jax.grad(loss)).lower(scene_.parameters()[name]).as_text())

    scene_ = scene()
    assert program("ball.bsdf.reflectance") < 0.7 * program("ball.vertices")


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"spp": 0}, "spp must be a positive whole number of samples per pixel, got 0"),
        ({"spp": -3}, "got -3"),
    ],
)
def test_wrong_samples(arguments, message):
    with pytest.raises(ValueError, match=f"render: .*{message}"):
        inspect.unwrap(jd.render)(scene(), KEYS[0], **arguments)  # without the type checker of the tests


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"max_depth": 0}, "max_depth must be at least 1"),
        ({"rays": "optix"}, "rays must be one of auto, embree, warp, jax; got 'optix'"),
        ({"chunk_size": 0}, "chunk_size must be positive"),
        ({"edge_samples": 0.0}, "must be positive"),
    ],
)
def test_wrong_integrator(arguments, message):
    with pytest.raises(ValueError, match=message):
        jd.PathTracer(**arguments)
