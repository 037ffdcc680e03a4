"""Traced values beyond the range of a parameter: no model makes NaN or infinity of them, nor do its derivatives."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxdr.scene.bsdf import BSDF
from jaxdr.scene.bsdf.microfacet import SMOOTHEST, along_and_across
from jaxdr.scene.ranges import range_of
from tests.borders.registry import borders, made, of_kind

RNG = np.random.default_rng(1)
COUNT = 24


LONG = ("Principled", "RoughDielectric", "RoughPlastic")  # they take long to compile


def directions(above: float) -> np.ndarray:
    """Unit vectors around the normal, the share `above` of them on its side."""
    found = RNG.normal(size=(COUNT, 3))
    found[:, 2] = np.abs(found[:, 2]) * np.where(np.arange(COUNT) < above * COUNT, 1, -1)
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


WI, WO, U = map(jnp.asarray, (directions(0.75), directions(0.5), RNG.random((COUNT, 2)).astype(np.float32)))


def beyond(model, field: str) -> list[float]:
    """The ends of a range, and values a little and far outside."""
    declared = range_of(model, field)
    low, high = (0.0 if math.isinf(end) else end for end in declared[:2])
    return [low, low - 0.01, low - 3.0, 0.0, high, high + 0.01, high + 3.0]


def answers(bsdf: BSDF) -> list:
    """All that a BSDF computes. A direction that means nothing is finite as well."""
    found = [bsdf.eval(WI, WO), bsdf.pdf(WI, WO), bsdf.sample(WI, U), bsdf.lobe_width(WI)]
    found += [tuple(rim) for rim in bsdf.rims(WI)]
    if bsdf.delta:
        found += [tuple(bsdf.sample_delta(WI, U))]
    return jax.tree.leaves(found)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in of_kind(BSDF)]
)
def test_bsdfs(name):
    model = made(name)
    if name == "BumpMap":  # it is evaluated with slopes in the place of its heights
        model = eqx.tree_at(lambda m: m.height, model, jnp.asarray([0.3, -0.2]))
    model = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (COUNT, *leaf.shape)), model)
    fields = list(dict.fromkeys(border.field for border in borders(name)))
    base = [getattr(model, field) for field in fields]

    @jax.jit
    def found(values, direction):
        def at(values):
            new = [jnp.where(jnp.isnan(v), b, v) for v, b in zip(values, base, strict=True)]
            return answers(eqx.tree_at(lambda m: [getattr(m, f) for f in fields], model, new))

        return jax.jvp(at, (values,), (direction,))

    for i, field in enumerate(fields):
        for value in beyond(made(name), field):
            values = jnp.full(len(fields), jnp.nan).at[i].set(value)
            for part in jax.tree.leaves(found(values, jnp.eye(len(fields))[i])):
                assert np.isfinite(part).all(), (field, value)


CONE = [("SpotLight", field) for field in ("cutoff_angle", "beam_width")]
CONE += [("TexturedSpotLight", field) for field in ("cutoff_angle", "beam_width")]


@pytest.mark.parametrize("name, field", [*CONE, ("Projector", "fov")])
def test_lights(name, field):
    @jax.jit
    def found(value):
        def at(value):
            light = eqx.tree_at(lambda m: getattr(m, field), made(name), value)
            return light.intensity_in(WO), light.power(jnp.ones(())), light.pdf(WO), light.sample(U)

        return jax.jvp(at, (value,), (1.0,))

    for value in [*beyond(made(name), field), float(made(name).beam_width) if name != "Projector" else 90.0]:
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(found(value))), value


@pytest.mark.parametrize(
    "name, field",
    [("Perspective", "fov"), ("ThinLens", "fov"), ("ThinLens", "aperture_radius"), ("ThinLens", "focus_distance")],
)
def test_cameras(name, field):
    @jax.jit
    def found(value):
        def at(value):
            camera = eqx.tree_at(lambda m: getattr(m, field), made(name), value)
            points = camera.project(jnp.asarray([[0.0, 0.1, 0.2], [0.3, 0.0, 0.4]]))
            view = camera.view(jnp.asarray([[0.2, 0.7]])) if camera.aperture else camera.view()
            return points, view.rays(jnp.asarray([[1.0, 2.5]]))

        return jax.jvp(at, (value,), (1.0,))

    for value in beyond(made(name), field):
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(found(value))), value


def test_a_roughness_below_the_least_is_the_least():
    """As in Mitsuba. At the least value the derivative is whole."""
    alpha, slope = jax.jvp(along_and_across, (jnp.asarray([-1.0, SMOOTHEST, 0.5]),), (jnp.ones(3),))
    np.testing.assert_allclose(alpha, [SMOOTHEST, SMOOTHEST, 0.5])
    np.testing.assert_array_equal(slope, [0, 1, 1])


def test_glass_between_equal_media():
    """Traced, its index counts as the closest that refracts; half vectors of closer ones would be rounding."""
    glass = made("RoughDielectric")

    @jax.jit
    def eval_at(eta):
        moved = eqx.tree_at(lambda m: m.eta, glass, eta)
        moved = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (COUNT, *leaf.shape)), moved)
        return moved.eval(WI, WO)

    def value_and_slope(eta):
        return jax.jvp(eval_at, (jnp.float32(eta),), (jnp.float32(1.0),))

    for eta, counts_as in ((1.0, 1.001), (1.0004, 1.001), (0.9996, 0.999)):
        value, slope = value_and_slope(eta)
        np.testing.assert_allclose(value, eval_at(jnp.float32(counts_as)), rtol=1e-5)
        assert not slope.any()
    assert value_and_slope(1.01)[1].any()
