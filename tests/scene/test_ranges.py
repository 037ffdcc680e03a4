"""Ranges of parameters: what constructors and `Scene.replace` refuse, and what models make of traced values."""

import dataclasses
import inspect
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.parameters import Color, Number, number, rgb
from jaxdr.scene.camera import Camera
from jaxdr.scene.emitters import Environment
from jaxdr.scene.ranges import FINITE, Parametric, Range, at_least, range_of, ranged, within
from tests.borders.registry import MODELS, made

CAMERA = jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(4, 4))


def scene(bsdf=None, **more) -> jd.Scene:
    shapes = {"ball": jd.Shape(jd.shapes.sphere(0), jd.Diffuse() if bsdf is None else bsdf)}
    return jd.Scene(shapes, **{"camera": CAMERA} | more)


def arguments() -> list:
    """Every argument of every public model that becomes a float array."""
    found = []
    for name in MODELS:
        signature = inspect.signature(getattr(jd, name).__init__).parameters
        for field in dataclasses.fields(made(name)):
            value = getattr(made(name), field.name)
            if eqx.is_inexact_array(value) and field.name in signature:
                found.append(pytest.param(name, field.name, id=f"{name}.{field.name}"))
    assert len(found) > 60
    return found


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name, field", arguments())
def test_constructors_refuse_what_is_not_finite(name, field, bad):
    """With the name of the argument."""
    value = np.array(getattr(made(name), field))
    value.flat[-1] = bad
    with pytest.raises(ValueError, match=field):
        made(name, **{field: value})


@pytest.mark.parametrize("name, field", arguments())
def test_replace_refuses_what_constructors_refuse(name, field):
    """Concrete values in the same words, with the parameter's name before them."""
    model = made(name)
    declared = range_of(model, field)
    shape = getattr(model, field).shape
    for value in (math.nan, declared.low - 1.0, declared.high + 1.0):
        if not math.isinf(value):
            with pytest.raises(ValueError) as refusal:
                eqx.tree_at(lambda m: getattr(m, field), model, jnp.full(shape, value)).check([field])
            assert f"{name}: {field} must be" in str(refusal.value) or field == "to_world", refusal.value


@pytest.mark.parametrize(
    "values, words",
    [
        ({"ball.bsdf.alpha": 0.0}, "ball.bsdf.alpha: RoughConductor: alpha must be in [0.0001, 1], got 0.0"),
        (
            {"ball.bsdf.k": np.array([1.0, -1.0, 0.0])},
            "ball.bsdf.k: RoughConductor: k must be at least 0, got [1.0, -1.0",
        ),
        ({"camera.fov": 180.0}, "camera.fov: Perspective: fov must be between 0 and 180 degrees, got 180.0"),
        ({"lamp.cutoff_angle": 10.0}, "lamp.cutoff_angle: SpotLight: need 0 <= beam_width < cutoff_angle <= 180"),
        (
            {"environment.radiance": math.nan * np.ones(3)},
            "Environment: radiance must be finite, got [nan",
        ),
    ],
)
def test_replace_names_parameter_range_and_value(values, words):
    spot = jd.SpotLight((0, 0, 3), (0, 0, -1))
    example = scene(jd.RoughConductor(0.2), environment=jd.ConstantEnvironment(1.0), lights={"lamp": spot})
    with pytest.raises(ValueError) as refusal:
        example.replace(values)
    assert str(refusal.value).startswith("Scene.replace: " + next(iter(values)))
    assert words in str(refusal.value)


def test_replace_checks_textures_by_the_field_that_they_are_in():
    texture = jd.Product(jd.Bitmap(np.full((2, 2), 0.5)), jd.Bitmap(np.full((2, 2), 0.5)))
    square = jd.Shape(jd.shapes.rectangle(), jd.Mask(texture, jd.Diffuse(jd.Bitmap(np.full((2, 2, 3), 0.5)))))
    example = jd.Scene({"square": square}, CAMERA)
    with pytest.raises(ValueError, match=r"Mask: opacity must be in \[0, 1\], and the texture has values from 1.5"):
        example.replace({"square.bsdf.opacity.first.pixels": np.full((2, 2, 1), 3.0)})
    with pytest.raises(ValueError, match="Diffuse: reflectance must be at least 0, and the texture has values"):
        example.replace({"square.bsdf.bsdf.reflectance.pixels": np.full((2, 2, 3), -0.1)})
    example.replace({"square.bsdf.opacity.first.pixels": np.full((2, 2, 1), 2.0)})


