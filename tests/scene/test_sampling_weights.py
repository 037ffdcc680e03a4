"""Sampling weights made of parameters: densities for any values of these."""

import hypothesis
import hypothesis.extra.numpy
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxdr as jd
from jaxdr.geometry.shapes import rectangle, sphere
from jaxdr.scene.packed import pack
from jaxdr.scene.sampling import EVENLY, LEAST, lobe_probability, probabilities
from jaxdr.transport.emission import emitter_shares, sample_emitter

CAMERA = jd.Perspective(jd.look_at([0, -4, 1], [0, 0, 0], [0, 0, 1]), 40.0, jd.Film(4, 4))
NUMBERS = st.floats(-100, 100, width=32)


@hypothesis.given(hypothesis.extra.numpy.arrays(np.float32, 5, elements=NUMBERS), NUMBERS, NUMBERS)
@hypothesis.settings(max_examples=50, deadline=None)
def test_probabilities_for_any_values(importance, first, second):
    found = np.asarray(probabilities(jnp.asarray(importance)))
    np.testing.assert_allclose(found.sum(), 1.0, rtol=1e-5)
    assert np.all(found >= 0.999 * EVENLY / 5)
    chance = float(lobe_probability(jnp.float32(first), jnp.float32(second)))
    assert LEAST - 1e-6 <= chance <= 1 - LEAST + 1e-6
    np.testing.assert_allclose(chance + float(lobe_probability(jnp.float32(second), jnp.float32(first))), 1, rtol=1e-5)


def lamps(first, second, **others) -> jd.Scene:
    """A floor, a panel of two faces and a ball of 20 or more: few emitting faces or clusters."""
    shapes = {
        "floor": jd.Shape(rectangle(4.0, 4.0)),
        "panel": jd.Shape(rectangle(1.0, 0.5, [0, 0, 2]), emitter=jd.AreaEmitter(first)),
        "ball": jd.Shape(sphere(0, 1.0, [2, 0, 2]), emitter=jd.AreaEmitter(second)),
    }
    return jd.Scene(shapes, CAMERA, **others)


def area(of: jd.Scene, name: str) -> float:
    a, b, c = np.moveaxis(np.asarray(of.shapes[name].mesh.vertices)[np.asarray(of.shapes[name].mesh.faces)], 1, 0)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("first, second", [(1.0, -0.1), (1.0, -0.01), (-2.0, 0.4), (0.0, 1.0), (0.0, 0.0), (0.3, 0.3)])
def test_emitter_samples_are_linear_in_radiance(first, second):
    """The mean of radiance / density is the sum of area x radiance, whatever its sign; every lamp keeps a share."""
    of, count = lamps(1.0, 1.0), 1 << 14

    @jax.jit
    def drawn(first, second):
        radiance = {"panel.emitter.radiance": jnp.full(3, first), "ball.emitter.radiance": jnp.full(3, second)}
        packed = pack(of.replace(radiance))
        sample = sample_emitter(packed, jax.random.uniform(jax.random.key(1), (count, 2)))
        on_ball = packed.face_shape[sample.point.face] == list(of.shapes).index("ball")
        return sample.radiance[:, 0] / sample.pdf, 1.0 / sample.pdf, on_ball, packed.emitter_cdf

    value, inverse, on_ball, cdf = map(np.asarray, drawn(jnp.float32(first), jnp.float32(second)))
    assert np.all(np.diff(cdf) >= 0) and np.all(inverse > 0)
    panel, ball = area(of, "panel"), area(of, "ball")
    for found, expected in (
        (value, panel * first + ball * second),
        (np.where(on_ball, inverse, 0), ball),
        (np.where(on_ball, 0, inverse), panel),
    ):
        error = found.std() / np.sqrt(count)
        assert abs(found.mean() - expected) <= 4 * error + 1e-5 * abs(expected)
        assert error < 0.05 * ball


def test_shares_of_lights_that_are_negative_or_off():
    lights = {"a": jd.PointLight([0, 0, 3], 1.0), "b": jd.PointLight([0, 0, 4], 1.0)}
    of = lamps(1.0, 1.0, lights=lights, environment=jd.ConstantEnvironment(1.0))

    @jax.jit
    def shares(intensity):
        values = {"a.intensity": intensity, "b.intensity": jnp.zeros(3), "environment.radiance": intensity}
        return emitter_shares(pack(of.replace(values)))

    found = np.hstack([np.ravel(share) for share in shares(jnp.full(3, -1.0))])
    np.testing.assert_allclose(found.sum(), 1, rtol=1e-5)
    assert np.all(found >= 0.999 * EVENLY / len(found))
