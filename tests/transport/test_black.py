"""Black surfaces: a path whose value is zero may have a derivative. Images are affine in what the tests differentiate.

So a derivative at zero is the same as elsewhere. With one key the samples are the same too, and both agree to rounding.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere, transformed
from jaxdr.moving import moving_in

CAMERA = jd.Perspective(jd.look_at([0, -4, 1.5], [0, 0, 0.3], [0, 0, 1]), 45.0, jd.Film(6, 6, jd.Box()))
WEIGHT = jnp.asarray(np.random.default_rng(0).uniform(0.5, 1.5, (6, 6, 3)), jnp.float32)


def scene(bsdf, floor=0.5, **lit) -> jd.Scene:
    shapes = {"ball": jd.Shape(sphere(1), bsdf), "floor": jd.Shape(rectangle(6.0, 6.0, [0, 0, -1]), jd.Diffuse(floor))}
    return jd.Scene(shapes, CAMERA, **(lit or {"environment": jd.ConstantEnvironment(1.0)}))


def slopes(of: jd.Scene, name: str, values, integrator, spp=8):
    """Derivatives of a mean of the image by one parameter, in all channels alike, at these values; one program."""
    shape = of.parameters()[name].shape

    @jax.jit
    def slope(value):
        def mean(value):
            image = jd.render(of.replace({name: jnp.broadcast_to(value, shape)}), jax.random.key(3), spp, integrator)
            return (WEIGHT * image).mean()

        return jax.jvp(mean, (value,), (jnp.ones_like(value),))[1]

    return np.array([slope(jnp.float32(value)) for value in values])


TILTED = np.array([[1, 0, 0, 0], [0, 0.8, -0.6, 0], [0, 0.6, 0.8, 0], [0, 0, 0, 1]])
POINT = {"lights": {"lamp": jd.PointLight([1.0, -2.0, 3.0], 20.0)}}


@pytest.mark.parametrize(
    "integrator, lit",
    [
        (jd.PathTracer(), {}),
        (jd.PathTracer(sampling="emitter"), POINT),
        (jd.BidirectionalPathTracer(), POINT),
    ],
    ids=["default", "emitter", "bidirectional"],
)
def test_reflectance_of_a_black_ball(integrator, lit):
    """With the indirect light that the floor sends."""
    values = (0.0, 0.5, -0.1)
    at_zero, inside, below = slopes(scene(jd.Diffuse(0.5), **lit), "ball.bsdf.reflectance", values, integrator)
    assert inside > 0.01
    np.testing.assert_allclose([at_zero, below], inside, rtol=1e-4)


def test_black_floor_lights_a_ball():
    """The light comes over the floor, which is black now: depth 3."""
    of = scene(jd.Diffuse(0.9), **POINT)
    at_zero, inside = slopes(of, "floor.bsdf.reflectance", (0.0, 0.5), jd.PathTracer())
    np.testing.assert_allclose(at_zero, inside, rtol=1e-4)
    direct = slopes(of, "floor.bsdf.reflectance", (0.0,), jd.PathTracer(max_depth=2))
    assert at_zero > 1.01 * direct


def test_black_texture():
    """Every texel of a black texture has the derivative that it has in a grey one: an optimisation may start there."""
    of = scene(jd.Diffuse(0.5), jd.Bitmap(np.full((2, 2, 3), 0.5, np.float32)), **POINT)
    (name,) = (n for n in of.parameters() if n.startswith("floor.bsdf.reflectance.") and "to_uv" not in n)
    at_zero, inside = slopes(of, name, (0.0, 0.5), jd.PathTracer(max_depth=2))
    assert inside > 0.01
    np.testing.assert_allclose(at_zero, inside, rtol=1e-4)


@pytest.mark.parametrize(
    "bsdf, field",
    [
        (jd.Plastic(0.3), "specular_reflectance"),
        (jd.ThinDielectric(), "specular_transmittance"),
        (jd.Mask(0.5, jd.Diffuse(0.4)), "opacity"),
        (jd.Principled(0.5, 0.5, 0.4), "metallic"),
    ],
    ids=["plastic", "glass", "mask", "metal"],
)
def test_lobes_of_weight_zero(bsdf, field):
    """Of models that choose between lobes, at both ends of the weight. What is chosen differs, so there is noise."""
    of, name = scene(bsdf), f"ball.bsdf.{field}"
    if isinstance(bsdf, jd.ThinDielectric):  # one pane, which light passes once
        of = jd.Scene({"ball": jd.Shape(transformed(rectangle(2.0, 2.0), TILTED), bsdf)}, CAMERA, of.environment)
    integrator, keys = jd.PathTracer(max_depth=2), jax.random.split(jax.random.key(1), 12)

    @jax.jit
    def found(value, key):
        def mean(value):
            return (WEIGHT * jd.render(of.replace({name: value}), key, 32, integrator)).mean()

        value = jnp.broadcast_to(value, of.parameters()[name].shape)
        return jax.jvp(mean, (value,), (jnp.ones_like(value),))[1]

    rows = np.array([[found(jnp.float32(value), key) for key in keys] for value in (0.0, 0.5, 1.0)])
    mean, error = rows.mean(1), rows.std(1, ddof=1) / np.sqrt(len(keys))
    for end in (0, 2):
        assert abs(mean[end] - mean[1]) < 4 * np.hypot(error[end], error[1]), f"{mean} ± {error}"
        assert error[end] < 0.15 * abs(mean[1])


def test_only_bsdfs_that_are_differentiated_need_black_paths():
    """Derivatives by what moves are zero where the value is, so their paths may end there."""
    of = scene(jd.Diffuse(0.5))
    for name, needed in (("ball.vertices", False), ("environment.radiance", False), ("floor.bsdf.reflectance", True)):
        here = of.parameters()[name]
        flags = jax.tree.map(lambda leaf, here=here: leaf is here, of)
        assert moving_in(of, flags).scattering == needed