def test_vertices_are_finite():
    vertices = np.array(scene().parameters()["ball.vertices"])
    vertices[3, 1] = math.nan
    with pytest.raises(ValueError, match=r"ball.vertices: .*must be finite, and 1 of 36 values are not.* at \[3, 1\]"):
        scene().replace({"ball.vertices": vertices})
    with pytest.raises(ValueError, match="with_vertices: vertices must be finite"):
        scene().shapes["ball"].mesh.with_vertices(vertices)


def test_only_replaced_values_are_checked():
    """A scene that was traced may hold what no constructor takes."""
    example = scene(jd.RoughConductor(0.2))
    outside = jax.jit(lambda a: example.replace({"ball.bsdf.alpha": a}))(-0.5)
    outside.replace({"ball.bsdf.k": np.ones(3)})
    with pytest.raises(ValueError, match="alpha"):
        outside.replace({"ball.bsdf.alpha": -0.5})


@pytest.mark.parametrize("name", ["EnvironmentMap", "Projector", "TexturedSpotLight", "Bitmap"])
def test_images_of_whole_numbers_are_refused(name):
    """They are most often not linear: files of 8 bits."""
    field = {"EnvironmentMap": "radiance", "Projector": "irradiance", "TexturedSpotLight": "texture"}.get(
        name, "pixels"
    )
    with pytest.raises(ValueError, match="must be floats, linear, got uint8"):
        made(name, **{field: np.ones((4, 4, 3), np.uint8)})


def test_whole_numbers_become_floats_elsewhere():
    for model in (jd.PointLight((0, 0, 1), 2), jd.ConstantEnvironment(1), jd.Diffuse(1), jd.Phong(exponent=3)):
        assert all(jnp.issubdtype(leaf.dtype, jnp.floating) for leaf in jax.tree.leaves(model))


class Shiny(BSDF):
    """As a user writes it: a range at one field, a helper for another, nothing for the third."""

    gain: Color = eqx.field(metadata=ranged(0.0, 2.0))
    share: Number
    tint: Color
    eval = pdf = sample = None

    def __init__(self, gain=1.0, share=0.5, tint=1.0):
        self.gain = rgb(gain, "Shiny: gain", -math.inf, math.inf)
        self.share = number(share, "Shiny: share", 0.0, 1.0)
        self.tint = rgb(tint, "Shiny: tint", -1.0)


def test_models_of_users():
    assert (range_of(Shiny, "gain"), range_of(Shiny, "share")) == (Range(0.0, 2.0), FINITE)
    for values, words in (({"gain": 2.5}, "gain must be in [0, 2]"), ({"share": 1.5}, "share must be in [0, 1]")):
        with pytest.raises(ValueError, match=words.replace("[", r"\[")):
            Shiny(**values)
    # The ranges of these two are not known here.
    kept = scene(Shiny()).replace({"ball.bsdf.share": 1.5, "ball.bsdf.tint": -2.0 * np.ones(3)})
    with pytest.raises(ValueError, match=r"Shiny: gain must be in \[0, 2\]"):
        kept.replace({"ball.bsdf.gain": np.full(3, -0.5)})
    with pytest.raises(ValueError, match="Shiny: tint must be finite"):
        kept.replace({"ball.bsdf.tint": np.full(3, math.inf)})


def test_what_is_not_refused():
    """Ends of closed ranges, negative lights, traced values."""
    jd.RoughConductor(np.float32(1e-4)), jd.RoughConductor(1.0), jd.Diffuse(0.0)
    jd.PointLight((0, 0, 1), -1.0)
    example = scene(jd.RoughConductor(0.2))
    jax.eval_shape(lambda a: example.replace({"ball.bsdf.alpha": a}), 5.0)


@pytest.mark.parametrize("function", [lambda x: within(x, -1.0, 1.0), lambda x: at_least(x, -1.0)])
def test_the_derivative_at_the_end_of_a_range_is_that_inside(function):
    """`jnp.maximum` and `jnp.clip` would halve it."""
    x = jnp.asarray([-2.0, -1.0, 0.0])
    value, slope = jax.jvp(function, (x,), (jnp.ones(3),))
    np.testing.assert_array_equal(value, [-1, -1, 0])
    np.testing.assert_array_equal(slope, [0, 1, 1])


def test_every_model_is_parametric():
    for name in MODELS:
        assert issubclass(getattr(jd, name), Parametric), name
    for kind in (BSDF, Camera, Environment, jd.DeltaLight, jd.Texture):
        assert issubclass(kind, Parametric)
