"""Programs can't grow unseen: equations of the gradient of README's example, traced and not compiled."""

import jax
import jax.numpy as jnp
import pytest

import jaxdr as jd
from experiments import program_size
from experiments.compilation import scenes

# 15,385 when it was set, with `GuidedEdges`, which rules choose there; `KernelDensity` has 16,537.
MOST_EQUATIONS = 15_500


@pytest.fixture(scope="module")
def equations():
    scene, integrator = scenes.built("README", 128)
    loss = scenes.loss_of(scene, integrator, 16, jnp.zeros((128, 128, 3)))
    return list(program_size.equations(jax.make_jaxpr(jax.grad(loss))(jnp.zeros(3), jax.random.key(1)).jaxpr))


def test_the_gradient_of_the_readme_is_small(equations):
    assert len(equations) <= MOST_EQUATIONS


def test_no_derivative_pads_coordinates(equations):
    assert not [equation for equation in equations if program_size.pads_coordinates(equation)]


def test_what_is_inside_loops_and_calls_counts():
    def function(x):
        return jax.lax.fori_loop(0, 3, lambda i, x: jnp.sin(x) * 2, jax.jit(jnp.cos)(x))

    names = [e.primitive.name for e in program_size.equations(jax.make_jaxpr(function)(1.0).jaxpr)]
    assert {"sin", "cos", "mul"} <= set(names)


def test_a_slice_is_a_pad_in_the_derivative_and_a_split_is_none():
    def sliced(v):
        return jnp.sum(v[:, 0] * v[:, 2])

    def split(v):
        x, _, z = jax.lax.split(v, (1, 1, 1), 1)
        return jnp.sum(x * z)

    for function, pads in ((sliced, 2), (split, 0)):
        found = program_size.equations(jax.make_jaxpr(jax.grad(function))(jnp.ones((4, 3))).jaxpr)
        assert sum(program_size.pads_coordinates(e) for e in found) == pads


def test_operations_and_places_of_queries():
    scene = jd.Scene(
        {"lamp": jd.Shape(jd.shapes.rectangle(), emitter=jd.AreaEmitter(1.0))},
        jd.Perspective(jd.look_at((0, 0, 3), (0, 0, 0), (0, 1, 0)), 40.0, film=jd.Film(4, 4)),
    )
    tracer = jd.PathTracer(max_depth=1, boundary=None, rays="warp")
    text = jax.jit(lambda key: jd.render(scene, key, 1, tracer)).lower(jax.random.key(0)).as_text()
    assert program_size.call_sites(text, "closest_hit") == 1
    assert program_size.call_sites(text, "occluded") == 0
    assert 0 < program_size.operations(text) < len(text.splitlines())
