"""Scenes: parameter names, replacement, and messages."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd

CAMERA = jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 30.0, jd.Film(4, 4))
SCENE = jd.Scene(
    {
        "lamp": jd.Shape(jd.shapes.rectangle(1.0, 1.0), jd.Diffuse(0.0), jd.AreaEmitter(3.0)),
        "ball": jd.Shape(jd.shapes.sphere(0), jd.TwoSided(jd.Diffuse(0.5))),
    },
    CAMERA,
    jd.ConstantEnvironment(0.2),
)


def test_names_of_parameters():
    assert set(SCENE.parameters()) == {
        "ball.vertices", "ball.bsdf.reflectance", "lamp.vertices", "lamp.bsdf.reflectance", "lamp.emitter.radiance",
        "camera.to_world", "camera.fov", "camera.principal_point", "environment.radiance",
    }  # fmt: skip


def test_replace_changes_what_it_names_and_nothing_else():
    old = SCENE.parameters()
    new = SCENE.replace({"ball.vertices": old["ball.vertices"] + 1.0, "camera.fov": 45.0}).parameters()
    for name, value in old.items():
        change = {"ball.vertices": 1.0, "camera.fov": 15.0}.get(name, 0.0)
        np.testing.assert_allclose(new[name], value + change, rtol=1e-6)
    assert SCENE.replace({}) is SCENE


def test_replace_can_be_traced():
    def total(values):
        return sum(jnp.sum(value) for value in SCENE.replace(values).parameters().values())

    gradient = jax.jit(jax.grad(total))({"ball.vertices": SCENE.parameters()["ball.vertices"]})
    np.testing.assert_array_equal(gradient["ball.vertices"], 1.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"bal.vertices": np.zeros((12, 3))}, "unknown parameter 'bal.vertices'.*this scene has: .*ball.vertices"),
        ({"ball.vertices": np.zeros((11, 3))}, r"ball.vertices has shape \(12, 3\), got \(11, 3\)"),
    ],
)
def test_wrong_values(values, message):
    with pytest.raises(ValueError, match=message):
        SCENE.replace(values)


@pytest.mark.parametrize("name", ["", "a.b", "camera", "environment"])
def test_wrong_ids(name):
    with pytest.raises(ValueError, match="can't be a shape id"):
        jd.Scene({name: SCENE.shapes["ball"]}, CAMERA)


def test_no_shapes():
    with pytest.raises(ValueError, match="shapes is empty"):
        jd.Scene({}, CAMERA)
