"""`render` under JAX's transformations: they may change nothing but rounding."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import sphere

KEY, OTHER = jax.random.key(3), jax.random.key(4)
BOUNDARY = jd.KernelDensity(0.05)


def small_scene() -> jd.Scene:
    """A ball between a floor and a light: silhouettes, creases, shadows and a sky in view."""
    floor = jd.Mesh([[-4, -4, -1], [4, -4, -1], [4, 4, -1], [-4, 4, -1]], [[0, 1, 2], [0, 2, 3]])
    light = jd.Mesh([[-1, -1, 3], [-1, 1, 3], [1, 1, 3], [1, -1, 3]], [[0, 1, 2], [0, 2, 3]])
    return jd.Scene(
        shapes={
            "ball": jd.Shape(sphere(1), jd.Diffuse((0.7, 0.5, 0.3))),
            "floor": jd.Shape(floor, jd.TwoSided(jd.Diffuse(0.5))),
            "light": jd.Shape(light, jd.Diffuse(0.0), jd.AreaEmitter(5.0)),
        },
        camera=jd.Perspective(jd.look_at([0.5, -5, 1], [0, 0, -0.3], [0, 0, 1]), 40.0, jd.Film(12, 8)),
        environment=jd.ConstantEnvironment(0.4),
    )


def image(scene, parameters, key, boundary):
    integrator = jd.PathTracer(max_depth=3, boundary=boundary)
    return jd.render(scene.replace(parameters), key, spp=4, integrator=integrator)


def random_like(tree, seed):
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda a: jnp.asarray(rng.standard_normal(a.shape), a.dtype), tree)


def forward(scene, key, boundary=BOUNDARY):
    """Image and J v for a fixed random v, a tangent of every parameter."""
    parameters = scene.parameters()
    return jax.jvp(lambda p: image(scene, p, key, boundary), (parameters,), (random_like(parameters, 1),))


def reverse(scene, key, boundary=BOUNDARY):
    """Jᵀ u for a fixed random image u."""
    value, pull = jax.vjp(lambda p: image(scene, p, key, boundary), scene.parameters())
    return pull(random_like(value, 2))[0]


@cache
def compiled(mode):
    """One compilation for all tests that can share it."""
    return jax.jit(mode, static_argnames="boundary")


def assert_transposed(pushed, pulled, scene, tolerance):
    """⟨u, J v⟩ = ⟨v, Jᵀ u⟩, relative to the sum of the magnitudes of their terms."""
    parameters = scene.parameters()
    v, u = random_like(parameters, 1), random_like(pushed, 2)
    terms = [np.asarray(pulled[name], float) * np.asarray(v[name], float) for name in parameters]
    scale = sum(np.abs(t).sum() for t in terms)
    product = np.sum(np.asarray(u, float) * np.asarray(pushed, float))
    assert abs(product) > 1e-3 * scale, "the product cancels: choose other vectors"
    assert abs(product - sum(t.sum() for t in terms)) < tolerance * scale
    for name in parameters:
        assert np.all(np.isfinite(pulled[name])) and np.any(np.asarray(pulled[name]) != 0), name


@pytest.mark.slow
@pytest.mark.parametrize(
    "boundary",
    [
        None,
        BOUNDARY,
        jd.KernelDensity(0.05, kernel="point", points=512),
        jd.LineSampling(),
        jd.WarpedArea(sigma0=0.05),
    ],
    ids=str,
)
def test_reverse_mode_is_the_transpose_of_forward_mode(boundary):
    """Every parameter at once: vertices of all shapes, camera, reflectances, radiances."""
    scene = small_scene()
    _, pushed = compiled(forward)(scene, KEY, boundary=boundary)
    assert_transposed(pushed, compiled(reverse)(scene, KEY, boundary=boundary), scene, 2e-5)


def test_same_key_same_bits():
    scene = small_scene()
    first, second, other = (jax.device_get(compiled(forward)(scene, key)) for key in (KEY, KEY, OTHER))
    for a, b, c in zip(first, second, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.any(a != c)


@pytest.mark.slow
def test_jit_changes_rounding_only():
    scene = small_scene()
    for plain, compiled_too in zip(
        forward(scene, KEY, None), compiled(forward)(scene, KEY, boundary=None), strict=True
    ):
        np.testing.assert_allclose(plain, compiled_too, rtol=0, atol=1e-4 * np.abs(plain).max())


@pytest.mark.slow
def test_vmap_over_keys_is_a_loop():
    scene = small_scene()
    alone = [compiled(forward)(scene, key) for key in (KEY, OTHER)]
    together = jax.jit(jax.vmap(forward, in_axes=(None, 0)))(scene, jnp.stack([KEY, OTHER]))
    for i in (0, 1):
        for k in (0, 1):
            np.testing.assert_allclose(together[i][k], alone[k][i], rtol=0, atol=1e-4 * np.abs(alone[k][i]).max())


def test_derivative_leaves_the_image_alone_and_has_its_own_samples():
    """The image is linear in the light's radiance L: with shared samples L · ∂I/∂L would be the image, noise too."""
    scene = small_scene()
    scene = jd.Scene(shapes=scene.shapes, camera=scene.camera)
    name = "light.emitter.radiance"
    radiance = scene.parameters()[name]
    integrator = jd.PathTracer(max_depth=2, boundary=None)

    def lit(r, key):
        return jd.render(scene.replace({name: r}), key, spp=2, integrator=integrator)

    both = jax.jit(lambda key: jax.jvp(lambda r: lit(r, key), (radiance,), (radiance,)))
    keys = jax.random.split(KEY, 512)
    values, tangents = (np.stack(a) for a in zip(*(jax.device_get(both(key)) for key in keys), strict=True))
    np.testing.assert_array_equal(values[0], jax.jit(lit)(radiance, keys[0]))
    noise, other = values - values.mean(0), tangents - tangents.mean(0)
    correlation = np.sum(noise * other) / np.sqrt(np.sum(noise**2) * np.sum(other**2))
    assert abs(correlation) < 0.15
    np.testing.assert_allclose(tangents.mean(), values.mean(), rtol=0.02)


@pytest.mark.slow
def test_float64():
    """Results are float64, near the float32 ones, and reverse mode is the transpose of forward mode to its rounding."""
    single = compiled(forward)(small_scene(), KEY)
    with jax.enable_x64(True):
        scene = small_scene()
        double = jax.jit(forward)(scene, KEY)
        for a, b in zip(single, double, strict=True):
            assert a.dtype == np.float32 and b.dtype == np.float64
            assert np.all(np.isfinite(b))
            # The same random numbers, but a few samples fall on the other side of an edge.
            assert np.mean(np.abs(a - b) < 1e-3 * np.abs(b).max()) > 0.95
        assert_transposed(double[1], jax.jit(reverse)(scene, KEY), scene, 1e-12)
