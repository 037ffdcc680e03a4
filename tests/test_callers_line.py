"""Warnings name the line of whoever called this library."""

import warnings

import jax
import numpy as np
import pytest

import jaxdr as jd
from jaxdr import callers_line


@pytest.mark.parametrize("through", [lambda f: f, jax.jit, jax.jacfwd])
def test_frames_of_jax_do_not_count(through):
    def caller(x):
        callers_line.warn("something")
        return x

    with pytest.warns(UserWarning, match="something") as caught:
        through(caller)(1.0)
    assert caught[0].filename == __file__
    assert caught[0].lineno == caller.__code__.co_firstlineno + 1


def test_a_mesh_names_the_line_that_made_it():
    """And not one of Equinox, where all modules are made."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [0, -1, 0.0]])
    with pytest.warns(UserWarning, match="1 edges lie on others") as caught:
        jd.Mesh(corners, [[0, 1, 2], [4, 3, 5]])
    assert caught[0].filename == __file__


def test_a_scene_without_light_is_told():
    camera = jd.Perspective(jd.look_at((0, -4, 0), (0, 0, 0), (0, 0, 1)), 40.0, jd.Film(4, 4))
    dark, key = jd.Scene({"ball": jd.Shape(jd.shapes.sphere(1))}, camera), jax.random.key(0)
    with pytest.warns(UserWarning, match="the scene has no light, so its image is black") as caught:
        jax.eval_shape(lambda key: jd.render(dark, key, 1), key)
    assert caught[0].filename == __file__
    lights = {"lights": {"bulb": jd.PointLight((0, 0, 3), 1.0)}}, {"environment": jd.ConstantEnvironment(1.0)}
    glowing = {"ball": jd.Shape(jd.shapes.sphere(1), emitter=jd.AreaEmitter(1.0))}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for lit in (*(jd.Scene(dark.shapes, camera, **light) for light in lights), jd.Scene(glowing, camera)):
            jax.eval_shape(lambda key, lit=lit: jd.render(lit, key, 1), key)


def test_a_reflectance_above_one_is_told():
    with pytest.warns(UserWarning, match=r"reflectance is \[255.0, 0.0, 0.0\]; above 1") as caught:
        jd.Diffuse((255, 0, 0))
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        jd.Diffuse((1.0, 0.0, 0.5))
        jax.eval_shape(lambda x: jd.Diffuse(x).reflectance, jax.ShapeDtypeStruct((3,), "float32"))


def test_without_a_caller_the_outermost_frame_is_named(monkeypatch):
    monkeypatch.setattr(callers_line, "_inner", lambda frame: True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        callers_line.warn("nobody")
    assert len(caught) == 1
